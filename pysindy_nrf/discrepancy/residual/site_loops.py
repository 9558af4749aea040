"""The force of every site along a stretch of data, thinned for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...chain.model import ChainModel
from ...chain.restoring_force import RestoringForce
from ...chain.sites import Site
from ...exceptions import NRFError
from ...laws.shape import Motion
from ...records.dataset import Dataset
from ..period import mean_period
from .residual import filtered, residual_of

# Cycles of a loop that is drawn: more hide each other; and points in each: a file that
# opens at once, and no cycle loses its shape.
CYCLES = 6
POINTS_PER_CYCLE = 40
# Part of a record in which a law that remembers forgets its fresh start.
FORGETTING = 10


@dataclass(frozen=True, eq=False)
class SiteLoop:
    """Force of one site along a stretch of data.

    Attributes
    ----------
    site, record : str
    t, s, v : ndarray of shape (n_points,)
        Time (s), drift (m) and rate (m/s).
    identified : ndarray of shape (n_points,)
        Force of the model, N.
    measured : ndarray or None
        The same with the residual of the storey, N; None where it is not known.
    """

    site: str
    record: str
    t: np.ndarray
    s: np.ndarray
    v: np.ndarray
    identified: np.ndarray
    measured: np.ndarray | None = None


def loops_of(
    model: ChainModel, data: Dataset, filters: Sequence[Any] | None = None
) -> list[SiteLoop]:
    """Forces of all sites that hold a law, along the strongest stretch of the data.

    All lines pass the filters.
    """
    if filters is None:
        filters = [None] * len(data.segments)
    try:
        storeys = residual_of(model, data, filters).storey
    except NRFError:
        shapes = [(seg.n_valid, model.n_dof) for seg in data.segments]
        storeys = [np.full(shape, np.nan) for shape in shapes]

    loops = []
    for site, force in model.restoring_forces.items():
        # a law that needs what this record does not hold is not drawn
        if force.laws:
            with suppress(NRFError):
                loops.append(_loop(site, force, data, filters, storeys))
    return loops


def _loop(
    site: Site,
    force: RestoringForce,
    data: Dataset,
    filters: Sequence[Any],
    storeys: Sequence[np.ndarray],
) -> SiteLoop:
    """The loop of one site in the record in which it moves most."""
    motions = [seg.motion(site, seg.valid) for seg in data.segments]
    number = int(np.argmax([np.abs(m.s).max() for m in motions]))
    motion, filter_ = motions[number], filters[number]
    rows = _strongest_rows(motion, force.has_memory)

    along = force.along(motion)
    t = np.arange(len(along), dtype=float) if motion.t is None else motion.t
    identified = filtered(along, filter_)[rows]
    measured = None
    if site.is_storey:
        missing = storeys[number][:, site.p - 1]
        if np.isfinite(missing).all():
            measured = identified + missing[rows]
    return SiteLoop(
        str(site),
        data.segments[number].name,
        t[rows],
        filtered(motion.s, filter_)[rows],
        filtered(motion.v, filter_)[rows],
        identified,
        measured,
    )


def _strongest_rows(motion: Motion, has_memory: bool) -> slice:
    """Some cycles about the largest drift, thinned."""
    n_samples = len(motion.s)
    first = n_samples // FORGETTING if has_memory else 0
    period = mean_period([motion.s])
    step = int(max(1, period // POINTS_PER_CYCLE))
    width = min(n_samples - first, int(CYCLES * period) + 1)
    middle = int(np.abs(motion.s).argmax())
    start = int(np.clip(middle - width // 2, first, n_samples - width))
    return slice(start, start + width, step)
