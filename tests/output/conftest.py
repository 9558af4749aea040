"""Files and a folder for the tests of the commands."""

import json

import pytest

from pysindy_nrf import datasets
from pysindy_nrf.data.io import write_record


@pytest.fixture(scope="session")
def demo_file(tmp_path_factory):
    return str(
        write_record(datasets.load_demo(), tmp_path_factory.mktemp("demo") / "demo.csv")
    )


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
    return lambda: json.loads(
        capsys.readouterr().out,
        parse_constant=lambda word: pytest.fail(f"{word} in JSON"),
    )
