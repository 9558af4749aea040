"""Where the measured sets are."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..exceptions import FileFormatError, NRFError

VARIABLE = "PYSINDY_NRF_DATA"


def data_folder(folder: Any = None) -> Path:
    """The folder that holds the measured sets, one sub-folder each.

    Parameters
    ----------
    folder : path-like, optional
        The environment variable ``PYSINDY_NRF_DATA`` if None.

    Returns
    -------
    Path

    Raises
    ------
    NRFError
        If no folder is named, or it does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     datasets.data_folder(folder).is_dir()
    True
    >>> datasets.data_folder("no/such/folder")
    Traceback (most recent call last):
        ...
    pysindy_nrf.exceptions.NRFError: The folder of measured data 'no/such/folder' does not exist. Correct
    folder=.
    """
    named = folder if folder is not None else os.environ.get(VARIABLE)
    if not named:
        raise NRFError(
            "No folder of measured data is known",
            f"Pass folder=, or set the environment variable {VARIABLE} to what holds emps/, nees_three_storey/, ...",
        )
    path = Path(named)
    if not path.is_dir():
        origin = "folder=" if folder is not None else f"the environment variable {VARIABLE}"
        raise NRFError(f"The folder of measured data {str(path)!r} does not exist", f"Correct {origin}.")
    return path


def data_file(folder: Any, *parts: str) -> Path:
    """A file of a measured set.

    Parameters
    ----------
    folder : path-like or None
        See :func:`data_folder`.
    *parts : str
        Path below it.

    Returns
    -------
    Path

    Raises
    ------
    NRFError
        If it is not there.
    """
    root = data_folder(folder)
    path = root.joinpath(*parts)
    if not path.is_file():
        raise FileFormatError(
            f"{root} does not hold {'/'.join(parts)}",
            f"Get it from its publisher (see the loader's docstring) and put it there, or point {VARIABLE} elsewhere.",
        )
    return path
