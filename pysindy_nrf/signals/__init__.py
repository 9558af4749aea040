"""Signals: one motion from many channels, and the same treatment for force and response."""

from .band import BandLimiter
from .differentiate import differentiate
from .integrate import integrate
from .kinematic_smoother import KinematicSmoother
from .paper import paper_processing

__all__ = [
    "BandLimiter",
    "KinematicSmoother",
    "differentiate",
    "integrate",
    "paper_processing",
]
