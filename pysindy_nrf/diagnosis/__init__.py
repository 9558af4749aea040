"""Diagnostics of forces, laws and balances of a fit, and the verdict on it.

Three questions to a residual need no law: ``detect`` (is it noise), ``localise`` (where
does it act), ``characterise`` (what does it depend on).
"""

from ..common.lazy import public_names

_NAMES = {
    "Dependence": "evidence.kinds",
    "Diagnosis": "limits",
    "Facts": "facts",
    "Feature": "evidence.kinds",
    "FreeRunFacts": "facts",
    "FreeRuns": "free_run",
    "GrowingMode": "facts",
    "Location": "evidence.kinds",
    "NoiseFloor": "evidence.noise_floor",
    "Reason": "rules",
    "ResidualKind": "evidence.kinds",
    "Verdict": "verdict",
    "characterise": "evidence.characterisation",
    "detect": "evidence.detection",
    "diagnose": "limits",
    "digits": "effects",
    "effect_words": "effects",
    "equivalent_modes": "modes",
    "facts_of_model": "facts",
    "force_delay": "force_delays",
    "free_runs": "free_run",
    "localise": "evidence.localisation",
    "loops_of": "site_loops",
    "modal_assurance": "modes",
    "residual_of": "residual",
    "spectral_line": "evidence.spectral_line",
    "verdict_after_search": "verdict",
    "verdict_from": "verdict",
    "warn_of_bias": "bias",
    "wiring_errors": "wiring",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
