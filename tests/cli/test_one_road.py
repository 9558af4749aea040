"""Commands lead to `run`: where power series do not close, they say what it finds."""

import json
from pathlib import Path

import pytest
from newcomer.test_first_hour import german

from pysindy_nrf.cli import run
from pysindy_nrf.report import available

LAW = '''
from pysindy_nrf import laws


class HouseRubber(laws.ForceLaw):
    """A rubber of this house, ``R = k s^5``."""

    name = "house_rubber"
    family = "elastic"
    columns = (laws.Term("k5", "s^5", "N/m^5"),)
    symmetry = "odd"
    passive = True
    variable = "s"

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s**5
'''


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("pint")
    assert run(["inspect", german(), "--write-mapping", "mine.toml"]) == 0
    return tmp_path


def test_identify_says_what_run_finds(here, capsys):
    run(["identify", "--mapping", "mine.toml", "--no-figures"])
    output = capsys.readouterr().out
    end = output[output.index("What run finds") :]
    assert "friction" in end
    assert "storey 2" in end
    assert "pysindy-nrf run" in end


def test_select_order_says_that_a_law_is_missing(here, capsys):
    run(["select-order", "--mapping", "mine.toml", "--degrees", "1-3", "--no-figures"])
    output = capsys.readouterr().out
    assert "a law is missing" in output
    assert "pysindy-nrf run" in output.replace("\n", " ")


def test_forces_take_the_file_of_the_mapping_and_have_a_verdict(here, capsys):
    code = run(["forces", "--mapping", "mine.toml", "--json", "--no-figures"])
    content = json.loads(capsys.readouterr().out)
    assert content["verdict"]["state"] in ("amber", "red")
    assert (code == 4) == (content["verdict"]["state"] == "red")
    if available():
        assert "verdict" in Path("nrf_output/forces.html").read_text("utf-8")


@pytest.mark.slow
def test_damage_and_compare_write_pages(here, capsys):
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    how = ["--mapping", "mine.toml"]
    files = ["messung.csv", "messung.csv"]
    assert run(["damage", *files, *how, "--blocks", "5"]) == 0
    shown = Path("nrf_output/change.html").read_text("utf-8")
    assert "What changed" in shown
    assert "The fit before:" in shown
    assert "MAC 1.000" in shown
    capsys.readouterr()
    code = run(["compare", *how, "--degree", "1", "-o", "beside", "--json"])
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert (code == 4) == (verdict["state"] == "red")
    shown = Path("beside/comparison.html").read_text("utf-8")
    assert f'class="verdict {verdict["state"]}"' in shown


@pytest.mark.slow
def test_own_laws_are_read_from_a_file_also_for_saved_models(here, capsys):
    Path("rubber.py").write_text(LAW)
    law = "storey 2=linear_elastic+linear_viscous+house_rubber"
    how = ["--mapping", "mine.toml", "--laws", "rubber.py"]
    run(["identify", *how, "--law", law, "--no-figures", "--degree", "1"])
    model = json.loads(Path("nrf_output/model.json").read_text("utf-8"))
    assert "house_rubber" in json.dumps(model)
    manifest = json.loads(Path("nrf_output/manifest.json").read_text("utf-8"))
    inputs = [source["file"] for source in manifest["runs"][-1]["inputs"]]
    assert any(name.endswith("rubber.py") for name in inputs)
    simulated = run(["simulate", "nrf_output/model.json", *how, "-o", "again.csv"])
    assert simulated == 0


def test_a_file_of_laws_that_is_none_is_refused(here, capsys):
    Path("empty.py").write_text("x = 1\n")
    assert run(["laws", "--laws", "empty.py"]) == 3
    assert "defines no law" in capsys.readouterr().err
    Path("broken.py").write_text("1/0\n")
    assert run(["laws", "--laws", "broken.py"]) == 3
    assert "ZeroDivisionError" in capsys.readouterr().err
