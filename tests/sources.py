"""The modules of the package as syntax trees, each parsed once."""

import ast
from functools import cache
from pathlib import Path

import pysindy_nrf

PACKAGE = Path(pysindy_nrf.__file__).parent


@cache
def trees():
    """Pairs of a module's path below the package and its tree."""
    paths = sorted(PACKAGE.rglob("*.py"))
    return [
        (str(p.relative_to(PACKAGE)), ast.parse(p.read_text(encoding="utf-8")))
        for p in paths
    ]
