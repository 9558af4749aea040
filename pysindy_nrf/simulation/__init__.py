"""Free runs of chain models under sampled forces."""

from ..common.lazy import public_names

_NAMES = {
    "FreeRun": "api",
    "add_noise": "noise",
    "classical_run": "api",
    "free_run": "api",
    "simulate": "api",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
