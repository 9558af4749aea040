"""The simulated Bouc-Wen benchmark."""

from __future__ import annotations

from typing import Any

from ..exceptions import FileFormatError
from ..io import read_table
from ..record import Record
from .folder import data_file

EXCITATIONS = ("multisine", "sinesweep")


def load_bouc_wen_benchmark(excitation: str = "multisine", folder: Any = None) -> Record:
    """Published SIMULATED benchmark: one DOF with a Bouc-Wen hysteresis, noise-free.

    Parameters
    ----------
    excitation : {"multisine", "sinesweep"}
        One period of a steady-state multisine (8192 samples), or a sweep (153 000 samples).
    folder : path-like, optional
        See :func:`data_folder`; the files are ``bouc_wen_benchmark/[uy]val_<excitation>.mat``.

    Returns
    -------
    Record
        ``F1`` (N), ``x1`` (m); 750 Hz.

    Raises
    ------
    NRFError
        If the excitation, the folder or the file is missing.

    Notes
    -----
    J. P. Noel and M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity", Workshop on
    Nonlinear System Identification Benchmarks, 2016 (nonlinearbenchmark.org; the set states no
    licence). The truth: m = 2 kg, c = 10 N s/m, k = 5e4 N/m, alpha = 5e4, beta = 1e3,
    gamma = 0.8, delta = -1.1, nu = 1.
    """
    if excitation not in EXCITATIONS:
        raise FileFormatError(f"There is no excitation {excitation!r}", f"Choose one of {', '.join(EXCITATIONS)}.")
    force, displacement = (
        read_table(data_file(folder, "bouc_wen_benchmark", f"{k}val_{excitation}.mat")).variables[
            f"{k}val_{excitation}"
        ]
        for k in "uy"
    )
    return Record(force=force, displacement=displacement, fs=750.0, name=f"Bouc-Wen benchmark, {excitation}")
