"""Diagnostics of forces, laws and balances of a fit, and the verdict on it."""

from ..common.lazy import public_names

_NAMES = {
    "Diagnosis": "limits",
    "Facts": "facts",
    "FreeRunFacts": "facts",
    "FreeRuns": "free_run",
    "GrowingMode": "facts",
    "Reason": "rules",
    "Verdict": "verdict",
    "diagnose": "limits",
    "digits": "effects",
    "effect_words": "effects",
    "equivalent_modes": "modes",
    "facts_of_model": "facts",
    "force_delay": "force_delays",
    "free_runs": "free_run",
    "loops_of": "site_loops",
    "modal_assurance": "modes",
    "residual_of": "residual",
    "verdict_after_search": "verdict",
    "verdict_from": "verdict",
    "warn_of_bias": "bias",
    "wiring_errors": "wiring",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
