"""Masses and nonlinear restoring forces of chain-like structures from measured forces
and motions.
"""

from . import exceptions, laws
from .common.lazy import public_names
from .data.record import Record
from .mechanics.chain import Chain
from .mechanics.sites import Site

__version__ = "0.1.0"

# Public name -> the module that defines it. Resolved on first use (PEP 562), so that
# `import pysindy_nrf` loads neither PySINDy nor numba nor scipy.signal.
_LAZY = {
    "ChainModel": "regression.chain_model",
    "ChainOptimizer": "regression.optimizers",
    "FairFilter": "signals.zero_phase_filter",
    "ForceLawLibrary": "regression.feature_library",
    "InterstoryPolynomialLibrary": "regression.feature_library",
    "KinematicSmoother": "signals",
    "NRFRegressor": "estimation.regressor",
    "StateSpaceChainOptimizer": "regression.optimizers",
    "Problem": "estimation.problem",
    "close_loop": "discrepancy",
    "compare_with_sindy": "selection.comparison",
    "BlockedTimeSplit": "selection",
    "RecordSplit": "selection",
    "one_standard_error": "selection",
    "select_order": "selection",
    "select_sparsity": "selection",
    "simulate": "simulation",
}
# Layers and the modules that users name, by the name under which `from pysindy_nrf
# import ...` gives them.
_LAZY_MODULES = {
    "data": "data",
    "datasets": "datasets",
    "diagnostics": "diagnostics",
    "discrepancy": "discrepancy",
    "estimation": "estimation",
    "excitation": "simulation.excitation",
    "io": "data.io",
    "mechanics": "mechanics",
    "monitoring": "monitoring",
    "output": "output",
    "regression": "regression",
    "scorers": "selection.scorers",
    "selection": "selection",
    "signals": "signals",
    "simulation": "simulation",
    "streaming": "estimation.streaming",
}

__all__ = ["Chain", "Record", "Site", "exceptions", "laws", *_LAZY, *_LAZY_MODULES]

__getattr__, __dir__ = public_names(__name__, _LAZY, _LAZY_MODULES)
