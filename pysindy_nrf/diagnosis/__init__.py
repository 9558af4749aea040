"""Diagnostics of forces, laws and balances of a fit, and planning of the next test."""

from ..common.lazy import public_names

_NAMES = {
    "Facts": "facts",
    "Verdict": "verdict",
    "force_delay": "force_delays",
    "residual_of": "residual",
    "verdict_from": "verdict",
    "warn_of_bias": "bias",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
