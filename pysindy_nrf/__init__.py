"""Masses and nonlinear restoring forces of chain-like structures from measured forces and motions."""

from . import exceptions, laws
from .chain import Chain
from .record import Record
from .sites import Site

__version__ = "0.1.0"
