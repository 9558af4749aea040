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
    """
    name = "SNLS80mV.mat"
    path = benchmark("Silverbox", folder, name) if download else data_file(folder, "silverbox", name)
    held = read_table(path).variables
    return Record(force=held["V1"].ravel(), displacement=held["V2"].ravel(), fs=FS, name="Silverbox")
