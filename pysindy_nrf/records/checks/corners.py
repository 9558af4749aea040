"""Channels behind a high-pass filter of first order, as it is in every ICP amplifier.

What such a filter takes away is known up to a constant and a straight line in time,
so the signal before it follows from the one behind it,

.. math:: y(t) = z(t) + 2 \\pi f_c \\int z \\, dt .
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..quality import QualityNote
from ..record import Record
from .transfer_function import detrended


def before_filter(values: np.ndarray, corner: float, dt: float) -> np.ndarray:
    """A signal before a high-pass filter, less its least-squares line.

    Parameters
    ----------
    values : ndarray of shape (n_samples,)
        Behind the filter; NaN stays.
    corner : float
        Hz.
    dt : float
        Sampling step, s.
    """
    known = np.isfinite(values)
    behind = values[known].astype(float)
    behind = behind - behind.mean()

    # trapezoids
    steps = 0.5 * dt * (behind[1:] + behind[:-1])
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    before = np.full(len(values), np.nan)
    before[known] = detrended(behind + 2 * np.pi * corner * integral)
    return before


def without_corners(record: Record, notes: Iterable[QualityNote]) -> Record:
    """A record with its accelerations before the filters that notes name.

    Parameters
    ----------
    record : Record
    notes : iterable of QualityNote
        Those of the kind ``"corner"`` on accelerations are followed.
    """
    acceleration = record.acceleration
    for note in notes:
        if note.kind != "corner" or note.channel[0] != "a":
            continue
        assert acceleration is not None
        j = int(note.channel[1:]) - 1
        before = before_filter(acceleration[:, j], note.size, record.dt)
        acceleration = np.array(acceleration, dtype=float)
        acceleration[:, j] = before
    if acceleration is record.acceleration:
        return record
    return record.replace(acceleration=acceleration)


def with_force_before_filter(record: Record, dof: int, corner: float) -> Record:
    """A record with the force on a DOF before a high-pass filter, corner in Hz."""
    force = np.array(record.force, dtype=float)
    force[:, dof - 1] = before_filter(force[:, dof - 1], corner, record.dt)
    return record.replace(force=force)
