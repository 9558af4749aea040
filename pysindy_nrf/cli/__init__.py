"""The command line ``pysindy-nrf``."""

from .group import main

__all__ = ["main"]
