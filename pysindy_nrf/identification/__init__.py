"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = dict.fromkeys(
    ("damper_force", "dissipated_energy", "linear_part"), "device_forces"
)
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
