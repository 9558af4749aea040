"""What every test file shares."""

import json
import os
from pathlib import Path

import chains
import pytest
from hypothesis import settings

from pysindy_nrf import ChainModel, datasets, laws
from pysindy_nrf.records.files import write_record
from pysindy_nrf.simulation import add_noise

settings.register_profile("quick", max_examples=20, deadline=None, derandomize=True)
settings.load_profile("quick")
# Benchmarks read it, too.
MEASURED = Path(__file__).parents[2] / "shared" / "data"
os.environ.setdefault("PYSINDY_NRF_DATA", str(MEASURED))


@pytest.fixture(scope="session")
def chain4():
    """A Duffing chain of four storeys, DOF 3 forced."""
    return chains.duffing(4, [3], seed=1, n_samples=4000)


@pytest.fixture(scope="session")
def chain2():
    """A Duffing chain of two storeys, both DOFs forced."""
    return chains.duffing(2, [1, 2], seed=2, n_samples=2000)


@pytest.fixture(scope="session")
def dahl():
    """The paper's chain with the modified Dahl damper: case, Z, R_1."""
    return chains.paper_case(duration=2.0)


@pytest.fixture(scope="session")
def three():
    """Motions and forces of three linear storeys with noise in every channel."""
    storey = laws.PowerSeries(1, [60.0, 4e4])
    truth = ChainModel([10.0, 12.0, 8.0], {1: storey, 2: storey, 3: storey})
    record = chains.driven(truth, [1, 2, 3], 6.0, 500.0, 50.0, (1, 60), seed=3)
    return add_noise(record, 0.02, random_state=1).to_features()


@pytest.fixture(scope="session")
def demo_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("demo") / "demo.csv"
    return str(write_record(datasets.load_demo(), path))


@pytest.fixture(scope="session")
def truth_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("truth") / "model.json"
    datasets.demo_truth().to_json(path)
    return str(path)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder, in which the commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def spoken(capsys):
    """What a command printed as strict JSON."""

    def refuse(word):
        pytest.fail(f"{word} in JSON")

    def read():
        return json.loads(capsys.readouterr().out, parse_constant=refuse)

    return read
