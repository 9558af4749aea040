"""Free-run errors: the model alone, under the measured force, from the measured state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ..exceptions import NRFError
from ..model import ChainModel
from ..record import Record
from ..segments import Segment, SegmentSet
from .splits import BlockRows


def free_run_of(model: ChainModel, segment: Segment, rows: slice, dt: float) -> Record:
    """The model alone under the forces and base motion of some rows, from their first state.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
    rows : slice
        Finite rows; internal states start at zero.
    dt : float
        s.

    Returns
    -------
    Record
        Displacement relative to the base.

    Raises
    ------
    SimulationError
        If it diverges.
    """
    return model.simulate(
        segment.F[rows],
        dt,
        x0=np.cumsum(segment.s[rows.start]),
        v0=np.cumsum(segment.v[rows.start]),
        t0=segment.time_at(rows.start),
        base_acceleration=None if segment.ag is None else segment.ag[rows],
        covariates={k: c[rows] for k, c in segment.covariates.items()} or None,
    )


def squares_of(run: Record, segment: Segment, rows: slice, filter: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares of a free run's error and of the measured displacement.

    Parameters
    ----------
    run : Record
        Of :func:`free_run_of`.
    segment : Segment
    rows : slice
    filter : FairFilter, optional
        Applied to both.

    Returns
    -------
    error, measured : ndarray of shape (n_dof,)
        m^2.
    """
    x = np.cumsum(segment.s[rows], axis=1)
    error = run.displacement - x
    if filter is not None:
        error, x = filter.apply(error), filter.apply(x)
    return (error**2).sum(axis=0), (x**2).sum(axis=0)


class Judged(Protocol):
    """What a free run is compared with."""

    @property
    def data(self) -> SegmentSet:
        """Records."""

    @property
    def filters(self) -> Sequence[Any]:
        """FairFilter or None, one for each record."""


def free_run_error(model: ChainModel, work: Judged, blocks: Sequence[BlockRows]) -> float:
    """Free-run error of the displacements on some blocks, percent NRMSE.

    Parameters
    ----------
    model : ChainModel
    work : Workspace or the like
        With ``data`` and ``filters``.
    blocks : sequence of BlockRows
        Each is run from its own first state, internal states at zero.

    Returns
    -------
    float
        Root of the squared errors of all DOFs (each divided by its rms) over their number; NaN where
        no free run is possible (an unknown force, a mass that is not positive, divergence).
    """
    if (model.masses <= 0).any():
        return float("nan")
    top, bottom = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in blocks:
        seg = work.data.segments[block.segment]
        start = seg.valid.start
        rows = slice(start + block.rows.start, start + block.rows.stop)
        dt = seg.dt
        if dt is None or np.isnan(seg.F[rows.start]).any() or rows.stop - rows.start < 8:
            return float("nan")
        try:
            run = free_run_of(model, seg, rows, dt)
        except NRFError:
            return float("nan")
        error, x = squares_of(run, seg, rows, work.filters[block.segment])
        top += error
        bottom += x
    return float(100.0 * np.sqrt(np.mean(top / bottom))) if (bottom > 0).all() else float("nan")
