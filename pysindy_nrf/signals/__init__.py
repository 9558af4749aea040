"""Signals: one motion from many channels, and the same treatment for force and response."""

from .band import BandLimiter
from .differentiate import Differentiator, differentiate
from .integrate import Integrator, integrate
from .kinematic_smoother import KinematicSmoother
from .paper import PaperIntegration, paper_processing

__all__ = [
    "BandLimiter",
    "Differentiator",
    "Integrator",
    "KinematicSmoother",
    "PaperIntegration",
    "differentiate",
    "integrate",
    "paper_processing",
]
