"""The command line ``pysindy-nrf``."""

from .exit_codes import ExitCode
from .group import cli, main, run

__all__ = ["ExitCode", "cli", "main", "run"]
