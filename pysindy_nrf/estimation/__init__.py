"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = {
    "damper_force": "nonlinear_devices", "dissipated_energy": "nonlinear_devices", "energy_shares": "nonlinear_devices",
    "found_twice": "nonlinear_devices", "linear_part": "nonlinear_devices",
    "linear_twin": "nonlinear_devices", "path_energy": "nonlinear_devices",
}  # fmt: skip
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
