"""A run is a transaction.

Nothing is written over that no run made, and results of two runs are never mixed.
"""

import contextlib
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from report_cases import TWO_STOREYS, two_storeys

from pysindy_nrf import ChainModel
from pysindy_nrf.cli import ExitCode, run
from pysindy_nrf.exceptions import NRFError

IDENTIFY = ["identify", "test.csv", "--degree", "1", "--no-figures"]
SIMULATE = ["simulate", "model.json", "test.csv", "-o"]
LINEAR = ["--degree", "1", "-o"]


@pytest.fixture
def there(here):
    """A measured file under three names, notes of the user, a first guess."""
    two_storeys().to_frame().to_csv("test.csv")
    os.symlink("test.csv", "link.csv")
    os.link("test.csv", "hard.csv")
    Path("notes.csv").write_text("my notes")
    Path("d").mkdir()
    shutil.copy("test.csv", "d/masses.csv")
    TWO_STOREYS.to_json("model.json")
    return here


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of results, with figures, of a run on the measured file."""
    folder = tmp_path_factory.mktemp("finished")
    two_storeys().to_frame().to_csv(folder / "test.csv")
    with contextlib.chdir(folder):
        assert run([*IDENTIFY, "--figures"]) == 0
    return folder / "nrf_output"


@pytest.fixture
def results(there, finished):
    """The results of that run beside the measured file."""
    return shutil.copytree(finished, there / "nrf_output")


def contents(folder):
    files = [path for path in Path(folder).rglob("*") if path.is_file()]
    return {path.name: path.read_bytes() for path in files}


def marked(path):
    """SHA-256 of a file."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


# -- what is not lost ----------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([*SIMULATE, "test.csv"], "test.csv is an input"),
        ([*SIMULATE, "link.csv"], "link.csv is an input"),
        ([*SIMULATE, "hard.csv"], "hard.csv is an input"),
        (
            ["simulate", "model.json", "link.csv", "-o", "test.csv"],
            "test.csv is an input",
        ),
        ([*SIMULATE, "notes.csv"], "notes.csv is no result"),
        (
            ["report", "model.json", "test.csv", "-o", "notes.csv"],
            "notes.csv is no result",
        ),
        (["identify", "d/masses.csv", *LINEAR, "d"], "masses.csv is an input"),
        (["identify", "test.csv", *LINEAR, "."], "model.json is no result"),
    ],
)
def test_no_command_writes_over_an_input_or_a_file_that_no_run_made(
    there, capsys, arguments, words
):
    before = contents(there)
    assert run(arguments) == ExitCode.DATA
    text = capsys.readouterr().err
    assert words in text
    assert "--force" in text
    assert contents(there) == before
    assert Path("link.csv").is_symlink()


@pytest.mark.parametrize(
    "arguments",
    [[*SIMULATE, "pipe.csv"], ["identify", "test.csv", *LINEAR, "pipe.csv"]],
)
def test_no_command_writes_over_a_pipe(there, capsys, arguments):
    os.mkfifo("pipe.csv")
    assert run(arguments) == ExitCode.DATA
    assert "pipe.csv is a device or pipe" in capsys.readouterr().err


def test_force_writes_over_them_and_keeps_a_link(there):
    command = ["simulate", "model.json", "hard.csv", "-o", "link.csv"]
    assert run([*command, "--force"]) == 0
    assert Path("link.csv").is_symlink()
    assert Path("test.csv").read_text().startswith("# {")
    assert run(command) == 0, "now it is a result"


def test_devices_are_refused(tmp_path):
    with pytest.raises(NRFError, match="null is a device"):
        TWO_STOREYS.to_json(os.devnull)


def test_links_are_kept(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    real, link = tmp_path / "elsewhere" / "real.json", tmp_path / "link.json"
    os.symlink(real, link)
    TWO_STOREYS.to_json(link)
    assert link.is_symlink()
    assert ChainModel.from_json(real) == TWO_STOREYS


# -- what is replaced ----------------------------------------------------------


def test_results_from_the_same_file_stay_beside_each_other(results):
    orders = ["select-order", "test.csv", "--degrees", "1-2", "--no-figures"]
    assert run(orders) == 0
    assert run(IDENTIFY) == 0
    assert {"masses.csv", "orders.csv"} <= contents(results).keys()


def test_a_run_replaces_all_results_of_the_same_command(results):
    """This one draws no figures."""
    assert "restoring_forces.png" in contents(results)
    assert run(IDENTIFY) == 0
    assert "restoring_forces.png" not in contents(results)


def test_results_from_another_file_go_and_files_of_the_user_stay(results):
    (results / "notes.txt").write_text("mine")
    orders = ["select-order", "test.csv", "--degrees", "1-2", "--no-figures"]
    assert run(orders) == 0
    other = two_storeys(name="other").rows(slice(0, 1500))
    other.to_frame().to_csv("other.csv")
    assert run(["identify", "other.csv", *IDENTIFY[2:]]) == 0
    assert "orders.csv" not in contents(results)
    assert (results / "notes.txt").read_text() == "mine"


def test_a_result_that_the_user_changed_is_not_replaced(results, capsys):
    (results / "masses.csv").write_text("dof,mass_kg,weighed by hand\n")
    before = contents(results)
    assert run(IDENTIFY) == ExitCode.DATA
    assert "or changed since" in capsys.readouterr().err
    assert contents(results) == before


# -- the manifest --------------------------------------------------------------


@pytest.fixture
def manifest(there):
    """What the manifest says of one run."""
    assert run(IDENTIFY) == 0
    text = Path("nrf_output/manifest.json").read_text()
    (made,) = json.loads(text)["runs"]
    return made


def test_the_manifest_says_what_a_run_was(manifest):
    source = manifest["inputs"][0]
    assert source["file"] == "test.csv"
    assert source["sha256"] == marked("test.csv")
    assert manifest["arguments"] == IDENTIFY
    assert manifest["settings"]["degree"] == 1
    assert manifest["versions"]["numpy"]


def test_the_manifest_names_every_file_with_its_mark(manifest):
    written = contents("nrf_output").keys() - {"manifest.json"}
    assert manifest["files"].keys() == written
    for name, mark in manifest["files"].items():
        assert mark == marked(f"nrf_output/{name}")


def test_page_and_model_name_the_inputs_too(manifest):
    page = Path("nrf_output/report.html").read_text(encoding="utf-8")
    assert marked("test.csv") in page
    assert "pysindy-nrf identify test.csv" in page
    info = ChainModel.from_json("nrf_output/model.json").info
    assert info["inputs"][0]["sha256"] == marked("test.csv")


def not_my_notes():
    """The SHA-256 of what stands in the user's notes."""
    return hashlib.sha256(b"my notes").hexdigest()


@pytest.mark.parametrize(
    "files",
    [["masses.csv"], {"masses.csv": "0", "../notes.csv": not_my_notes()}],
    ids=["no marks", "a file elsewhere"],
)
def test_a_manifest_that_names_files_elsewhere_is_no_manifest(there, files):
    Path("out").mkdir()
    runs = [{"inputs": [{"sha256": "0"}], "files": files}]
    wrong = {"schema": "pysindy_nrf.Manifest", "version": 1, "runs": runs}
    Path("out/manifest.json").write_text(json.dumps(wrong))
    assert run([*IDENTIFY, "-o", "out"]) == 0
    assert Path("notes.csv").read_text() == "my notes"
    assert "test.csv" in Path("out/manifest.json").read_text()


# -- a killed run --------------------------------------------------------------

KILLED = """
import os, shutil, sys
from pysindy_nrf.cli import run
move, left = shutil.move, [int(sys.argv[1])]
def dies(*paths):
    left[0] -= 1
    return os._exit(9) if left[0] < 0 else move(*paths)
shutil.move = dies
run(sys.argv[2:])
"""


# The same files as before, and others.
@pytest.mark.parametrize("degree", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_run_that_is_killed_while_it_moves_its_results_leaves_no_mixture(
    results, degree
):
    before = contents(results)
    command = ["identify", "test.csv", "--degree", degree, "--no-figures"]
    done = subprocess.run([sys.executable, "-c", KILLED, "3", *command])
    assert done.returncode == 9
    assert list(results.glob(".*.part"))

    # the next run, whatever comes of it
    assert run(["identify", "test.csv", "--known-mass", "7=1"]) == ExitCode.DATA
    assert contents(results) == before
