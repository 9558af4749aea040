"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = {
    "damper_force": "nonlinear_devices",
    "dissipated_energy": "nonlinear_devices",
    "energy_shares": "nonlinear_devices",
    "found_twice": "model_comparison",
    "horizontal_component": "nonlinear_devices",
    "linear_part": "model_comparison",
    "linear_twin": "model_comparison",
    "locate_nonlinearity": "nonlinear_devices",
    "model_agreement": "model_comparison",
    "path_energy": "nonlinear_devices",
    "planarity": "nonlinear_devices",
    "total_mass": "model_comparison",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
