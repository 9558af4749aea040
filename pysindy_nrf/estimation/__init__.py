"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = {
    "IVResult": "iv",
    "Location": "nonlinear_devices",
    "OutputErrorResult": "free_run_fit",
    "damper_force": "nonlinear_devices",
    "dissipated_energy": "nonlinear_devices",
    "energy_shares": "nonlinear_devices",
    "force_intervals": "intervals",
    "found_twice": "model_comparison",
    "horizontal_component": "nonlinear_devices",
    "instrumental_variables": "iv",
    "linear_part": "model_comparison",
    "linear_twin": "model_comparison",
    "locate_nonlinearity": "nonlinear_devices",
    "model_agreement": "model_comparison",
    "newey_west": "intervals",
    "output_error": "free_run_fit",
    "parameter_intervals": "intervals",
    "path_energy": "nonlinear_devices",
    "planarity": "nonlinear_devices",
    "power_energy": "nonlinear_devices",
    "total_mass": "model_comparison",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
