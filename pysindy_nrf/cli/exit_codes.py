"""Exit codes of the command line."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..diagnosis.verdict import Verdict


class ExitCode(IntEnum):
    """How a run ended."""

    DONE = 0
    OTHER = 1
    USAGE = 2
    # the data, or what was asked of them
    DATA = 3
    # done, but the verdict is red
    RED = 4
    INTERRUPTED = 130


def code_of_verdict(verdict: Verdict) -> ExitCode:
    """The exit code of a finished run."""
    return ExitCode.RED if verdict.state == "red" else ExitCode.DONE
