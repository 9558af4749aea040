"""A six-storey hotel in 21 earthquakes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import FileFormatError
from ..io import read_table
from ..record import Record
from .folder import data_file


def load_six_storey_hotel(event: int = 1, folder: Any = None) -> Record:
    """Six-storey hotel in San Bernardino in one of 21 earthquakes; two floors carry sensors.

    Parameters
    ----------
    event : int
        1 to 21, in the order of the file.
    folder : path-like, optional
        See :func:`data_folder`; the file is ``six_storey_hotel/san_bernardino_float32.npz``.

    Returns
    -------
    Record
        ``a1, v1, x1, a2, v2, x2`` of the lower and the upper instrumented floor and ``xg`` of the
        ground: absolute motion in SI units (from cm); 50 Hz, without the zero-padded tail. No
        force acts; a known mass scales the chain.

    Raises
    ------
    NRFError
        If the event, the folder or the file is missing.

    Notes
    -----
    R. Zhang, Y. Liu and H. Sun, "Physics-guided convolutional neural network (PhyCNN) for
    data-driven seismic response modeling", Engineering Structures, 2020; MIT licence. The
    instrumented floors are not neighbours: "storey 2" spans several.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set: cm
    ...     place = pathlib.Path(folder, "six_storey_hotel")
    ...     place.mkdir()
    ...     motion, ground = np.ones((21, 500, 2)), np.ones((21, 500))
    ...     held = {"acc": motion, "vel": motion, "disp": motion, "ground_disp": ground, "fs": 50.0}
    ...     np.savez(place / "san_bernardino_float32.npz", **held)
    ...     record = datasets.load_six_storey_hotel(1, folder)
    >>> record.n_dof, record.coordinates, float(record.base_displacement[0])  # m
    (2, 'absolute', 0.01)
    """
    variables = read_table(data_file(folder, "six_storey_hotel", "san_bernardino_float32.npz")).variables
    ground = variables["ground_disp"]
    if isinstance(event, bool) or not hasattr(event, "__index__") or not 1 <= int(event) <= len(ground):
        raise FileFormatError(f"There is no event {event!r}", f"They count from 1 to {len(ground)}.")
    i = int(event) - 1
    last = max(
        np.flatnonzero(np.any(variables[k][i].reshape(len(ground[i]), -1) != 0, axis=1))[-1] for k in ("disp", "acc")
    )
    rows = slice(0, int(last) + 1)
    return Record(
        acceleration=0.01 * variables["acc"][i, rows].astype(float),
        velocity=0.01 * variables["vel"][i, rows].astype(float),
        displacement=0.01 * variables["disp"][i, rows].astype(float),
        base_displacement=0.01 * ground[i, rows].astype(float),
        fs=float(variables["fs"]),
        coordinates="absolute",
        name=f"hotel, event {event}",
    )
