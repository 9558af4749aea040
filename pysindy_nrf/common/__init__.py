"""Tools of all layers: late imports, files, random states, threads, settings, the jackknife."""

from typing import Any


def number_of(value: Any) -> float:
    """A value as a float; NaN if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def positive(name: str, value: Any, cure: str, error: type[Exception]) -> float:
    """A positive number, or an error of the given kind."""
    number = number_of(value)
    if not 0 < number < float("inf"):
        raise error(f"{name}={value!r} is not a positive number", cure)
    return number
