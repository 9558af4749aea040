"""Diagnosis of the residual: is it noise, where does it act, what is it like."""

from .characterisation import Characterisation, characterise
from .detection import Detection, detect
from .diagnosed_data import DiagnosedData
from .evidence import Evidence, evidence_of
from .kinds import Dependence, Feature, Location, Obstacle, ResidualKind
from .localisation import Localisation
from .noise_floor import NoiseFloor

__all__ = [
    "Characterisation",
    "Dependence",
    "Detection",
    "DiagnosedData",
    "Evidence",
    "Feature",
    "Localisation",
    "Location",
    "NoiseFloor",
    "Obstacle",
    "ResidualKind",
    "characterise",
    "detect",
    "evidence_of",
]
