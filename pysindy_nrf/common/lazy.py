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
    """``__getattr__`` and ``__dir__`` of a package that imports its names on first use.

    Parameters
    ----------
    package : str
        Its ``__name__``.
    names : mapping of str to str
        Public name to the module below the package that defines it.
    modules : mapping of str to str, optional
        Public name to a module below the package.
    """
    modules = modules or {}

    def getattr_of_package(name: str) -> Any:
        if name in names:
            value = getattr(import_module(f".{names[name]}", package), name)
        elif name in modules:
            value = import_module(f".{modules[name]}", package)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        vars(sys.modules[package])[name] = value
        return value

    def dir_of_package() -> list[str]:
        return sorted({*vars(sys.modules[package]), *names, *modules})

    return getattr_of_package, dir_of_package


def require(package: str, extra: str, purpose: str) -> ModuleType:
    """An optional package.

    Raises
    ------
    MissingExtraError
        If it is not installed; the message names the extra that brings it.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise MissingExtraError(package.split(".")[0], extra, purpose) from error
