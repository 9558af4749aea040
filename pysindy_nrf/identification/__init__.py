"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_NAMES = {
    "FreeRunFit": "free_run_fit",
    "choose_method": "door",
    "damper_force": "device_forces",
    "dissipated_energy": "device_forces",
    "form_of": "door",
    "free_parameters": "parameter_vector",
    "linear_part": "device_forces",
    "newey_west": "intervals",
    "shot_of": "channel_shots",
    "shots_of": "shots",
    "transfer": "linear_response",
    "with_decaying_modes": "instruments",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = public_names(__name__, _NAMES)
