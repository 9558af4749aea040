"""Masses and nonlinear restoring forces of chain-like structures from measured forces and motions."""

from importlib import import_module as _import_module
from typing import Any as _Any

from . import exceptions, laws
from .chain import Chain
from .record import Record
from .sites import Site

__version__ = "0.1.0"

# Public name -> the module that defines it. Resolved on first use (PEP 562), so that
# `import pysindy_nrf` loads neither PySINDy nor numba nor scipy.signal.
_LAZY = {
    "ChainModel": "model",
    "ChainOptimizer": "optimizers",
    "FairFilter": "fair_filter",
    "ForceLawLibrary": "feature_library",
    "InterstoryPolynomialLibrary": "feature_library",
    "KinematicSmoother": "signals",
    "NRFRegressor": "regressor",
    "StateSpaceChainOptimizer": "optimizers",
    "close_loop": "discrepancy",
    "compare_with_sindy": "comparison",
    "BlockedTimeSplit": "model_selection",
    "OrderSelection": "model_selection",
    "RecordSplit": "model_selection",
    "one_standard_error": "model_selection",
    "select_order": "model_selection",
    "select_sparsity": "model_selection",
    "simulate": "simulation",
}
_LAZY_MODULES = (
    "alignment",
    "analysis",
    "channel_checks",
    "comparison",
    "condensation",
    "constraints",
    "datasets",
    "discrepancy",
    "displays",
    "distributed",
    "errors",
    "estimation",
    "excitation",
    "guidance",
    "io",
    "model_selection",
    "noise",
    "report",
    "scorers",
    "signals",
    "state_space",
    "streaming",
)

__all__ = ["Chain", "Record", "Site", "exceptions", "laws", *_LAZY, *_LAZY_MODULES]


def __getattr__(name: str) -> _Any:
    if name in _LAZY:
        value = getattr(_import_module(f".{_LAZY[name]}", __name__), name)
    elif name in _LAZY_MODULES:
        value = _import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
