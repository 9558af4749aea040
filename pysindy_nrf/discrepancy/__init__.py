"""Detect, locate, characterise and estimate what a model lacks.

``close_loop`` does all of it and returns a ``LoopReport``. ``default_catalogue`` lists
the laws that it tries. The questions to a residual that need no law are those of
:mod:`pysindy_nrf.diagnosis`.
"""

from ..common.lazy import public_names

_NAMES = {
    "Dependence": ".diagnosis.evidence.kinds",
    "Feature": ".diagnosis.evidence.kinds",
    "Location": ".diagnosis.evidence.kinds",
    "LoopReport": "report",
    "NoiseFloor": ".diagnosis.evidence.noise_floor",
    "ResidualKind": ".diagnosis.evidence.kinds",
    "Step": "report",
    "characterise": ".diagnosis.evidence.characterisation",
    "close_loop": "loop",
    "default_catalogue": "catalogue",
    "detect": ".diagnosis.evidence.detection",
    "localise": ".diagnosis.evidence.localisation",
    "spectral_line": ".diagnosis.evidence.spectral_line",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
