"""The motion that a model makes by itself, in the place of the measured one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..fair_filter import FairFilter
from ..free_run import free_run_of
from ..model import ChainModel
from ..segments import Segment


def run_of(
    model: ChainModel,
    segment: Segment,
    delay: int = 0,
    limited: bool = False,
    start: tuple | None = None,
    hold: str = "cubic",
) -> Segment:
    """The motion a model makes under a record's forces, as a record with the same rows.

    Parameters
    ----------
    model : ChainModel
    segment : Segment
        Its first valid row gives the initial condition.
    delay : int
        Samples by which the motion is delayed.
    limited : bool
        Whether the motion is low-passed to the frequencies that the measured one resolves.
    start : (ndarray, ndarray) of shape (n_dof,), optional
        Displacement and velocity relative to the base at the first valid row; as measured if None.
    hold : {"cubic", "linear", "zero"}
        Course of the force between its samples; a straight one loses ``(pi f dt)^2 / 3`` of it at frequency f.

    Returns
    -------
    Segment
        NaN outside the valid rows.
    """
    rows, dt = segment.valid, segment.step
    method = "default" if model.has_memory else "rk4"
    record = free_run_of(model, segment, start=start, method=method, rtol=1e-5, hold=hold)
    shift = np.maximum(np.arange(rows.stop - rows.start) - delay, 0)
    smooth = None
    if limited and segment.resolved is not None and segment.resolved < 0.45 / dt:
        smooth = FairFilter((None, segment.resolved), 1.0 / dt)

    def place(values: np.ndarray) -> np.ndarray:
        out = np.full((segment.n_samples, segment.n_dof), np.nan)
        out[rows] = (values if smooth is None else smooth.apply(values))[shift]
        return out

    a, v, x = (np.asarray(y) for y in (record.acceleration, record.velocity, record.displacement))
    v, s = (np.diff(y, axis=1, prepend=0.0) for y in (v, x))
    return replace(segment, a=place(a), v=place(v), s=place(s))


def likeness_of(segments: Sequence[Segment], runs: Sequence[Segment]) -> float:
    """Correlation of simulated and measured accelerations, every DOF with equal weight."""
    both = own = other = 0.0
    for segment, run in zip(segments, runs):
        a, b = segment.a[segment.valid].astype(float), run.a[run.valid]
        scale = np.mean(a**2, axis=0)
        scale[scale == 0] = 1.0
        both, own, other = both + (a * b / scale).sum(), own + (a * a / scale).sum(), other + (b * b / scale).sum()
    with np.errstate(invalid="ignore", over="ignore"):
        likeness = both / np.sqrt(own * other)
    return float(likeness) if np.isfinite(likeness) else 0.0
