"""Free-run errors: the model alone, under the measured force, from the measured state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from ..data.record import Record
from ..exceptions import NRFError
from .chain_model import ChainModel
from .segments import BlockRows, Segment, SegmentSet


def free_run_of(
    model: ChainModel,
    segment: Segment,
    rows: slice | None = None,
    dt: float | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    integrator: Callable[..., Record] = ChainModel.simulate,
    **options: Any,
) -> Record:
    """The model alone under the forces and base motion of some rows, from their first state.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
    rows : slice, optional
        Finite rows, those inside the NaN edges if None; internal states start at zero.
    dt : float, optional
        s; that of the record if None.
    start : (ndarray, ndarray) of shape (n_dof,), optional
        Displacement (m) and velocity (m/s) relative to the base at the first row; as measured if None.
    integrator : callable
        Takes what :meth:`ChainModel.simulate` takes.
    **options
        Of :func:`pysindy_nrf.simulate` (``method``, ``hold``, ``rtol``, ``name``).

    Returns
    -------
    Record
        Of the rows alone; displacement relative to the base.

    Raises
    ------
    SimulationError
        If it diverges.
    ChannelError
        If neither ``dt`` nor the record tells the sampling step.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.regression.free_run import free_run_of
    >>> model = ChainModel([10.0], {1: [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]})
    >>> F = excitation.band_limited_random(1, 0.5, 1000.0, dofs=1, rms=100.0, band=(1, 60), random_state=0)
    >>> record = simulate(model, F, 1e-3, hold="cubic")
    >>> (segment,) = model.segments(record).segments
    >>> later = free_run_of(model, segment, slice(200, 500), hold="cubic")  # from the state in row 200
    >>> gap = later.displacement - record.displacement[200:]
    >>> bool(np.abs(gap).max() < 1e-3 * record.displacement.std())
    True
    """
    rows = segment.valid if rows is None else rows
    x0, v0 = start or (np.cumsum(y[rows.start].astype(float)) for y in (segment.s, segment.v))
    return integrator(
        model,
        segment.F[rows],
        segment.step if dt is None else dt,
        x0=x0,
        v0=v0,
        t0=segment.time_at(rows.start),
        base_acceleration=None if segment.ag is None else segment.ag[rows],
        covariates={k: c[rows] for k, c in segment.covariates.items()} or None,
        **options,
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
