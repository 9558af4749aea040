"""Full disk, unwritable folder, killed process, Ctrl-C: the old file survives, nothing
half-written is taken for a result.
"""

import ast
import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sources import trees

from pysindy_nrf import ChainModel, datasets, laws
from pysindy_nrf.cli.group import run
from pysindy_nrf.common.files import atomic_write

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
        assert (
            run(["identify", "test.csv", "-o", "out", "--degree", "1", "--no-figures"])
            == 0
        )
    return folder


@pytest.fixture
def finished(earlier, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(earlier, tmp_path, dirs_exist_ok=True))
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def test_no_space_left_is_said_in_words(finished, monkeypatch, capsys):
    old = contents(finished / "out")

    def no_space(handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", no_space)
    assert run(["identify", "test.csv", "-o", "out", "--degree", "2"]) == 1
    said = capsys.readouterr().err
    assert (
        "out/" in said
        and "No space left on device. Make room there" in said
        and "Traceback" not in said
        and "fault of pysindy-nrf" not in said
    )
    assert contents(finished / "out") == old


@pytest.mark.parametrize("folder", ["test.csv/inside", "test.csv"])
def test_a_folder_that_cannot_be_made(finished, capsys, folder):
    before = Path("test.csv").read_bytes()
    assert run(["identify", "test.csv", "-o", folder, "--degree", "1"]) in (1, 2)
    said = capsys.readouterr().err
    assert (
        "test.csv" in said
        and "Traceback" not in said
        and "fault of pysindy-nrf" not in said
    )
    assert Path("test.csv").read_bytes() == before


SLOW_WRITE = """
import signal, sys, time
from pysindy_nrf.common.files import atomic_write
signal.signal(signal.SIGINT, signal.default_int_handler)  # a parent in the background ignores it
with atomic_write(sys.argv[1]) as file:
    file.write("half of the new")
    file.flush()
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_process_that_is_stopped_while_it_writes(tmp_path, how):
    path = tmp_path / "model.json"
    MODEL.to_json(path)
    old = path.read_bytes()
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW_WRITE, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout.readline() == "writing\n"
    assert path.read_bytes() == old  # while it writes, too
    process.send_signal(how)
    assert process.wait(30) != 0
    process.stdout.close()
    assert path.read_bytes() == old and ChainModel.from_json(path) == MODEL
    left = [p for p in tmp_path.iterdir() if p != path]
    assert all(
        p.name.startswith(".model.json.") and p.suffix == ".part" for p in left
    )  # never taken for a result
    assert not left or how != signal.SIGINT
    MODEL.with_laws({1: laws.LinearElastic(2e5)}).to_json(
        path
    )  # the next run is not in the way of it, and cleans up
    assert ChainModel.from_json(path) != MODEL and [
        p.name for p in tmp_path.iterdir()
    ] == ["model.json"]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_the_old_file_survives_a_failure(tmp_path, failure):
    path = tmp_path / "model.json"
    path.write_text("old")
    with pytest.raises(failure), atomic_write(path) as file:
        file.write("half of the new")
        raise failure
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]


def test_bytes_text_folder_and_permissions(tmp_path):
    path = tmp_path / "a" / "b" / "table.csv"
    with atomic_write(path) as file:
        file.write("größe\n")
    assert path.read_bytes() == "größe\n".encode()
    path.chmod(0o640)
    with atomic_write(path, "wb") as file:
        file.write(b"\x00\r\n")
    assert path.read_bytes() == b"\x00\r\n"
    assert path.stat().st_mode & 0o777 == 0o640
    plain = tmp_path / "plain"
    plain.touch()
    with atomic_write(tmp_path / "new") as file:
        file.write("")
    assert (tmp_path / "new").stat().st_mode == plain.stat().st_mode


# What else may write, with the reason.
WRITERS = {"laws/compiled.py": "Numba's cache of compiled code"}


def test_every_file_is_written_through_the_one_door():
    wrong = []
    for where, tree in trees():
        if where in WRITERS:
            continue
        inside = {
            id(inner)
            for node in ast.walk(tree)
            if isinstance(node, ast.With)
            and "atomic_write" in ast.unparse(node.items[0].context_expr)
            for inner in ast.walk(node)
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or id(node) in inside:
                continue
            name = (
                node.func.attr
                if isinstance(node.func, ast.Attribute)
                else getattr(node.func, "id", "")
            )
            mode = ast.unparse(node.args[1]) if len(node.args) > 1 else ""
            mode += "".join(
                ast.unparse(k.value) for k in node.keywords if k.arg == "mode"
            )
            opens = name == "open" and any(c in mode for c in "wax+") and "'" in mode
            if opens or name in (
                "write_text",
                "write_bytes",
                "savefig",
                "savez",
                "savemat",
                "to_parquet",
                "to_csv",
            ):
                if not _to_memory(node):
                    wrong.append(f"{where}:{node.lineno} {ast.unparse(node)[:80]}")
    assert not wrong, "\n".join(wrong)


def _to_memory(node: ast.Call) -> bool:
    """Whether the target is a buffer or an open file rather than a path."""
    target = ast.unparse(node.args[0]) if node.args else ""
    return target in ("buffer", "file", "stream", "memory", "out") or (
        not node.args and not node.keywords
    )
