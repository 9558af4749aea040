"""A storey whose mass rubs on a frame that does not move."""

from __future__ import annotations

from typing import Any

from ..io import read_record
from ..record import Record
from .folder import data_file


def load_dry_friction_storey(folder: Any = None) -> Record:
    """One-storey frame on a shaking base, its mass rubbing on a frame fixed to the laboratory.

    Parameters
    ----------
    folder : path-like, optional
        See :func:`data_folder`; the file is ``dry_friction_storey/dry_friction_storey.npz``.

    Returns
    -------
    Record
        ``x1``, ``xg`` (absolute displacement of mass and base, m, from mm), 2000 Hz by the sample
        count (the logged time is rounded to single precision), 61 s. Displacements hold the lasers'
        stand-off as an offset. No force acts; a known mass scales the chain.

    Raises
    ------
    NRFError
        If the folder or the file is missing.

    Notes
    -----
    C. Lathourakis and A. Cicirello, Nonlinear Dynamics, 2024, doi 10.1007/s11071-024-09652-2; the set
    states no licence. The friction acts on the ABSOLUTE velocity of the mass, not on the storey's.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set, mm
    ...     place = pathlib.Path(folder, "dry_friction_storey")
    ...     place.mkdir()
    ...     run = np.column_stack([np.arange(100) / 2000, np.full(100, 5.0), np.full(100, 7.0)])
    ...     np.savez(place / "dry_friction_storey.npz", run_60_52=run)
    ...     float(datasets.load_dry_friction_storey(folder).displacement[0, 0])  # m
    0.007
    """
    path = data_file(folder, "dry_friction_storey", "dry_friction_storey.npz")
    return read_record(
        path,
        mapping={"xg": "run_60_52[:, 1] @ mm", "x1": "run_60_52[:, 2] @ mm"},
        fs=2000.0,
        name="dry friction run_60_52",
        coordinates="absolute",
    )
