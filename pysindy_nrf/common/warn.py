"""Warnings that point at the line of the user who called the package."""

import inspect
import os
import sys
import warnings
from pathlib import Path

_PACKAGE = str(Path(__file__).parents[1]) + os.sep


def warn_user(message: str | Warning, category: type[Warning] | None = None) -> None:
    """Warn at the first line outside the package, however deep the caller lies.

    Parameters
    ----------
    message : str or Warning
    category : type of Warning, optional
        That of ``message`` where it is a Warning.
    """
    if sys.version_info >= (3, 12):
        warnings.warn(message, category, skip_file_prefixes=(_PACKAGE,))
    else:
        warnings.warn(message, category, stacklevel=_level_of_the_user())


def _level_of_the_user() -> int:
    """Stack level of the first frame outside the package, counted from it."""
    frame = inspect.currentframe()
    level = 0

    while frame is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame = frame.f_back
        level += 1

    # this function's own frame stands for the first one that warnings.warn counts
    return level
