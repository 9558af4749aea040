"""Detect, locate, characterise and estimate what a model lacks.

``close_loop`` does all of it and returns a ``LoopReport``. ``default_catalogue`` lists
the laws that it tries. Its questions to a residual can be asked alone: ``detect`` (is
it noise), ``localise`` (where does it act), ``characterise`` (what does it depend on).
"""

from ..common.lazy import public_names

_NAMES = {
    "Dependence": "residual.kinds",
    "Feature": "residual.kinds",
    "Location": "residual.kinds",
    "LoopReport": "report",
    "NoiseFloor": "residual.noise_floor",
    "ResidualKind": "residual.kinds",
    "Step": "report",
    "characterise": "residual.characterisation",
    "close_loop": "loop",
    "default_catalogue": "catalogue",
    "detect": "residual.detection",
    "localise": "residual.localisation",
    "spectral_line": "residual.spectral_line",
}
__all__ = [*_NAMES]

__getattr__, __dir__ = public_names(__name__, _NAMES)
