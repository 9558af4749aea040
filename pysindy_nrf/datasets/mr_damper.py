"""Magneto-rheological dampers: storey elements alone."""

from __future__ import annotations

from typing import Any

from ..exceptions import FileFormatError
from ..io import read_record, read_table
from ..record import Record
from .folder import data_file


def load_mr_damper_white_noise(folder: Any = None) -> Record:
    """MR damper driven by white-noise displacement under changing voltage.

    Parameters
    ----------
    folder : path-like, optional
        See :func:`data_folder`; the file is ``mr_damper_white_noise/mr_damper_white_noise.npz``.

    Returns
    -------
    Record
        ``x1`` (m, from cm), ``F1`` (N) and the covariate ``voltage`` (V); 3004.8 Hz, 24.6 s.

    Raises
    ------
    NRFError
        If the folder or the file is missing.

    Notes
    -----
    A storey element by itself: the measured force IS the restoring force, so it is the record of a
    chain of one DOF without inertia, ``0 a + R(v, s) = F``. Fit it with ``known_masses={1: 0.0}``.

    S. Dyke, NEES-2012-1158, doi 10.4231/D3V11VM6X; the set states no licence. The file's velocity
    was derived from its displacement (it loses 6 % at 80 Hz) and is left out; so is the actuator's
    acceleration, whose unit is not stated.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "mr_damper_white_noise")
    ...     place.mkdir()
    ...     column = np.sin(np.arange(2000) / 50)
    ...     held = {"displacement_cm": column, "force_N": column, "voltage": column, "fs": 3004.8}
    ...     np.savez(place / "mr_damper_white_noise.npz", **held)
    ...     record = datasets.load_mr_damper_white_noise(folder)
    >>> list(record.covariates), round(float(record.displacement.max()), 4)  # V; m
    (['voltage'], 0.01)
    """
    path = data_file(folder, "mr_damper_white_noise", "mr_damper_white_noise.npz")
    fs = float(read_table(path).variables["fs"])
    mapping = {"x1": "displacement_cm @ cm", "F1": "force_N", "voltage": "voltage"}
    return read_record(path, mapping=mapping, fs=fs, name="MR damper, white noise")


def load_mr_damper_cyclic(run: str = "ensaio.A.1", folder: Any = None) -> Record:
    """MR damper under cyclic displacement, one of 82 runs.

    Parameters
    ----------
    run : str
        One of :func:`mr_damper_cyclic_runs`.
    folder : path-like, optional
        See :func:`data_folder`; the file is ``mr_damper_cyclic/labcontrol_mr_all_float32.npz``.

    Returns
    -------
    Record
        ``x1`` (m, from mm), ``F1`` (N, raw load cell with its offset); 100 Hz, 7.5 to 30 s.

    Raises
    ------
    NRFError
        If the run, the folder or the file is missing.

    Notes
    -----
    A storey element by itself, see :func:`load_mr_damper_white_noise`: ``known_masses={1: 0.0}``. The
    load cell's offset calls for a constant in the law.

    A. N. Vargas, doi 10.5281/zenodo.4445334, MIT licence.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set: s, mm, N
    ...     place = pathlib.Path(folder, "mr_damper_cyclic")
    ...     place.mkdir()
    ...     t = np.arange(800) / 100
    ...     run = np.column_stack([t, 5.0 * np.sin(9 * t), 80.0 * np.sign(np.cos(9 * t))])
    ...     np.savez(place / "labcontrol_mr_all_float32.npz", **{"ensaio.A.1": run})
    ...     record = datasets.load_mr_damper_cyclic("ensaio.A.1", folder)
    >>> record.measured, round(float(record.displacement.max()), 4)  # m
    (('F1', 'x1'), 0.005)
    """
    path = data_file(folder, "mr_damper_cyclic", "labcontrol_mr_all_float32.npz")
    runs = mr_damper_cyclic_runs(folder)
    if run not in runs:
        raise FileFormatError(f"There is no run {run!r}", f"There are {len(runs)}: {', '.join(runs[:6])}, ...")
    return read_record(
        path, mapping={"t": f"{run}[:, 0]", "x1": f"{run}[:, 1] @ mm", "F1": f"{run}[:, 2]"}, name=f"MR damper {run}"
    )


def mr_damper_cyclic_runs(folder: Any = None) -> tuple[str, ...]:
    """Names of the runs of :func:`load_mr_damper_cyclic`.

    Parameters
    ----------
    folder : path-like, optional

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set
    ...     place = pathlib.Path(folder, "mr_damper_cyclic")
    ...     place.mkdir()
    ...     runs = {"ensaio.A.1": np.ones((9, 3)), "ensaio.A.2": np.ones((9, 3))}
    ...     np.savez(place / "labcontrol_mr_all_float32.npz", **runs)
    ...     datasets.mr_damper_cyclic_runs(folder)
    ('ensaio.A.1', 'ensaio.A.2')
    """
    return tuple(read_table(data_file(folder, "mr_damper_cyclic", "labcontrol_mr_all_float32.npz")).variables)
