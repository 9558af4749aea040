"""Estimates that survive measurement noise, and how far they can be trusted."""

from ..common.lazy import public_names

_FOR_USERS = {
    "damper_force": "device_forces",
    "dissipated_energy": "device_forces",
    "linear_part": "device_forces",
}
_FOR_OTHER_LAYERS = {
    "FreeRunFit": "free_run_fit",
    "choose_method": "door",
    "form_of": "door",
    "free_parameters": "parameter_vector",
    "newey_west": "intervals",
    "shot_of": "channel_shots",
    "shots_of": "shots",
    "transfer": "linear_response",
    "with_decaying_modes": "instruments",
}
__all__ = [*_FOR_USERS]

__getattr__, __dir__ = public_names(__name__, _FOR_USERS | _FOR_OTHER_LAYERS)
