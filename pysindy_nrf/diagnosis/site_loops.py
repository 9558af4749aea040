"""Forces of sites along a stretch of data, thinned for drawing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from ..chain.restoring_force import RestoringForce
from ..chain.sites import Site
from ..common.unit_system import TRANSLATION, UnitSystem
from ..exceptions import NRFError
from ..laws.shape import Motion
from ..records.dataset import Dataset
from ..records.zero_phase_filter import ZeroPhaseFilter
from .period import mean_period
from .residual import Filters, residual_of

# Cycles of a loop that is drawn: more of them hide each other.
CYCLES = 6
# Points of a cycle: a file that opens at once, and no cycle loses its shape.
POINTS_PER_CYCLE = 40


@dataclass(frozen=True, eq=False)
class SiteLoop:
    """Force of one site along a stretch of data.

    Parameters
    ----------
    site, record : str
    t, s, v : ndarray of shape (n_points,)
        Time, s (samples where it is not known), drift, m, and its rate, m/s.
    identified : ndarray of shape (n_points,)
        Force of the model, N.
    measured : ndarray of shape (n_points,), optional
        Force that the measured motion and forces ask for, N, where they determine it.
    units : UnitSystem
        In which it is shown.
    """

    site: str
    record: str
    t: np.ndarray
    s: np.ndarray
    v: np.ndarray
    identified: np.ndarray
    measured: np.ndarray | None = None
    units: UnitSystem = TRANSLATION


def loops_of(
    model: ChainModel, data: Dataset, filters: Filters | None = None
) -> list[SiteLoop]:
    """Forces of all sites with a law, along the strongest stretch of the data.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
    filters : sequence of ZeroPhaseFilter or None, optional
        One for each record; all lines pass it.
    """
    filters = [None] * len(data.segments) if filters is None else list(filters)
    try:
        storey_residuals = residual_of(model, data, filters).storey
    except NRFError:  # no balance is known
        storey_residuals = []
        for segment in data.segments:
            unknown = np.full((segment.n_valid, model.n_dof), np.nan)
            storey_residuals.append(unknown)

    loops = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        # a law that needs what a record does not hold is not drawn
        with suppress(NRFError):
            loops.append(_loop(site, force, data, filters, storey_residuals))
    return loops


def _loop(
    site: Site,
    force: RestoringForce,
    data: Dataset,
    filters: Filters,
    storey_residuals: list[np.ndarray],
) -> SiteLoop:
    """The force of one site along the record in which it moves most."""
    motions = [segment.motion(site, segment.valid) for segment in data.segments]
    strongest = int(np.argmax([np.abs(motion.s).max() for motion in motions]))
    motion, band = motions[strongest], filters[strongest]
    rows = _rows_of_cycles(motion, force.has_memory)

    identified = force.along(motion)
    measured = None
    missing = storey_residuals[strongest]
    if site.is_storey and np.isfinite(missing[:, site.p - 1]).all():
        measured = _drawn(identified, band, rows) + missing[rows, site.p - 1]

    time = np.arange(motion.n_samples, dtype=float) if motion.t is None else motion.t
    return SiteLoop(
        str(site),
        data.segments[strongest].name,
        time[rows],
        _drawn(motion.s, band, rows),
        _drawn(motion.v, band, rows),
        _drawn(identified, band, rows),
        measured,
        force.unit_system,
    )


def _rows_of_cycles(motion: Motion, has_memory: bool) -> slice:
    """Rows of some cycles about the largest drift."""
    n = motion.n_samples
    # a law that remembers starts afresh, and needs a cycle or two to forget that
    first = n // 10 if has_memory else 0
    cycle = mean_period([motion.s])
    width = min(n - first, int(CYCLES * cycle) + 1)
    middle = int(np.abs(motion.s).argmax())
    start = int(np.clip(middle - width // 2, first, n - width))
    return slice(start, start + width, int(max(1, cycle // POINTS_PER_CYCLE)))


def _drawn(line: np.ndarray, band: ZeroPhaseFilter | None, rows: slice) -> np.ndarray:
    return (line if band is None else band.apply(line))[rows]
