"""Every example of the gallery runs as it stands and draws what it promises."""

import json
import os
import runpy
import sys
import warnings
from pathlib import Path

import measured
import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("plot_*.py"))
# The others take half a minute to minutes each; PYSINDY_NRF_ALL_EXAMPLES=1 runs them
# too, and so does the gallery.
SHORT = ("plot_coming_from_pysindy", "plot_paper_2dof_damper_force")
ALL = os.environ.get("PYSINDY_NRF_ALL_EXAMPLES")
NOTEBOOKS = sorted(
    (Path(__file__).parents[1] / "examples" / "notebooks").glob("*.ipynb")
)
pytestmark = pytest.mark.examples


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_notebook_runs(path, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": path.stem}
    with warnings.catch_warnings(action="ignore"):
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), path.name, "exec"), namespace)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_the_example_runs_and_draws(path, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    pytest.importorskip("matplotlib.pyplot")
    if "_measured" in path.stem:
        measured.folder("nees_three_storey")
    if path.stem not in SHORT and not ALL:
        pytest.skip("long; PYSINDY_NRF_ALL_EXAMPLES=1 runs it")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    with warnings.catch_warnings(action="ignore"), matplotlib.rc_context():
        runpy.run_path(str(path), run_name="__main__")
        matplotlib.pyplot.close("all")
    drawn = [p for p in tmp_path.rglob("*.png") if p.stat().st_size > 5000]
    assert drawn, f"{path.name} wrote no picture into the folder it was given"
