"""Windows of consecutive samples with probe regressors, built once for all diagnostics
of a fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..chain.layout import Block, LawLayout
from ..chain.sites import Site
from ..equations.balances import blocks_of_segment
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import filters_of

# the windows are dealt out to that many, and there are twice as many of them at least
FOLDS = 4
_WINDOW = 1024
_WINDOWS = 32
_ENOUGH = 8192  # samples of all windows where their order does not matter
SCALE_ROWS = 2048  # are enough for the rms of a channel


@dataclass(frozen=True)
class Window:
    """Consecutive samples: the block of the laws, and probe regressors by site of shape
    (OFFERED, n_samples).
    """

    block: Block
    offered: dict[Site, np.ndarray]
    every: int = 1  # one sample of so many is enough where their order does not matter
    record: int = 0  # number of the segment

    @property
    def n_samples(self) -> int:
        """Samples."""
        return self.block.acceleration.shape[1]

    def rate(self, site: Site) -> np.ndarray:
        """Rate of a site, divided by its rms: of the further columns, the first is its
        sign, the second its square.
        """
        return self.offered[site][0] * np.sqrt(np.abs(self.offered[site][1]))

    def enough(self) -> Window:
        """Samples that are enough where their order does not matter."""
        if self.every == 1:
            return self
        some = slice(None, None, self.every)
        return Window(
            self.block.take(some),
            {site: x[:, some] for site, x in self.offered.items()},
            record=self.record,
        )


def collect(
    layout: LawLayout, data: Dataset, band: Any, diagnostics: Sequence[Any]
) -> None:
    """Pass the windows of some data once to all diagnostics, which ``add`` them up."""
    if diagnostics:
        for number, window in enumerate(windows(layout, data, band)):
            for diagnostic in diagnostics:
                diagnostic.add(number, window)


def windows(layout: LawLayout, data: Dataset, band: Any) -> Iterator[Window]:
    """Some thousand rows in contiguous windows."""
    total = sum(seg.n_valid for seg in data.segments)
    size = min(_WINDOW, max(total // (2 * FOLDS), 1))
    first = data.segments[0].valid
    some = slice(
        first.start, first.stop, max(1, (first.stop - first.start) // SCALE_ROWS)
    )
    motions = [data.segments[0].motion(site, some) for site in layout.acting]
    scales = np.array([(m.v.std() or 1.0, m.s.std() or 1.0) for m in motions]).reshape(
        -1, 2
    )
    whole = band is not None
    every = max(1, -(-total // (size * _WINDOWS)))
    thin = max(1, total // every // _ENOUGH)
    count = 0
    for record, (seg, filter) in enumerate(zip(data.segments, filters_of(band, data))):
        if whole:
            block = next(iter(blocks_of_segment(seg, layout, filter=filter)))
            extra = list(
                probe_regressors(
                    *_motions(seg, layout),
                    scales,
                    _clock(seg.n_valid, slice(0, seg.n_valid)),
                )
            )
            if filter is not None:
                extra = [filter.apply(e.T).T for e in extra]
        n = seg.n_valid
        running = (
            blocks_of_segment(seg, layout, size, states={})
            if layout.has_memory and not whole
            else None
        )
        for start in range(0, max(n - size // 2, 1), size):
            count += 1
            rows = slice(start, min(start + size, n))
            window = (
                None if running is None else next(running)
            )  # a state needs all that lies before
            if (count - 1) % every:
                continue
            if whole:
                probes = dict(zip(layout.acting, (e[:, rows] for e in extra)))
                yield Window(block.take(rows), probes, thin, record)
            else:
                piece = replace(
                    seg,
                    valid=slice(
                        seg.valid.start + rows.start, seg.valid.start + rows.stop
                    ),
                )
                window = window or next(
                    iter(blocks_of_segment(piece, layout, size=rows.stop - rows.start))
                )
                offered = probe_regressors(
                    *_motions(piece, layout, window), scales, _clock(n, rows)
                )
                yield Window(window, dict(zip(layout.acting, offered)), thin, record)


def _clock(n: int, rows: slice) -> np.ndarray:
    """Time of some samples of a record, which lasts from -1 to 1."""
    return np.arange(rows.start, rows.stop) * (2.0 / max(n - 1, 1)) - 1.0


def _motions(
    piece: Segment, layout: LawLayout, block: Block | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rates and drifts that the laws at each acting site see; of the block whose
    columns were built from them.
    """
    sites, recipe = layout.acting, None if block is None else block.recipe
    if recipe is not None and recipe.motions == sites:
        assert block is not None and block.source is not None  # no filter went over it
        v, s = np.split(np.ascontiguousarray(block.source[: 2 * len(sites)]), 2)
        return v, s
    motions = [piece.motion(site, piece.valid) for site in sites]
    v, s = (
        np.array([getattr(m, key) for m in motions]).reshape(len(sites), -1)
        for key in "vs"
    )
    return v, s


LASTING = 2  # columns that are no law: a constant, a ramp in time
OFFERED = 7 + LASTING  # further columns of each site, those two last


def probe_regressors(
    v: np.ndarray, s: np.ndarray, scales: np.ndarray, clock: np.ndarray
) -> np.ndarray:
    """Friction, a quadratic damper and spring, a gap, three loops of hysteresis; a
    constant and a ramp.
    """
    out = np.empty((len(v), OFFERED, len(clock)))
    if out.size:
        forward, x, y = np.sign(v), v / scales[:, :1], s / scales[:, 1:]
        turns = np.where(
            np.diff(forward, axis=1, prepend=forward[:, :1]) != 0,
            np.arange(len(clock)),
            0,
        )
        path = np.abs(
            y - np.take_along_axis(y, np.maximum.accumulate(turns, axis=1), axis=1)
        )  # since the last turn
        loops = (forward * (1.0 - 2.0 * np.exp(-k * path)) for k in (1, 5, 25))
        columns = (
            forward,
            x * np.abs(x),
            y * np.abs(y),
            y - np.clip(y, -1.0, 1.0),
            *loops,
            1.0,
            clock,
        )
        for k, column in enumerate(columns):
            out[:, k] = column
    return out
