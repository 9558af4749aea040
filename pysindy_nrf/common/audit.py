"""Audit trail: the settings of a run and the versions of all packages."""

import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from importlib import metadata
from typing import Any

_MOST = 2000
_PACKAGES = (
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
    out = {"Python": platform.python_version()}
    for name in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            out[name] = metadata.version(name)
    return out


def settings_of(**groups: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Settings as text, by group; the values themselves are not kept."""
    return {
        name.replace("_", " "): {str(k): _text(v) for k, v in values.items()}
        for name, values in groups.items()
    }


def constants_of(groups: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers that no argument changes: fields of dataclasses of settings, by group."""
    numbers = {}
    for group, settings in groups.items():
        for one in fields(settings):
            name = one.name.replace("_", " ")
            numbers[f"{group}: {name}"] = getattr(settings, one.name)
    return numbers


def _text(value: Any) -> str:
    import numpy as np

    if isinstance(value, np.random.Generator):
        return f"a {type(value.bit_generator).__name__} generator given by the caller"
    if callable(value) and hasattr(value, "__name__"):
        return str(value.__name__)
    text = " ".join(repr(value).split()) if not isinstance(value, str) else value
    return text if len(text) <= _MOST else f"{text[: _MOST - 3]}..."
