"""Detect, locate, characterise and estimate what a model lacks."""

from .loop import close_loop
from .report import LoopReport, Step

__all__ = ["close_loop", "LoopReport", "Step"]
