"""The simulated Bouc-Wen benchmark."""

from __future__ import annotations

from typing import Any

from ..exceptions import FileFormatError
from ..io import read_table
from ..record import Record
from .download import benchmark
from .folder import data_file

EXCITATIONS = ("multisine", "sinesweep")


def load_bouc_wen_benchmark(excitation: str = "multisine", folder: Any = None, *, download: bool = False) -> Record:
    """Published SIMULATED benchmark: one DOF with a Bouc-Wen hysteresis, noise-free.

    Parameters
    ----------
    excitation : {"multisine", "sinesweep"}
        One period of a steady-state multisine (8192 samples), or a sweep (153 000 samples).
    folder : path-like, optional
        See :func:`data_folder`; the files are ``bouc_wen_benchmark/[uy]val_<excitation>.mat``. With
        ``download``, where to keep them.
    download : bool
        Get them through the package nonlinear-benchmarks (extra ``datasets``) if they are not there yet.

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

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from scipy.io import savemat
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "bouc_wen_benchmark")
    ...     place.mkdir()
    ...     for kind in "uy":
    ...         savemat(place / f"{kind}val_multisine.mat", {f"{kind}val_multisine": np.ones((1, 8192))})
    ...     datasets.load_bouc_wen_benchmark(folder=folder)
    Record('Bouc-Wen benchmark, multisine': 1 DOF, 8192 samples at 750 Hz (10.92 s), channels F1, x1)
    """
    if excitation not in EXCITATIONS:
        raise FileFormatError(f"There is no excitation {excitation!r}", f"Choose one of {', '.join(EXCITATIONS)}.")

    def file(name: str) -> Any:
        return benchmark("BoucWen", folder, name) if download else data_file(folder, "bouc_wen_benchmark", name)

    force, displacement = (
        read_table(file(f"{k}.mat")).variables[k] for k in (f"uval_{excitation}", f"yval_{excitation}")
    )
    return Record(force=force, displacement=displacement, fs=750.0, name=f"Bouc-Wen benchmark, {excitation}")
