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
    """The model alone under the forces and base motion of some rows, from their first state."""
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
    """Sums of squares of a free run's error and of the measured displacement."""
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
    """Free-run error of the displacements on some blocks, percent NRMSE."""
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
