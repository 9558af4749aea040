"""Late imports: public names of a package (PEP 562), optional packages, hooks."""

import sys
from collections.abc import Callable, Mapping
from enum import Enum
from importlib import import_module
from pkgutil import resolve_name
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
        setattr(sys.modules[package], name, value)
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


class Hook(Enum):
    """Functions of upper layers that objects of lower layers offer as methods."""

    PLAN = "pysindy_nrf.diagnosis.planning:plan"
    TO_FEATURES = "pysindy_nrf.records.fusion.kinematics:to_features"
    SIMULATE = "pysindy_nrf.simulation:simulate"
    TO_SINDY = "pysindy_nrf.sindy.feature_library:to_sindy"
    FROM_SINDY = "pysindy_nrf.sindy.feature_library:from_sindy"
    ORDER_FIGURE = "pysindy_nrf.report.figures.motion:order_drawing"
    MODEL_FIGURE = "pysindy_nrf.report.content:drawing"
    PAGE = "pysindy_nrf.report:write_html"
    RECORD_HTML = "pysindy_nrf.report.write:record_html"
    LATEX = "pysindy_nrf.chain.latex:latex"
    MODEL_HTML = "pysindy_nrf.report.write:model_html"
    LOOP_MARKDOWN = "pysindy_nrf.report.write:markdown"
    LOOP_VERDICT = "pysindy_nrf.report.content:loop_verdict"
    LOOP_HTML = "pysindy_nrf.report.write:loop_html"

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Call the function and return its result."""
        return resolve_name(self.value)(*args, **options)
