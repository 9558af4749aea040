"""Audit trail: the settings of a run and the versions of all packages."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

# Characters of one setting.
MAX_SETTING_CHARACTERS = 2000
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
    versions_by_package = {"Python": platform.python_version()}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions_by_package[name] = metadata.version(name)
    return versions_by_package


def settings_of(**groups: Mapping[str, object]) -> dict[str, dict[str, str]]:
    """Settings as text, by group; the values themselves are not kept."""
    texts = {}
    for name, values in groups.items():
        group = {str(key): _text(value) for key, value in values.items()}
        texts[name.replace("_", " ")] = group
    return texts


def constants_of(groups: Mapping[str, DataclassInstance]) -> dict[str, object]:
    """Numbers that no argument changes: fields of dataclasses of settings, by group."""
    numbers: dict[str, object] = {}
    for group, settings in groups.items():
        for setting in fields(settings):
            name = setting.name.replace("_", " ")
            numbers[f"{group}: {name}"] = getattr(settings, setting.name)
    return numbers


def _text(value: object) -> str:
    if isinstance(value, np.random.Generator):
        return f"a {type(value.bit_generator).__name__} generator given by the caller"
    name = getattr(value, "__name__", None)
    if callable(value) and name is not None:
        return str(name)

    text = value if isinstance(value, str) else " ".join(repr(value).split())
    if len(text) > MAX_SETTING_CHARACTERS:
        text = f"{text[: MAX_SETTING_CHARACTERS - 3]}..."
    return text
