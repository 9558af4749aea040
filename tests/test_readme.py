"""The README alone leads from a file with odd names in mm and g to masses and a
page.
"""

import re
import runpy
from pathlib import Path

import measured
import numpy as np
import pytest
from scipy import signal

from pysindy_nrf import ChainModel
from pysindy_nrf.cli import run

README = (Path(__file__).parents[1] / "README.md").read_text("utf-8")
MASSES, STIFFNESSES, DAMPINGS = (
    (5200.0, 5000.0, 4300.0),
    (4.1e6, 3.6e6, 3.0e6),
    (9e3, 8e3, 7e3),
)
NOISE = 0.005


def tower(path: Path) -> None:
    """A shaker on the top of three storeys, by scipy's own linear solution; units and
    names of the README.
    """
    fs, n = 256.0, 7680
    rng = np.random.default_rng(3)
    t = np.arange(n) / fs
    F = signal.sosfilt(
        signal.butter(4, [0.8, 25], "band", fs=fs, output="sos"), rng.standard_normal(n)
    )
    F *= 2500 / F.std()
    drift = np.eye(3) - np.eye(3, k=-1)
    K, C = (drift.T @ np.diag(x) @ drift for x in (STIFFNESSES, DAMPINGS))
    M = np.diag(1 / np.array(MASSES))
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-M @ K, -M @ C]])
    B = np.concatenate([np.zeros((3, 1)), M[:, [2]]])
    _, _, z = signal.lsim((A, B, np.eye(6), np.zeros((6, 1))), F, t)
    a = z @ A.T[:, 3:] + F[:, None] * B[3:].T

    def noisy(x):
        return x + NOISE * x.std(axis=0) * rng.standard_normal(x.shape)

    columns = [
        np.arange(n),
        1e3 * t,
        noisy(F) / 1e3,
        *noisy(a).T / 9.80665,
        *noisy(z[:, :3]).T * 1e3,
        np.full(n, 21.3),
    ]
    head = (
        "Scan #,Time (ms),SHAKER top,ACC-L1 Y,ACC-L2 Y,ACC-L3 Y,LVDT 1,LVDT 2,LVDT"
        " 3,Temp"
    )
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=head, comments="")


def test_a_file_in_mm_and_g_to_a_page(tmp_path, monkeypatch, capsys):
    for package in ("pint", "jinja2", "plotly"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    tower(Path("tower.csv"))
    (mapping,) = re.findall(r"^```toml\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
    Path("tower.toml").write_text(mapping, "utf-8")

    assert run(["inspect", "tower.csv"]) == 3  # which columns are there?
    output = capsys.readouterr()
    assert (
        "SHAKER top" in output.out and "LVDT 3" in output.out and "--map" in output.err
    )
    commands = re.findall(
        r"^pysindy-nrf ((?:inspect|identify) --mapping tower\.toml)",
        README,
        re.MULTILINE,
    )
    assert len(commands) == 2 and len(README.splitlines()) < 130  # three screens
    for command in commands:
        assert run(command.split()) == 0
    output = capsys.readouterr().out
    assert "not used: Scan #, Temp" in output and "Take care" not in output
    model = ChainModel.from_json("nrf_output/model.json")
    np.testing.assert_allclose(model.masses, MASSES, rtol=0.02)
    stiffness = [model.restoring_forces[i].linear_part()["k"] for i in (1, 2, 3)]
    np.testing.assert_allclose(stiffness, STIFFNESSES, rtol=0.02)
    page = Path("nrf_output/report.html").read_text("utf-8")
    assert "<h1" in page and page.count("Restoring-force surface of storey") >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bundled frame", "EMPS positioning stage"])
def test_the_verdicts_are_those_that_the_readme_prints(name):
    script = runpy.run_path(
        str(Path(__file__).parents[1] / "benchmarks" / "readme_numbers.py")
    )
    if name != "bundled frame":
        measured.folder("emps")
    assert script["line"](name) in README
