"""Audit trail: the settings of a run and the versions of all packages."""

import platform
from collections.abc import Mapping
from contextlib import suppress
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


def constants_of(*modules: Any) -> dict[str, Any]:
    """Constants of modules (names in capitals): what no argument changes."""
    constants = {}
    for module in modules:
        for name, value in vars(module).items():
            is_public_constant = name.isupper() and not name.startswith("_")
            if is_public_constant and _is_plain(value):
                constants[name.lower().replace("_", " ")] = value
    return constants


def _is_plain(value: Any) -> bool:
    return isinstance(value, (int, float, tuple, dict)) and not isinstance(value, bool)


def _text(value: Any) -> str:
    if isinstance(value, np.random.Generator):
        return f"a {type(value.bit_generator).__name__} generator given by the caller"
    if callable(value) and hasattr(value, "__name__"):
        return str(value.__name__)

    text = value if isinstance(value, str) else " ".join(repr(value).split())
    if len(text) > MAX_TEXT_LENGTH:
        text = f"{text[: MAX_TEXT_LENGTH - 3]}..."
    return text
