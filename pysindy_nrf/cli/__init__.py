"""The command line ``pysindy-nrf``."""

from .group import main, run

__all__ = ["main", "run"]
