"""EMPS: an electro-mechanical positioning stage."""

from __future__ import annotations

from typing import Any

from ..io import read_record
from ..record import Record
from .download import benchmark
from .folder import data_file


def load_emps(folder: Any = None, *, download: bool = False) -> Record:
    """Electro-mechanical positioning stage (EMPS): one DOF, only position and drive are measured.

    Parameters
    ----------
    folder : path-like, optional
        See :func:`data_folder`; the file is ``emps/DATA_EMPS.mat``. With ``download``, where to keep it.
    download : bool
        Get it through the package nonlinear-benchmarks (extra ``datasets``) if it is not there yet.

    Returns
    -------
    Record
        ``F1`` (N, drive voltage times the gain ``gtau`` = 35.1507 N/V), ``x1`` (m); 1000 Hz, 24.8 s.

    Raises
    ------
    NRFError
        If the folder or the file is missing.

    Notes
    -----
    Measured in closed loop by A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of
    EMPS", Workshop on Nonlinear System Identification Benchmarks, 2019 (nonlinearbenchmark.org;
    the set states no licence). Their least-squares model, band-limited to about 20 Hz: mass 95.1089 kg, viscous
    203.5034 N s/m, Coulomb friction 20.3935 N, offset -3.1648 N. A model without friction leaves
    about 17 % of the force unexplained.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from scipy.io import savemat
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "emps")
    ...     place.mkdir()
    ...     t = np.arange(500)[:, None] / 1000
    ...     savemat(place / "DATA_EMPS.mat", {"t": t, "qm": 0.1 * t, "vir": 0 * t + 2.0, "gtau": 35.15})
    ...     record = datasets.load_emps(folder)
    >>> record, float(record.force[0, 0].round(2))  # 2 V times 35.15 N/V
    (Record('EMPS': 1 DOF, 500 samples at 1000 Hz (0.5 s), channels F1, x1), 70.3)
    """
    path = benchmark("EMPS", folder, "DATA_EMPS.mat") if download else data_file(folder, "emps", "DATA_EMPS.mat")
    return read_record(path, mapping={"t": "t", "x1": "qm", "F1": "vir*gtau"}, name="EMPS")
