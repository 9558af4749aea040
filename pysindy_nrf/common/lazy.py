"""Late imports: public names of a package (PEP 562) and optional packages."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from ..exceptions import MissingExtraError


def public_names(
    package: str, names: Mapping[str, str], modules: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package: public name to the module that
    defines it, and whole modules.
    """
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


def require(package: str, extra: str, purpose: str) -> ModuleType:
    """The optional package; raises MissingExtraError, which names the extra to
    install.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingExtraError(package.split(".")[0], extra, purpose) from error
