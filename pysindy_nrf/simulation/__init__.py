"""Free runs of chain models under sampled forces."""

from .api import FreeRun, free_run, simulate

__all__ = ["FreeRun", "free_run", "simulate"]
