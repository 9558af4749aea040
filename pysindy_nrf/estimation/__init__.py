"""Estimates that survive measurement noise, and how far they can be trusted."""

from .covariance import newey_west
from .intervals import force_intervals, parameter_intervals
from .iv import IVResult, instrumental_variables
from .output_error import OutputErrorResult, output_error
from .pieces import Pieces, pieces_of

__all__ = [
    "IVResult",
    "OutputErrorResult",
    "Pieces",
    "force_intervals",
    "instrumental_variables",
    "newey_west",
    "output_error",
    "parameter_intervals",
    "pieces_of",
]
