"""The force of every site along the data, thinned for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.segments import SegmentSet
from .dependence import period_of
from .residual import residual_of

# Points of a drawn loop: a file that opens at once, and no cycle loses its shape.
_POINTS = 1000
_PER_CYCLE = 40


@dataclass
class SiteLoop:
    """One site along a stretch of data."""

    site: str
    record: str
    t: np.ndarray
    s: np.ndarray
    v: np.ndarray
    identified: np.ndarray
    measured: np.ndarray | None = None


def loops_of(model: ChainModel, data: SegmentSet, filters: Sequence[Any] | None = None) -> list[SiteLoop]:
    """Forces of all sites that hold a law, along the strongest stretch of the data; all lines pass the filters."""
    filters = [None] * len(data.segments) if filters is None else list(filters)
    try:
        storeys = residual_of(model, data, filters).storey
    except NRFError:
        storeys = [np.full((seg.n_valid, model.n_dof), np.nan) for seg in data.segments]
    out = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        try:
            out.append(_loop(site, force, data, filters, storeys))
        except NRFError:  # a law that needs what this record does not hold is not drawn
            continue
    return out


def _loop(site: Site, force: Any, data: SegmentSet, filters: list[Any], storeys: list[np.ndarray]) -> SiteLoop:
    motions = [seg.motion(site, seg.valid) for seg in data.segments]
    which = int(np.argmax([np.abs(m.s).max() for m in motions]))
    m, filter, seg = motions[which], filters[which], data.segments[which]
    # a law that remembers starts fresh with the stretch, and needs a cycle or two to forget that
    step, rows = _window(m.s, len(m.s) // 10 if force.has_memory else 0)

    def drawn(line: np.ndarray) -> np.ndarray:
        return (line if filter is None else filter.apply(line))[rows][::step]

    R = force.along(m)
    rest = storeys[which][:, site.p - 1] if site.is_storey else np.full(len(R), np.nan)
    identified = drawn(R)
    t = np.arange(len(R), dtype=float) if m.t is None else m.t
    return SiteLoop(
        str(site),
        seg.name,
        t[rows][::step],
        drawn(m.s),
        drawn(m.v),
        identified,
        identified + rest[rows][::step] if np.isfinite(rest).all() else None,
    )


def _window(s: np.ndarray, first: int) -> tuple[int, slice]:
    """Every how many samples to draw, and a stretch around the largest motion."""
    step = int(max(1, min(period_of([s]) // _PER_CYCLE, len(s) // _POINTS)))
    width = min(len(s) - first, _POINTS * step)
    start = int(np.clip(int(np.abs(s).argmax()) - width // 2, first, len(s) - width))
    return step, slice(start, start + width)
