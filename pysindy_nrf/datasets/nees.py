"""A three-storey steel frame on a shaking table."""

from __future__ import annotations

from typing import Any

from ..exceptions import FileFormatError
from ..io import read_record
from ..record import Record
from .folder import data_file

TESTS = ("fbgm162s1", "fbgm162s3", "fbgm162s5", "fpgm111s1")


def load_nees_three_storey(test: str = "fbgm162s5", folder: Any = None) -> Record:
    """Three-storey steel moment frame on a shaking table: base excitation only.

    Parameters
    ----------
    test : {"fbgm162s1", "fbgm162s3", "fbgm162s5", "fpgm111s1"}
        Fixed base under one ground motion of rising intensity (the frame is close to linear in s1
        and yields in s5), or on friction-pendulum bearings.
    folder : path-like, optional
        See :func:`data_folder`; the file is ``nees_three_storey/nees_three_storey.npz``.

    Returns
    -------
    Record
        ``x1``..``x3`` and ``xg`` (absolute displacement of floors and base level, m, from inches),
        ``ag`` (table acceleration, m/s^2, from g); 256 Hz, 42 to 45 s. No force acts; one known mass
        scales the chain (only ratios to it come out).

    Raises
    ------
    NRFError
        If the test, the folder or the file is missing.

    Notes
    -----
    University at Buffalo, NEES project; A. Masroor and G. Mosqueda, report MCEER-13-0003. The
    publishers low-passed the channels at 25 Hz; the set states no licence. Velocities and
    accelerations of the floors were not measured. The floors' masses are about equal (not stated).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pysindy_nrf import datasets
    >>> with tempfile.TemporaryDirectory() as folder:  # a stand-in with the layout of the set: s, g, inches
    ...     place = pathlib.Path(folder, "nees_three_storey")
    ...     place.mkdir()
    ...     t = np.arange(1000) / 256
    ...     test = np.column_stack([t, *[np.sin(9 * t)] * 5])
    ...     np.savez(place / "nees_three_storey.npz", fbgm162s5=test)
    ...     record = datasets.load_nees_three_storey(folder=folder)
    >>> record.n_dof, record.coordinates, round(float(record.displacement.max()), 4)  # m
    (3, 'absolute', 0.0254)
    """
    if test not in TESTS:
        raise FileFormatError(f"There is no test {test!r}", f"Choose one of {', '.join(TESTS)}.")
    path = data_file(folder, "nees_three_storey", "nees_three_storey.npz")
    return read_record(
        path,
        mapping={
            "t": f"{test}[:, 0]",
            "ag": f"{test}[:, 1] @ g",
            "xg": f"{test}[:, 2] @ in",
            **{f"x{j}": f"{test}[:, {j + 2}] @ in" for j in (1, 2, 3)},
        },
        name=test,
        coordinates="absolute",
    )
