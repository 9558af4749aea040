"""Public names of a package, resolved on first use (PEP 562), so that importing it loads none of its modules."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def public_names(
    package: str, names: Mapping[str, str], modules: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package: public name to the module that defines it, and whole modules."""
    whole = dict(modules or {})

    def get(name: str) -> Any:
        if name in names:
            value = getattr(import_module(f".{names[name]}", package), name)
        elif name in whole:
            value = import_module(f".{whole[name]}", package)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *names, *whole})

    return get, listed
