"""Every example of the gallery runs as it stands and draws what it promises."""

import json
import os
import runpy
import sys
import warnings
from pathlib import Path

import measured
import pytest

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("plot_*.py"))
NOTEBOOKS = sorted((FOLDER / "notebooks").glob("*.ipynb"))
# The others take half a minute to minutes each; PYSINDY_NRF_ALL_EXAMPLES=1 runs them
# too, and so does the gallery.
SHORT = {"plot_coming_from_pysindy", "plot_paper_2dof_damper_force"}
LONG_NOTEBOOKS = {
    "from_pysindy",
    "incomplete_excitation",
    "measured_positioning_stage",
    "paper_two_floors",
    "shaker_test",
}
RUN_ALL = os.environ.get("PYSINDY_NRF_ALL_EXAMPLES")
SMALLEST_PICTURE = 5000  # bytes; an empty one has fewer

pytestmark = pytest.mark.examples


def stem_of(path):
    return path.stem


def notebooks_to_run():
    for path in NOTEBOOKS:
        marks = [pytest.mark.slow] if path.stem in LONG_NOTEBOOKS else []
        yield pytest.param(path, id=path.stem, marks=marks)


@pytest.mark.parametrize("path", list(notebooks_to_run()))
def test_the_notebook_runs(path, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    if path.stem.startswith("measured_"):
        measured.folder("emps")
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": path.stem}
    cells = json.loads(path.read_text("utf-8"))["cells"]
    with warnings.catch_warnings(action="ignore"):
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), path.name, "exec"), namespace)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=stem_of)
def test_the_notebook_has_its_outputs_stored(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["execution_count"] for cell in code)
    outputs = [output for cell in code for output in cell["outputs"]]
    assert outputs
    assert not any(output["output_type"] == "error" for output in outputs)


@pytest.mark.parametrize("path", EXAMPLES, ids=stem_of)
def test_the_example_runs_and_draws(path, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    pytest.importorskip("matplotlib.pyplot")
    if "_measured" in path.stem:
        measured.folder("nees_three_storey")
    if path.stem not in SHORT and not RUN_ALL:
        pytest.skip("long; PYSINDY_NRF_ALL_EXAMPLES=1 runs it")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path), str(tmp_path)])
    with warnings.catch_warnings(action="ignore"), matplotlib.rc_context():
        runpy.run_path(str(path), run_name="__main__")
        matplotlib.pyplot.close("all")
    sizes = [picture.stat().st_size for picture in tmp_path.rglob("*.png")]
    assert max(sizes, default=0) > SMALLEST_PICTURE
