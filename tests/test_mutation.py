"""The mutation benchmark leaves out what does not run, and knows where everything is."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
if not (ROOT / "benchmarks").is_dir():
    pytest.skip("the benchmarks are not part of an installed package", allow_module_level=True)
sys.path.insert(0, str(ROOT / "benchmarks"))

import mutation  # noqa: E402


def test_modules_and_tests_exist():
    for modules, tests in mutation.PARTS.values():
        for path in (*modules, *tests):
            assert (ROOT / path).exists(), path


def test_annotations_are_known(tmp_path):
    path = tmp_path / "code.py"
    path.write_text("from __future__ import annotations\n\n\ndef half(x: int | None, y=1 | 2) -> float | None:\n    return x / 2\n")
    idle = mutation.idle_lines(path)
    line = path.read_text().splitlines()[3]
    assert (4, line.index("|")) in idle and (4, line.rindex("|")) in idle
    assert (4, line.index("1 | 2") + 2) not in idle and (5, 13) not in idle


def test_the_copy_holds_package_and_tests_and_nothing_compiled(tmp_path):
    home = mutation.copied(tmp_path)
    assert (home / "pysindy_nrf" / "__init__.py").is_file() and (home / "tests" / "conftest.py").is_file()
    assert not list(home.rglob("*.nbi")) and not list(home.rglob("__pycache__"))


def test_a_fault_is_put_in_and_taken_out(tmp_path):
    pytest.importorskip("cosmic_ray")
    path, source = tmp_path / "code.py", "def half(x: int | None):\n    return x / 2\n"
    path.write_text(source)
    written = path.stat().st_mtime_ns
    every = mutation.mutants(tmp_path, ["code.py"], 0, 0)
    assert len(every) > 3 and {m.start_pos[0] for m in every} == {2}  # none in the annotation
    for fault in every:
        with mutation.faulty(fault):
            assert path.read_text() != source and path.stat().st_mtime_ns == 0
        assert path.read_text() == source and path.stat().st_mtime_ns == written
    few = [mutation.mutants(tmp_path, ["code.py"], 3, 5) for _ in range(2)]
    assert few[0] == few[1] and len(few[0]) == 3


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks")
def test_a_run_passes_fails_or_is_ended(tmp_path):
    body = {"good": "assert half(4) == 2", "bad": "assert half(4) == 3", "endless": "import time; time.sleep(600)"}
    (tmp_path / "code_of_the_user.py").write_text("def half(x):\n    return x / 2\n")
    for name, line in body.items():
        text = f"from code_of_the_user import half\n\n\ndef test_it():\n    {line}\n"
        (tmp_path / f"test_{name}.py").write_text(text)
    assert mutation.passes(tmp_path, ["test_good.py"], 60)
    assert not mutation.passes(tmp_path, ["test_bad.py"], 60)
    assert "half(4) == 3" in (tmp_path / "log").read_text()
    assert not mutation.passes(tmp_path, ["test_endless.py"], 5)
    assert "code_of_the_user" not in sys.modules


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that forks")
def test_a_line_is_answered_for_by_the_tests_that_come_by_it(tmp_path):
    pytest.importorskip("pytest_cov")
    (tmp_path / "own").mkdir()
    path = tmp_path / "own" / "sides.py"
    path.write_text("TWO = 2\n\n\ndef half(x):\n    return x / TWO\n\n\ndef double(x):\n    return x * TWO\n")
    lines = [
        "import time",
        "from own.sides import double, half",
        "def test_both():",
        "    time.sleep(0.2)",
        "    assert double(half(3)) == 3",
        "def test_half():",
        "    assert half(4) == 2",
    ]
    (tmp_path / "test_sides.py").write_text("\n".join(lines))
    witnesses = mutation.Witnesses(tmp_path, ["own"], ["test_sides.py"])
    half, both = "test_sides.py::test_half", "test_sides.py::test_both"
    assert witnesses.of(path, 5) == [half, both]  # the fastest first
    assert witnesses.of(path, 9) == [both]
    assert witnesses.of(path, 1) == [half, both]  # a constant: whoever comes by its module
    assert witnesses.seconds[both] >= 0.2
