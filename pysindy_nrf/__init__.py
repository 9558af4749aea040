"""Masses and nonlinear restoring forces of chain-like structures from measurements."""

from . import exceptions, laws
from .chain.sites import Site
from .chain.structure import Chain
from .common.lazy import public_names
from .records.record import Record

__version__ = "0.1.0"

# Public name -> the module that defines it. Resolved on first use (PEP 562), so that
# `import pysindy_nrf` loads neither PySINDy nor numba nor scipy.signal.
_LAZY = {
    "ChainModel": "chain.model",
    "ChainOptimizer": "sindy.optimizers",
    "ZeroPhaseFilter": "records.zero_phase_filter",
    "ForceLawLibrary": "sindy.feature_library",
    "InterstoryPolynomialLibrary": "sindy.feature_library",
    "KinematicSmoother": "records.fusion",
    "NRFRegressor": "identification.regressor",
    "StateSpaceChainOptimizer": "sindy.optimizers",
    "Parameter": "identification.parameters",
    "Problem": "identification.problem",
    "FreeRunDisplay": "report.displays",
    "HysteresisDisplay": "report.displays",
    "IntervalsDisplay": "report.displays",
    "ModesDisplay": "report.displays",
    "ResidualDisplay": "report.displays",
    "RestoringForceDisplay": "report.displays",
    "StepsDisplay": "report.displays",
    "close_loop": "discrepancy",
    "compare_with_sindy": "sindy.comparison",
    "BlockedTimeSplit": "selection",
    "one_standard_error": "selection",
    "select_order": "selection",
    "select_sparsity": "selection",
    "simulate": "simulation",
}
# Layers and the modules that users name, by the name under which `from pysindy_nrf
# import ...` gives them.
_LAZY_MODULES = {
    "chain": "chain",
    "datasets": "datasets",
    "diagnosis": "diagnosis",
    "discrepancy": "discrepancy",
    "equations": "equations",
    "excitation": "simulation.excitation",
    "identification": "identification",
    "io": "records.files",
    "monitoring": "monitoring",
    "records": "records",
    "report": "report",
    "scorers": "selection.scorers",
    "selection": "selection",
    "simulation": "simulation",
    "sindy": "sindy",
    "streaming": "identification.streaming",
}

__all__ = ["Chain", "Record", "Site", "exceptions", "laws", *_LAZY, *_LAZY_MODULES]

__getattr__, __dir__ = public_names(__name__, _LAZY, _LAZY_MODULES)
