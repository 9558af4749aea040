"""Full disk, unwritable folder, killed process, Ctrl-C: the old file survives.

Nothing half-written is taken for a result.
"""

import ast
import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from sources import trees

from pysindy_nrf import ChainModel, datasets, laws
from pysindy_nrf.cli import ExitCode, run
from pysindy_nrf.records.files import write_table

MODEL = ChainModel(
    [10.0, 12.0], {1: laws.LinearElastic(1e5), 2: laws.Dahl(sigma=1e3, Fd=20.0)}
)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """A folder with a record, and the results of an earlier run."""
    folder = tmp_path_factory.mktemp("earlier")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        datasets.load_demo().to_frame().iloc[:3000].to_csv("test.csv")
        command = ["identify", "test.csv", "-o", "out", "--degree", "1"]
        assert run([*command, "--no-figures"]) == 0
    return folder


@pytest.fixture
def finished(earlier, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(earlier, tmp_path, dirs_exist_ok=True))
    return tmp_path


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def is_sentence(text):
    return "Traceback" not in text and "fault of pysindy-nrf" not in text


# -- writing fails -------------------------------------------------------------


def test_no_space_left_is_said_in_words(finished, monkeypatch, capsys):
    old = contents(finished / "out")

    def no_space(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", no_space)
    assert run(["identify", "test.csv", "-o", "out", "--degree", "2"]) == ExitCode.OTHER
    text = capsys.readouterr().err
    assert "out/" in text
    assert "Make room there" in text
    assert is_sentence(text)
    assert contents(finished / "out") == old


@pytest.mark.parametrize("folder", ["test.csv/inside", "test.csv"])
def test_a_folder_that_cannot_be_made(finished, capsys, folder):
    before = Path("test.csv").read_bytes()
    command = ["identify", "test.csv", "-o", folder, "--degree", "1"]
    assert run(command) in (ExitCode.OTHER, ExitCode.USAGE)
    text = capsys.readouterr().err
    assert "test.csv" in text
    assert is_sentence(text)
    assert Path("test.csv").read_bytes() == before


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_the_old_file_survives_a_failure(tmp_path, monkeypatch, failure):
    path = tmp_path / "model.json"
    path.write_text("old")

    def fail(handle):
        raise failure

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(failure):
        MODEL.to_json(path)
    assert contents(tmp_path) == {"model.json": b"old"}


# -- the process is stopped ----------------------------------------------------

SLOW_WRITE = """
import os, signal, sys, time
from pysindy_nrf import ChainModel, laws
# a parent in the background ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
def wait(handle):
    print("writing", flush=True)
    time.sleep(60)
os.fsync = wait
ChainModel([1.0], {1: laws.LinearElastic(1e4)}).to_json(sys.argv[1])
"""


@pytest.fixture
def written(tmp_path):
    """The file of a model."""
    path = tmp_path / "model.json"
    MODEL.to_json(path)
    return path


def stop_while_writing(path, how):
    """Stop a process that writes over a file; the file as it was meanwhile."""
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW_WRITE, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with process:
        assert process.stdout.readline() == "writing\n"
        meanwhile = path.read_bytes()
        process.send_signal(how)
        assert process.wait(30) != 0
    return meanwhile


STOPS = pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])


@STOPS
def test_the_old_file_survives_a_process_that_is_stopped(written, how):
    old = written.read_bytes()
    assert stop_while_writing(written, how) == old
    assert written.read_bytes() == old
    assert ChainModel.from_json(written) == MODEL


@STOPS
def test_what_a_stopped_process_leaves_is_never_taken_for_a_result(written, how):
    stop_while_writing(written, how)
    others = [path.name for path in written.parent.iterdir() if path != written]
    assert all(name.startswith(".model.json.") for name in others)
    assert all(name.endswith(".part") for name in others)
    if how == signal.SIGINT:  # Python has time to clean up
        assert not others


@STOPS
def test_the_next_run_cleans_up(written, how):
    stop_while_writing(written, how)
    MODEL.with_laws({1: [laws.LinearElastic(2e5)]}).to_json(written)
    assert ChainModel.from_json(written) != MODEL
    assert list(written.parent.iterdir()) == [written]


# -- one door ------------------------------------------------------------------


def test_folders_are_made_and_texts_written_in_utf_8(tmp_path):
    path = tmp_path / "a" / "b" / "table.csv"
    write_table(pd.DataFrame({"größe": [1]}), path)
    assert path.read_bytes() == "größe\n1\n".encode()


def permissions(path):
    return path.stat().st_mode & 0o777


def test_permissions_are_kept(tmp_path):
    path = tmp_path / "model.json"
    path.touch()
    path.chmod(0o640)
    MODEL.to_json(path)
    assert permissions(path) == 0o640


def test_permissions_of_new_files_are_the_usual_ones(tmp_path):
    usual = tmp_path / "usual"
    usual.touch()
    MODEL.to_json(tmp_path / "new")
    assert permissions(tmp_path / "new") == permissions(usual)


# What else may write, with the reason.
WRITERS = {
    "common/compiled.py": "Numba's cache of compiled code",
    "records/files/formats/numeric_arrays.py": "arrays for the parent process",
}
WRITING_CALLS = {
    "write_text",
    "write_bytes",
    "savefig",
    "savez",
    "savemat",
    "to_parquet",
    "to_csv",
}
# Names of buffers and open files, which may be written to.
MEMORY = {"buffer", "file", "stream", "memory", "out"}


def inside_the_door(tree):
    """Calls inside a ``with atomic_write(...)`` block."""
    inside = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.With):
            opened = ast.unparse(node.items[-1].context_expr)
            if "atomic_write" in opened:
                inside.update(ast.walk(node))
    return inside


def writes(call):
    """Whether a call writes a file."""
    name = ast.unparse(call.func).rpartition(".")[2]
    if name == "open":
        return opens_to_write(call)
    if name not in WRITING_CALLS:
        return False
    if not call.args:
        return bool(call.keywords)  # else it returns a text
    return ast.unparse(call.args[0]) not in MEMORY


def opens_to_write(call):
    """Whether ``open`` has a mode that writes."""
    modes = call.args[1:2]
    modes += [keyword.value for keyword in call.keywords if keyword.arg == "mode"]
    constants = [mode.value for mode in modes if isinstance(mode, ast.Constant)]
    return any(set(str(mode)) & set("wax+") for mode in constants)


def test_every_file_is_written_through_the_one_door():
    wrong = []
    for where, tree in trees():
        inside = inside_the_door(tree)
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        for call in calls:
            if where not in WRITERS and call not in inside and writes(call):
                wrong.append(f"{where}:{call.lineno} {ast.unparse(call)[:80]}")
    assert not wrong, "\n".join(wrong)
