"""The modules of the package as syntax trees, each parsed once."""

import ast
from functools import cache
from pathlib import Path

import pysindy_nrf

PACKAGE = Path(pysindy_nrf.__file__).parent


@cache
def trees():
    """Pairs of a module's path below the package and its tree."""
    parsed = []
    for path in sorted(PACKAGE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parsed.append((path.relative_to(PACKAGE).as_posix(), tree))
    return parsed
