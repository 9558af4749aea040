"""Silverbox: an electronic Duffing oscillator."""

from __future__ import annotations

from typing import Any

from ..io import read_table
from ..record import Record
from .download import benchmark
from .folder import data_file

FS = 610.35  # Hz


def load_silverbox(folder: Any = None, *, download: bool = False) -> Record:
    """Electronic circuit that behaves as one DOF with a hardening spring (Duffing).

    Parameters
    ----------
    folder : path-like, optional
        See :func:`data_folder`; the file is ``silverbox/SNLS80mV.mat``. With ``download``, where to keep it.
    download : bool
        Get it through the package nonlinear-benchmarks (extra ``datasets``) if it is not there yet.

    Returns
    -------
    Record
        ``F1`` (input) and ``x1`` (output), both VOLTS standing for N and m: mass and stiffness come out in the
        circuit's own units, frequencies in Hz. 610.35 Hz, 131 072 samples: a noise burst of growing level, then ten
        multisines.

    Raises
    ------
    NRFError
        If the folder or the file is missing.

    Notes
    -----
    T. Wigren and J. Schoukens, "Three free data sets for development and benchmarking in nonlinear system
    identification", European Control Conference, 2013 (nonlinearbenchmark.org).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from scipy.io import savemat
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "silverbox")
    ...     place.mkdir()
    ...     savemat(place / "SNLS80mV.mat", {"V1": np.ones((1, 500)), "V2": np.ones((1, 500))})
    ...     datasets.load_silverbox(folder)
    Record('Silverbox': 1 DOF, 500 samples at 610.35 Hz (0.8192 s), channels F1, x1)
    """
    name = "SNLS80mV.mat"
    path = benchmark("Silverbox", folder, name) if download else data_file(folder, "silverbox", name)
    held = read_table(path).variables
    return Record(force=held["V1"].ravel(), displacement=held["V2"].ravel(), fs=FS, name="Silverbox")
