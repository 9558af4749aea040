"""Windows of consecutive samples with probe regressors, built once for all diagnostics.

Probe regressors are columns that the laws may lack: friction, quadratic damping and
stiffness, a gap, three loops of hysteresis; and a constant and a ramp in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..chain.layout import Block, LawLayout
from ..chain.sites import Site
from ..equations.balances import blocks_of_segment
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import Band, ZeroPhaseFilter, filters_of

# Folds to which windows are dealt out; there are twice as many windows at least.
FOLDS = 4
# Samples of a window at most.
MAX_WINDOW = 1024
# Windows that are used of all data, at most.
MAX_WINDOWS = 32
# Samples of all windows that are enough where their order does not matter.
ENOUGH_SAMPLES = 8192
# Samples that are enough for the rms of a channel.
SCALE_ROWS = 2048

# Probe regressors of each site; the last of them are a constant and a ramp in time,
# which are no law.
LASTING = 2
OFFERED = 7 + LASTING
# Rates at which the loops of hysteresis forget the last reversal, per rms drift.
LOOP_RATES = (1, 5, 25)


@dataclass(frozen=True)
class Window:
    """Consecutive samples of one record.

    Attributes
    ----------
    block : Block
        Columns of the laws.
    offered : dict of Site to ndarray of shape (OFFERED, n_samples)
        Probe regressors.
    thinning : int
        One sample of so many is enough where their order does not matter.
    record : int
        Number of the segment.
    """

    block: Block
    offered: dict[Site, np.ndarray]
    thinning: int = 1
    record: int = 0

    @property
    def n_samples(self) -> int:
        """Samples."""
        return self.block.acceleration.shape[1]

    def rate(self, site: Site) -> np.ndarray:
        """Rate of a site over its rms, from its sign and its signed square."""
        sign, square = self.offered[site][:2]
        return sign * np.sqrt(np.abs(square))

    def thinned(self) -> Window:
        """Samples that are enough where their order does not matter."""
        if self.thinning == 1:
            return self
        rows = slice(None, None, self.thinning)
        offered = {site: probes[:, rows] for site, probes in self.offered.items()}
        return Window(self.block.take(rows), offered, record=self.record)


class Diagnostic(Protocol):
    """What adds windows up."""

    def add(self, number: int, window: Window) -> None:
        """Take a window in."""


def collect(
    layout: LawLayout, data: Dataset, band: Band, diagnostics: Sequence[Diagnostic]
) -> None:
    """Pass the windows of some data once to all diagnostics."""
    if not diagnostics:
        return
    for number, window in enumerate(windows(layout, data, band)):
        for diagnostic in diagnostics:
            diagnostic.add(number, window)


def windows(layout: LawLayout, data: Dataset, band: Band) -> Iterator[Window]:
    """Some thousand samples in contiguous windows.

    Parameters
    ----------
    layout : LawLayout
    data : Dataset
    band : tuple of float or None
        Hz; columns and probe regressors are filtered alike.
    """
    n_samples = sum(segment.n_valid for segment in data.segments)
    size = min(MAX_WINDOW, max(n_samples // (2 * FOLDS), 1))
    every_window = max(1, -(-n_samples // (size * MAX_WINDOWS)))
    every_sample = max(1, n_samples // every_window // ENOUGH_SAMPLES)
    scales = _scales_of(layout, data.segments[0])

    n_passed = 0
    filters = filters_of(band, data)
    for number, (segment, band_filter) in enumerate(zip(data.segments, filters)):
        spans = _spans(segment.n_valid, size, every_window, n_passed)
        n_passed += len(spans)
        source = _Source(segment, layout, scales)
        if band_filter is None:
            parts = source.raw_parts(spans, size)
        else:
            parts = source.filtered_parts(spans, band_filter)
        for block, offered in parts:
            yield Window(block, offered, every_sample, number)


def _scales_of(layout: LawLayout, segment: Segment) -> np.ndarray:
    """Rms rate and drift of each acting site in some samples, (n_sites, 2)."""
    step = max(1, segment.n_valid // SCALE_ROWS)
    rows = slice(segment.valid.start, segment.valid.stop, step)
    scales = []
    for site in layout.acting:
        motion = segment.motion(site, rows)
        scales.append((motion.v.std() or 1.0, motion.s.std() or 1.0))
    return np.array(scales).reshape(-1, 2)


@dataclass(frozen=True)
class _Span:
    """Rows of a window, from the first valid row on, and whether it is used."""

    rows: slice
    used: bool


def _spans(n_rows: int, size: int, every_window: int, n_passed: int) -> list[_Span]:
    """Windows of a record; a rest of less than half a window is left out."""
    spans: list[_Span] = []
    for start in range(0, max(n_rows - size // 2, 1), size):
        rows = slice(start, min(start + size, n_rows))
        number = n_passed + len(spans)
        spans.append(_Span(rows, used=number % every_window == 0))
    return spans


def _filtered(probes: np.ndarray, band_filter: ZeroPhaseFilter) -> np.ndarray:
    """Probe regressors of one site behind a filter."""
    filtered = band_filter.apply(probes.T).T
    if band_filter.sos is None:
        # a constant stays: functions of a force without its mean have means
        filtered[-LASTING:] = probes[-LASTING:]
    return filtered


_Window = tuple[Block, dict[Site, np.ndarray]]


@dataclass(frozen=True)
class _Source:
    """Columns and probe regressors of one record."""

    segment: Segment
    layout: LawLayout
    scales: np.ndarray

    def filtered_parts(
        self, spans: Sequence[_Span], band_filter: ZeroPhaseFilter | None
    ) -> Iterator[_Window]:
        """Windows cut from the whole record, which is filtered at once."""
        blocks = blocks_of_segment(self.segment, self.layout, filter=band_filter)
        block = next(iter(blocks))
        all_rows = _Span(slice(0, self.segment.n_valid), used=True)
        probes = list(self._probes(self.segment, all_rows))
        if band_filter is not None:
            probes = [_filtered(columns, band_filter) for columns in probes]

        for span in spans:
            if span.used:
                cut = [columns[:, span.rows] for columns in probes]
                yield block.take(span.rows), dict(zip(self.layout.acting, cut))

    def raw_parts(self, spans: Sequence[_Span], size: int) -> Iterator[_Window]:
        """Windows one by one; laws with memory need all samples before them."""
        running = None
        if self.layout.has_memory:
            running = blocks_of_segment(self.segment, self.layout, size, states={})

        first = self.segment.valid.start
        for span in spans:
            block = None if running is None else next(running)
            if not span.used:
                continue
            rows = slice(first + span.rows.start, first + span.rows.stop)
            piece = replace(self.segment, valid=rows)
            if block is None:
                blocks = blocks_of_segment(piece, self.layout, size=piece.n_valid)
                block = next(iter(blocks))
            probes = self._probes(piece, span, block)
            yield block, dict(zip(self.layout.acting, probes))

    def _probes(
        self, piece: Segment, span: _Span, block: Block | None = None
    ) -> np.ndarray:
        """Probe regressors of a piece, (n_sites, OFFERED, n_samples)."""
        v, s = _motions(piece, self.layout, block)
        last = max(self.segment.n_valid - 1, 1)
        clock = np.arange(span.rows.start, span.rows.stop) * (2.0 / last) - 1.0
        return probe_regressors(v, s, self.scales, clock)


def _motions(
    piece: Segment, layout: LawLayout, block: Block | None
) -> tuple[np.ndarray, np.ndarray]:
    """Rates and drifts of each acting site, (n_sites, n_samples).

    Those from which the columns of a block were built, if the block has them.
    """
    sites = layout.acting
    recipe = None if block is None else block.recipe
    if block is not None and recipe is not None and recipe.motions == sites:
        assert block.source is not None  # it was not filtered
        motions = np.ascontiguousarray(block.source[: 2 * len(sites)])
        return motions[: len(sites)], motions[len(sites) :]

    v = np.empty((len(sites), piece.n_valid))
    s = np.empty((len(sites), piece.n_valid))
    for k, site in enumerate(sites):
        motion = piece.motion(site, piece.valid)
        v[k] = motion.v
        s[k] = motion.s
    return v, s


def probe_regressors(
    v: np.ndarray, s: np.ndarray, scales: np.ndarray, clock: np.ndarray
) -> np.ndarray:
    """Columns that the laws of some sites may lack.

    Parameters
    ----------
    v, s : ndarray of shape (n_sites, n_samples)
        Rates (m/s) and drifts (m).
    scales : ndarray of shape (n_sites, 2)
        Their rms.
    clock : ndarray of shape (n_samples,)
        Time, from -1 to 1 over the record.

    Returns
    -------
    ndarray of shape (n_sites, OFFERED, n_samples)
        Sign and signed square of the rate, signed square of the drift, a gap of the rms
        drift, loops of hysteresis; a constant and a ramp.
    """
    out = np.empty((len(v), OFFERED, len(clock)))
    if not out.size:
        return out

    forward = np.sign(v)
    rate = v / scales[:, :1]
    drift = s / scales[:, 1:]
    out[:, 0] = forward
    out[:, 1] = rate * np.abs(rate)
    out[:, 2] = drift * np.abs(drift)
    out[:, 3] = drift - np.clip(drift, -1.0, 1.0)

    path = np.abs(drift - _at_last_reversal(drift, forward))
    for k, loop_rate in enumerate(LOOP_RATES, 4):
        out[:, k] = forward * (1.0 - 2.0 * np.exp(-loop_rate * path))

    out[:, -2] = 1.0
    out[:, -1] = clock
    return out


def _at_last_reversal(drift: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Drift at the last reversal before each sample."""
    reverses = np.diff(forward, axis=1, prepend=forward[:, :1]) != 0
    numbers = np.where(reverses, np.arange(drift.shape[1]), 0)
    last = np.maximum.accumulate(numbers, axis=1)
    return np.take_along_axis(drift, last, axis=1)
