"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = {
    "IVResult": "iv",
    "Location": "nonlinearity_location",
    "OutputErrorResult": "free_run_fit",
    "damper_force": "device_forces",
    "dissipated_energy": "device_forces",
    "energy_shares": "device_forces",
    "force_intervals": "intervals",
    "found_twice": "agreement",
    "horizontal_component": "device_forces",
    "instrumental_variables": "iv",
    "linear_part": "linear_model",
    "linear_twin": "linear_model",
    "locate_nonlinearity": "nonlinearity_location",
    "model_agreement": "agreement",
    "newey_west": "intervals",
    "output_error": "free_run_fit",
    "parameter_intervals": "intervals",
    "path_energy": "device_forces",
    "planarity": "nonlinearity_location",
    "power_energy": "device_forces",
    "total_mass": "agreement",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
