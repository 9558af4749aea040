"""A run is a transaction: nothing is written over that no run made, and results of two
runs are never mixed.
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
from pysindy_nrf.cli.group import run
from pysindy_nrf.common.files import atomic_write
from pysindy_nrf.exceptions import NRFError

IDENTIFY = ["identify", "test.csv", "--degree", "1", "--no-figures"]


@pytest.fixture
def there(here):
    """A measured file under three names, a file of the user's, the model of a first
    guess.
    """
    two_storeys().to_frame().to_csv("test.csv")
    os.symlink("test.csv", "link.csv")
    os.link("test.csv", "hard.csv")
    (here / "notes.csv").write_text("my notes")
    (here / "d").mkdir()
    (here / "d" / "masses.csv").write_bytes((here / "test.csv").read_bytes())
    TWO_STOREYS.to_json("model.json")
    return here


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The folder of results, with figures, of a run on the measured file."""
    folder = tmp_path_factory.mktemp("found")
    two_storeys().to_frame().to_csv(folder / "test.csv")
    with contextlib.chdir(folder):
        assert run([*IDENTIFY, "--figures"]) == 0
    return folder / "nrf_output"


def contents(folder):
    return {p.name: p.read_bytes() for p in Path(folder).rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["simulate", "model.json", "test.csv", "-o", "test.csv"],
            "test.csv is an input",
        ),
        (
            ["simulate", "model.json", "test.csv", "-o", "link.csv"],
            "link.csv is an input",
        ),
        (
            ["simulate", "model.json", "test.csv", "-o", "hard.csv"],
            "hard.csv is an input",
        ),
        (
            ["simulate", "model.json", "link.csv", "-o", "test.csv"],
            "test.csv is an input",
        ),
        (
            ["simulate", "model.json", "test.csv", "-o", "notes.csv"],
            "notes.csv is no result",
        ),
        (
            ["report", "model.json", "test.csv", "-o", "notes.csv"],
            "notes.csv is no result",
        ),
        (
            ["identify", "d/masses.csv", "--degree", "1", "-o", "d"],
            "masses.csv is an input",
        ),
        (
            ["identify", "test.csv", "--degree", "1", "-o", "."],
            "model.json is no result",
        ),
        (
            ["simulate", "model.json", "test.csv", "-o", "pipe.csv"],
            "pipe.csv is a device or pipe",
        ),
        (
            ["identify", "test.csv", "--degree", "1", "-o", "pipe.csv"],
            "pipe.csv is a device or pipe",
        ),
    ],
)
def test_no_command_writes_over_an_input_or_a_file_that_no_run_made(
    there, capsys, arguments, words
):
    before = contents(there)
    os.mkfifo("pipe.csv")
    assert run(arguments) == 3
    said = capsys.readouterr().err
    assert words in said and ("--force" in said or "pipe" in words)
    assert contents(there) == before and Path("link.csv").is_symlink()


def test_force_writes_over_them_and_keeps_a_link(there):
    assert run(["simulate", "model.json", "hard.csv", "-o", "link.csv", "--force"]) == 0
    assert Path("link.csv").is_symlink() and Path("test.csv").read_text().startswith(
        "# {"
    )
    assert (
        run(["simulate", "model.json", "hard.csv", "-o", "link.csv"]) == 0
    )  # now it is a result


def test_a_run_replaces_the_results_of_earlier_ones_and_nothing_else(
    there, found, capsys
):
    out = shutil.copytree(found, there / "nrf_output")
    (out / "notes.txt").write_text("mine")
    assert run(["select-order", "test.csv", "--degrees", "1-2", "--no-figures"]) == 0
    assert {"restoring_forces.png", "masses.csv", "orders.csv"} <= contents(out).keys()
    assert run(IDENTIFY) == 0  # orders.csv came from the same file and stays
    assert {"masses.csv", "orders.csv", "notes.txt"} <= contents(out).keys()
    assert "restoring_forces.png" not in contents(out)
    two_storeys(name="other").rows(slice(0, 1500)).to_frame().to_csv("other.csv")
    assert run(["identify", "other.csv", *IDENTIFY[2:]]) == 0
    assert (
        "orders.csv" not in contents(out) and (out / "notes.txt").read_text() == "mine"
    )
    (out / "masses.csv").write_text("dof,mass_kg,weighed by hand\n")
    before = contents(out)
    assert run(IDENTIFY) == 3
    assert (
        "masses.csv is no result of an earlier run, or changed since"
        in capsys.readouterr().err
    )
    assert contents(out) == before


def test_the_manifest_says_what_a_run_was(there):
    assert run(IDENTIFY) == 0
    made = json.loads((there / "nrf_output" / "manifest.json").read_text())["runs"][0]
    mark = hashlib.sha256(Path("test.csv").read_bytes()).hexdigest()
    assert (
        made["inputs"][0]["file"] == "test.csv" and made["inputs"][0]["sha256"] == mark
    )
    assert (
        made["arguments"] == IDENTIFY
        and made["settings"]["degree"] == 1
        and made["versions"]["numpy"]
    )
    assert made["files"].keys() == contents("nrf_output").keys() - {"manifest.json"}
    page = Path("nrf_output/report.html").read_text(encoding="utf-8")
    assert (
        mark in page and "pysindy-nrf identify test.csv" in page and "This run" in page
    )
    assert (
        ChainModel.from_json("nrf_output/model.json").info["inputs"][0]["sha256"]
        == mark
    )


@pytest.mark.parametrize(
    "files",
    [
        ["masses.csv"],
        {"masses.csv": "0", "../notes.csv": hashlib.sha256(b"my notes").hexdigest()},
    ],
)
def test_a_manifest_that_names_files_elsewhere_is_no_manifest(there, files):
    (there / "out").mkdir()
    wrong = {
        "schema": "pysindy_nrf.Manifest",
        "version": 1,
        "runs": [{"inputs": [{"sha256": "0"}], "files": files}],
    }
    (there / "out" / "manifest.json").write_text(json.dumps(wrong))
    assert run([*IDENTIFY, "-o", "out"]) == 0
    assert (
        Path("notes.csv").read_text() == "my notes"
        and "test.csv" in Path("out/manifest.json").read_text()
    )


KILLED = """
import os, shutil, sys
from pysindy_nrf.cli.group import run
move, left = shutil.move, [int(sys.argv[1])]
def dies(*paths):
    left[0] -= 1
    return os._exit(9) if left[0] < 0 else move(*paths)
shutil.move = dies
run(sys.argv[2:])
"""


def test_a_run_that_is_killed_while_it_moves_its_results_leaves_no_mixture(
    there, found, capsys
):
    before = contents(shutil.copytree(found, "nrf_output"))
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            KILLED,
            "3",
            *IDENTIFY[:2],
            "--degree",
            "2",
            "--no-figures",
        ]
    )
    assert done.returncode == 9 and list(Path("nrf_output").glob(".*.part"))
    assert (
        run(["identify", "test.csv", "--known-mass", "7=1"]) == 3
    )  # the next run, whatever comes of it
    assert contents("nrf_output") == before


def test_devices_are_refused_and_links_kept(tmp_path):
    with (
        pytest.raises(NRFError, match="null is a device or pipe"),
        atomic_write(os.devnull),
    ):
        pass
    (tmp_path / "elsewhere").mkdir()
    os.symlink(tmp_path / "elsewhere" / "real.csv", tmp_path / "link.csv")
    with atomic_write(tmp_path / "link.csv") as file:
        file.write("new")
    assert (tmp_path / "link.csv").is_symlink() and (
        tmp_path / "elsewhere" / "real.csv"
    ).read_text() == "new"
