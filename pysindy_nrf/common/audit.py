"""Audit trail: the settings of a run and the versions of all packages."""

import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from importlib import metadata
from typing import Any

import numpy as np

MAX_TEXT_LENGTH = 2000  # of one setting
PACKAGES = (
    "pysindy_nrf",
    "pysindy",
    "numpy",
    "scipy",
    "scikit-learn",
    "pandas",
    "numba",
    "plotly",
    "jinja2",
)


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the packages it depends on."""
    found = {"Python": platform.python_version()}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def settings_of(**groups: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Settings as text, by group; the values themselves are not kept."""
    texts = {}
    for name, values in groups.items():
        group = {str(key): _text(value) for key, value in values.items()}
        texts[name.replace("_", " ")] = group
    return texts


def constants_of(groups: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers that no argument changes: fields of dataclasses of settings, by group."""
    numbers = {}
    for group, settings in groups.items():
        for one in fields(settings):
            name = one.name.replace("_", " ")
            numbers[f"{group}: {name}"] = getattr(settings, one.name)
    return numbers


def _text(value: Any) -> str:
    if isinstance(value, np.random.Generator):
        return f"a {type(value.bit_generator).__name__} generator given by the caller"
    if callable(value) and hasattr(value, "__name__"):
        return str(value.__name__)

    text = value if isinstance(value, str) else " ".join(repr(value).split())
    if len(text) > MAX_TEXT_LENGTH:
        text = f"{text[: MAX_TEXT_LENGTH - 3]}..."
    return text
