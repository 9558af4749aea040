"""Some thousand samples of a fit in contiguous windows, for those who judge it: what they all need, built once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..laws.base import Motion
from ..layout import LawLayout
from ..moments import Block
from ..segments import Segment, SegmentSet
from ..sites import Site

LASTING = 2  # columns that are no law: a constant, a ramp in time
OFFERED = 7 + LASTING  # further columns of each site, those two last
FOLDS = 4  # the windows are dealt out to that many, and there are twice as many of them at least
_WINDOW = 1024
_WINDOWS = 32
_SCALE_ROWS = 10_000  # are enough for the rms of a channel


class Window(NamedTuple):
    """Consecutive samples.

    Attributes
    ----------
    terms : ndarray of shape (n_terms, n_samples)
        Columns of the laws.
    offered : dict of Site to ndarray of shape (OFFERED, n_samples)
        Columns that stand for what a law may lack; the first is the sign of the rate, the last two are
        a constant and the time, from -1 to 1 over the record.
    a, force : ndarray of shape (n_dof, n_samples)
        m/s^2, N.
    """

    terms: np.ndarray
    offered: dict[Site, np.ndarray]
    a: np.ndarray
    force: np.ndarray

    def forward(self, site: Site) -> np.ndarray:
        """Sign of the rate of a site."""
        return self.offered[site][0]


class Judge(Protocol):
    """Whoever looks at windows, one after another."""

    def see(self, number: int, window: Window) -> None:
        """Take a window in."""


def show(layout: LawLayout, data: SegmentSet, band: Any, judges: Sequence[Judge]) -> None:
    """Walk once through the windows of some data, with all who want to see them.

    Parameters
    ----------
    layout : LawLayout
    data : SegmentSet
    band : (float, float) or None
        Hz; columns are filtered whole.
    judges : sequence of Judge
    """
    if judges:
        for number, window in enumerate(windows(layout, data, band)):
            for judge in judges:
                judge.see(number, window)


def windows(layout: LawLayout, data: SegmentSet, band: Any) -> Iterator[Window]:
    """Some thousand rows in contiguous windows."""
    from ..fair_filter import filters_of

    total = sum(seg.n_valid for seg in data.segments)
    size = min(_WINDOW, max(total // (2 * FOLDS), 1))
    first = data.segments[0].valid
    some = slice(first.start, first.stop, max(1, (first.stop - first.start) // _SCALE_ROWS))
    motions = [seg.motion(s, some) for seg in data.segments[:1] for s in layout.acting]
    scales = {s: (m.v.std() or 1.0, m.s.std() or 1.0) for s, m in zip(layout.acting, motions)}
    whole = band is not None
    every = max(1, -(-total // (size * _WINDOWS)))
    count = 0
    for seg, filter in zip(data.segments, filters_of(band, data)):
        if whole:
            block = next(iter(seg.blocks(layout, filter=filter)))
            motions_here = {s: seg.motion(s, seg.valid) for s in layout.acting}
            extra = _offered(motions_here, scales, np.linspace(-1, 1, seg.n_valid))
            if filter is not None:
                extra = {s: filter.apply(e.T).T for s, e in extra.items()}
        n = seg.n_valid
        running = seg.blocks(layout, size, states={}) if layout.has_memory and not whole else None
        for start in range(0, max(n - size // 2, 1), size):
            count += 1
            rows = slice(start, min(start + size, n))
            window = None if running is None else next(running)  # a state needs all that lies before
            if (count - 1) % every:
                continue
            if whole:
                offered = {s: e[:, rows] for s, e in extra.items()}
                yield Window(block.terms[:, rows], offered, block.acceleration[:, rows], block.force[:, rows])
            else:
                piece = _part(seg, rows)
                window = window or next(iter(piece.blocks(layout, size=rows.stop - rows.start)))
                offered = _offered(_motions(piece, window, layout), scales, np.linspace(-1, 1, n)[rows])
                yield Window(window.terms, offered, window.acceleration, window.force)


def _motions(piece: Segment, window: Block, layout: LawLayout) -> dict[Any, Any]:
    """What a law at each site sees; taken from the block where its columns were built from it."""
    assert window.recipe is not None and window.source is not None  # no filter went over it
    sites, source = window.recipe.motions, window.source
    held = {s: Motion(source[len(sites) + i], source[i]) for i, s in enumerate(sites)}
    return {s: held[s] if s in held else piece.motion(s, piece.valid) for s in layout.acting}


def _part(seg: Segment, rows: slice) -> Segment:
    first = seg.valid.start
    return replace(seg, valid=slice(first + rows.start, first + rows.stop))


def _offered(
    motions: dict[Any, Any], scales: dict[Any, tuple[float, float]], clock: np.ndarray
) -> dict[Any, np.ndarray]:
    """Columns that stand for what a law may lack, one row each (friction, hysteresis, kinks), and what no law is."""
    if not motions:
        return {}
    v = np.array([m.v / scales[site][0] for site, m in motions.items()])
    s = np.array([m.s / scales[site][1] for site, m in motions.items()])
    forward = np.sign(v)
    # drift since the last reversal: on it a saturated hysteresis depends (Masing's rule)
    turn = np.where(np.diff(forward, axis=1, prepend=forward[:, :1]) != 0, np.arange(v.shape[1]), 0)
    way = np.abs(s - np.take_along_axis(s, np.maximum.accumulate(turn, axis=1), axis=1))
    loops = [forward * (1.0 - 2.0 * np.exp(-sharp * way)) for sharp in (1.0, 5.0, 25.0)]
    size = np.abs(s)
    rows = np.array([forward, v * np.abs(v), s * size, np.maximum(size - 1.0, 0.0) * np.sign(s), *loops])
    lasting = np.broadcast_to(np.array([np.ones_like(clock), clock])[:, None], (LASTING, *v.shape))
    rows = np.concatenate([rows, lasting])
    return {site: rows[:, i] for i, site in enumerate(motions)}
