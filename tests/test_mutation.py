"""The mutation benchmark leaves out what does not run, and knows where everything is."""

from __future__ import annotations

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
