"""Optional dependencies, imported where they are used."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..exceptions import MissingExtraError


def require(package: str, extra: str, purpose: str) -> ModuleType:
    """Import an optional package or say which extra brings it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtraError(package.split(".")[0], extra, purpose) from error
