"""Tools of all layers: late imports, files, random states, threads, settings, the jackknife."""

from typing import Any


def number_of(value: Any) -> float:
    """A value as a float; NaN if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
