"""Folds of the search, held-out pieces, and windowed spectra of the measured motion.

A record is counted in cells of half a window. Pieces hold equal shares of energy and
time and last several windows. The held-out ones last a period of the motion at least
where six or more were measured, so that they see all phases of a sine, and are placed
so that they hold their share of the energy of every channel.

The balance of forces is algebraic in time: it holds for windowed columns as it holds
for the columns themselves, so a window costs no leakage. Every decision of the loop is
taken on Gram matrices of windowed spectra. The mean of every column over a fold is
taken out: the zero of a sensor drifts, and a constant force is asked for by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.fft import rfft

from ..exceptions import ChannelError
from ..records.dataset import BlockRows, Dataset, Segment
from .constants import (
    BANDS,
    EXPLAINED,
    FOLDS,
    HELD_OUT,
    PIECES,
    SHORTEST_PIECE,
    WINDOWS,
)

# Rows of some records side by side, (n_rows, n_valid of all), from the numbers of
# these.
Rows = Callable[[tuple[int, ...]], Any]
# Samples of windows that are transformed at once: they stay in the processor's cache.
_AT_ONCE = 100_000
_TOO_SHORT = (
    "The records are too short to be split into search and held-out parts",
    "Give longer records.",
)


def window_length(segments: Sequence[Segment]) -> float:
    """Length of a window, s (samples where there is no clock)."""
    lengths = [s.n_valid * (s.dt or 1.0) for s in segments]
    return min(sum(lengths) / WINDOWS, min(lengths) / (2 * SHORTEST_PIECE))


def period_of(parts: Sequence[np.ndarray]) -> float:
    """Samples of a period at the rms frequency of a signal; 16 if it does not move."""
    pace = sum(float(np.sum(np.diff(p) ** 2)) for p in parts)
    size = sum(float(np.sum((p - p.mean()) ** 2)) for p in parts)
    return 2 * np.pi / max(np.sqrt(pace / size), 1e-6) if size > 0 else 16.0


def split(
    segments: Sequence[Segment], length: float, heldout: Sequence[int] | None = None
) -> tuple[list[BlockRows], list[BlockRows]]:
    """Folds of the search, and blocks held out."""
    whole = list(heldout or ())
    chosen = [i for i in range(len(segments)) if i not in whole]
    hop = [max(4, round(0.5 * length / (s.dt or 1.0))) for s in segments]
    if all(segments[i].n_valid < 3 * hop[i] for i in chosen):
        raise ChannelError(*_TOO_SHORT)
    energy = {i: _energy(segments[i], hop[i]) for i in chosen}
    total = sum(e.sum(axis=0) for e in energy.values())
    if not total[: segments[chosen[0]].n_dof].any():
        cure = "Dead sensors or wrong columns; check them."
        raise ChannelError(
            "Nothing moves in the records that are searched: drifts and velocities are"
            " zero",
            cure,
        )
    energy = {i: e[:, total > 0] / total[total > 0] for i, e in energy.items()}
    period = [
        int(np.ceil(period_of(np.nan_to_num(s.s[s.valid]).T) / h))
        for s, h in zip(segments, hop)
    ]  # cells
    apart = [BlockRows(i, slice(0, segments[i].n_valid)) for i in whole]
    if heldout is not None:
        search, _ = _cut(energy, hop, period, 0.0, 1, 0)
        if not _enough(search, hop):
            raise ChannelError(*_TOO_SHORT)
        return search, apart
    best, chosen_cut = np.inf, None
    for pieces, handicap in PIECES.items():
        for shift in range(FOLDS):
            search, held, unevenness = _scored(energy, hop, period, pieces, shift)
            if held and _enough(search, hop) and unevenness + handicap < best - 1e-9:
                best, chosen_cut = unevenness + handicap, (search, held)
    if chosen_cut is None:
        raise ChannelError(*_TOO_SHORT)
    return chosen_cut


def _energy(segment: Segment, hop: int) -> np.ndarray:
    """Energy of rates and forces in each cell, (n_cells, n_channels)."""
    parts = [y[segment.valid][hop:].T for y in (segment.v, segment.F)]
    if parts[0].shape[1] < 2 * hop:
        return np.zeros((1, sum(map(len, parts))))
    lines = (
        np.nan_to_num(line) for part in parts for line in part.astype(float, copy=False)
    )
    starts = hop * np.arange(max(1, parts[0].shape[1] // hop - 1))
    return np.column_stack(
        [np.add.reduceat((line - line.mean()) ** 2, starts) for line in lines]
    )


def _cut(
    energy: dict[int, np.ndarray],
    hop: Sequence[int],
    period: Sequence[int],
    share: float,
    pieces: int,
    shift: int,
) -> tuple[list[BlockRows], list[BlockRows]]:
    """Folds and held-out pieces of every record."""
    cells = sum(len(e) for e in energy.values())
    cut: tuple[list[BlockRows], list[BlockRows]] = [], []
    for i, own in energy.items():
        size = 0.5 * own.mean(axis=1) + 0.5 / cells
        count = max(1, round(FOLDS * size.sum()))
        room = len(size) // (
            3 * period[i]
        )  # pieces of a period that leave two thirds to the search
        slow = period[i] > SHORTEST_PIECE and room >= min(PIECES)
        widths, out = _pattern(
            count, share, min(pieces, room) if slow else pieces, shift
        )
        marks = (
            np.searchsorted(np.cumsum(size) / size.sum(), np.cumsum(widths)[:-1]) + 1
        )
        least = np.where(np.array(out) & slow, period[i], SHORTEST_PIECE)
        edges = _spaced(np.concatenate([[0], marks, [len(size)]]), least)
        for lo, hi, kept in zip(edges[:-1], edges[1:], out):
            cut[kept].append(
                BlockRows(i, slice((int(lo) + 1) * hop[i], (int(hi) + 1) * hop[i]))
            )
    return cut


def _pattern(
    count: int, share: float, pieces: int, shift: int
) -> tuple[list[float], list[bool]]:
    """Widths of folds and of the held-out pieces between them, and which are held
    out.
    """
    pieces = min(pieces, count) if share else 0
    after = {int((k + 1) * count / (pieces + 1) + shift) % count for k in range(pieces)}
    widths, out = [], []
    for k in range(count):
        widths.append((1.0 - share * bool(after)) / count)
        out.append(False)
        if k in after:
            widths.append(share / len(after))
            out.append(True)
    return widths, out


def _spaced(edges: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Edges at least so many cells apart, as far as there is room."""
    if least.sum() > edges[-1]:
        least = np.full(len(least), min(SHORTEST_PIECE, int(edges[-1]) // len(least)))
    if least[0] < 1:
        return np.arange(edges[-1] + 1)
    steps = np.concatenate([[0], np.cumsum(least)])
    out = np.maximum.accumulate(edges - steps) + steps
    return np.minimum(out, edges[-1] - steps[-1] + steps)


def _scored(
    energy: dict[int, np.ndarray],
    hop: Sequence[int],
    period: Sequence[int],
    pieces: int,
    shift: int,
) -> tuple[list[BlockRows], list[BlockRows], float]:
    """One way to cut the records, and how far the energy that is held out, or searched,
    is from its share.
    """
    search, held = _cut(energy, hop, period, HELD_OUT, pieces, shift)

    def cells(b: BlockRows, edge: int) -> np.ndarray:
        return energy[b.segment][
            b.rows.start // hop[b.segment] - 1 + edge : b.rows.stop // hop[b.segment]
            - 1
            - edge
        ]

    shares = sum(
        (cells(b, 0).sum(axis=0) for b in held),
        np.zeros(next(iter(energy.values())).shape[1]),
    )
    inside = [
        cells(b, 1) for b in search
    ]  # of the first and the last cell windows see next to nothing: a blow is lost
    seen = sum(x.sum(axis=0) for x in inside) / max(
        sum(map(len, inside)) / sum(map(len, energy.values())), 1e-9
    )
    uneven = np.abs(np.log(np.maximum(shares, 1e-9) / HELD_OUT)).max()
    uneven += max(0.0, -np.log(np.maximum(seen, 1e-9) / EXPLAINED).min())
    return search, held, float(uneven)


def _enough(search: Sequence[BlockRows], hop: Sequence[int]) -> bool:
    """Whether at least three folds hold a window."""
    return sum(b.rows.stop - b.rows.start >= 2 * hop[b.segment] for b in search) >= 3


class Windows:
    """Half-overlapping Hann windows of some blocks of samples.

    Parameters
    ----------
    data : Dataset
    blocks : sequence of BlockRows
        Those that hold at least one window are the folds.
    length : float
        Of a window, s.
    edges : ndarray, optional
        Hz; by default the mean of a window, then bands that are equal on a logarithmic
        axis.
    centred : bool
        Whether the mean over each fold is taken out.
    """

    def __init__(
        self,
        data: Dataset,
        blocks: Sequence[BlockRows],
        length: float,
        edges: np.ndarray | None = None,
        centred: bool = True,
    ) -> None:
        steps = [segment.dt or 1.0 for segment in data.segments]
        self.data, self.length, self.centred = data, length, centred
        self.sizes = [2 * max(4, round(0.5 * length / dt)) for dt in steps]
        self.blocks = [
            b for b in blocks if b.rows.stop - b.rows.start >= self.sizes[b.segment]
        ]
        if edges is None:
            size, dt = max(
                (self.sizes[b.segment], steps[b.segment]) for b in self.blocks
            )
            cuts = np.unique(np.rint(np.geomspace(2, size // 2 + 1, BANDS)).astype(int))
            edges = np.concatenate([[0.0], (cuts - 0.5) / (size * dt)])
        self.edges = edges
        self._lines = [
            np.searchsorted(np.fft.rfftfreq(size, dt), edges)
            for size, dt in zip(self.sizes, steps)
        ]
        # Records whose rows stand side by side: those with the same windows, some
        # samples at a time.
        ends = np.cumsum([segment.n_valid for segment in data.segments]) // _AT_ONCE
        alike: dict[tuple, list[int]] = {}
        for i in dict.fromkeys(b.segment for b in self.blocks):
            alike.setdefault((self.sizes[i], *self._lines[i], ends[i]), []).append(i)
        self.groups = [tuple(some) for some in alike.values()]
        self._hann = [
            np.sin(np.pi * np.arange(n) / n) ** 2 * np.sqrt(2.0 / n / 0.75)
            for n in self.sizes
        ]
        # Columns of the spectra that hold each band of each fold; the folds of a band
        # stand side by side.
        widths = np.array(
            [2 * self.count(b) * np.diff(self._lines[b.segment]) for b in self.blocks]
        )
        ends = np.concatenate([[0], np.cumsum(widths.T)])
        first = ends[:-1].reshape(widths.T.shape).T
        self.spans = [
            [slice(int(a), int(a + w)) for a, w in zip(lo, width)]
            for lo, width in zip(first, widths)
        ]
        self.bands = [
            slice(int(a), int(b)) for a, b in zip(first[0], [*first[0, 1:], ends[-1]])
        ]
        self.size = int(ends[-1])
        # Some windows of a group at a time: their starts, their lines, and the places
        # of these in a row of all; the order in which the spectral values of a column
        # stand there.
        self._some: list[tuple[int, np.ndarray, slice, slice]] = []
        self._order = np.empty(self.size // 2, dtype=np.int32)
        self._place_windows()
        self._means = np.zeros((0, 0))
        if centred and edges[0] == 0:  # the mean of a fold stands in the first lines
            ones = self._transformed(
                lambda some: np.ones((1, sum(data.segments[i].n_valid for i in some)))
            )[0]
            self._means = np.zeros((self.bands[0].stop, len(self.blocks)))
            for k, (part, *_) in enumerate(self.spans):
                self._means[part, k] = ones[part] / np.sqrt(ones[part] @ ones[part])

    def _place_windows(self) -> None:
        """Divide the windows of each group into those transformed at once, and find the
        places of their lines.
        """
        at = 0
        for k, group in enumerate(self.groups):
            starts, size, lines = [], self.sizes[group[0]], self._lines[group[0]]
            count, before = (
                int(np.ptp(lines)),
                np.cumsum([0, *(self.data.segments[i].n_valid for i in group)]),
            )
            for block, spans in (
                (b, spans)
                for b, spans in zip(self.blocks, self.spans)
                if b.segment in group
            ):
                each = np.arange(self.count(block))[:, None]
                starts.append(
                    before[group.index(block.segment)]
                    + block.rows.start
                    + size // 2 * each
                )
                places = (
                    at + count * each + np.arange(count)
                ).T.ravel()  # line by line, window by window
                self._order[
                    np.concatenate(
                        [np.arange(s.start // 2, s.stop // 2) for s in spans]
                    )
                ] = places
                at += len(places)
            every, stop = np.concatenate(starts), at - sum(map(len, starts)) * count
            for part in np.array_split(every, -(-len(every) * size // _AT_ONCE)):
                begin, stop = stop, stop + len(part) * count
                self._some.append(
                    (k, part, slice(lines[0], lines[-1]), slice(begin, stop))
                )

    def within(self, low: float | None, high: float | None) -> Windows:
        """The same windows with the lines of one frequency band, Hz, alone."""
        lowest, highest = low or 0.0, np.inf if high is None else high
        highest = min(highest, self.edges[-1])
        size, dt = max(
            (self.sizes[b.segment], self.data.segments[b.segment].dt or 1.0)
            for b in self.blocks
        )
        inside = self.edges[(self.edges > lowest) & (self.edges < highest)]
        edges = np.concatenate([[lowest], inside, [highest]])
        edges = edges[
            np.unique(
                np.searchsorted(np.fft.rfftfreq(size, dt), edges), return_index=True
            )[1]
        ]
        if len(edges) < 2:
            what = (
                f"No spectral line of a window of {self.length:.3g} s lies between"
                f" {lowest:g} and {highest:g} Hz"
            )
            raise ChannelError(
                what,
                f"Give longer records, or a band wider than {1 / self.length:.3g} Hz.",
            )
        return Windows(self.data, self.blocks, self.length, edges, self.centred)

    def count(self, block: BlockRows) -> int:
        """Number of windows in a block."""
        size = self.sizes[block.segment]
        return 1 + 2 * (block.rows.stop - block.rows.start - size) // size

    def upto(self, band: int) -> Windows:
        """The same windows, spectra cut above a band."""
        return Windows(
            self.data, self.blocks, self.length, self.edges[: band + 2], self.centred
        )

    def spectra(self, rows: Rows, kind: Any = float) -> np.ndarray:
        """Spectra of rows of each group of records, real and imaginary parts beside
        each other, (n_rows, size).
        """
        out = self._transformed(rows, kind)
        part = out[:, : len(self._means)]
        part -= part @ self._means @ self._means.T
        return out

    def _transformed(self, rows: Rows, kind: Any = float) -> np.ndarray:
        own = [rows(group) for group in self.groups]
        sizes = [self.sizes[group[0]] for group in self.groups]
        out = np.empty((len(own[0]), self.size // 2), dtype=np.result_type(kind, 1j))
        few = max(
            1, _AT_ONCE // sum(len(starts) * sizes[k] for k, starts, *_ in self._some)
        )
        every, within = (
            np.empty((few, self.size // 2), dtype=complex),
            [np.arange(size) for size in sizes],
        )
        for some in (slice(at, at + few) for at in range(0, len(out), few)):
            lines = every[: min(few, len(out) - some.start)]
            y = [np.asarray(held[some], dtype=float) for held in own]
            for k, starts, inside, places in self._some:
                windows = y[k].take(starts + within[k], axis=1)
                windows *= self._hann[self.groups[k][0]]
                into = lines[:, places].reshape(len(lines), len(starts), -1)
                into[:] = rfft(windows, axis=-1, overwrite_x=True)[..., inside]
            out[some] = lines.take(self._order, axis=1)
        return out.view(kind)

    def grams(self, *spectra: np.ndarray) -> np.ndarray:
        """Products of the rows of some spectra by fold and band, (n_folds, n_bands,
        n_rows, n_rows).
        """
        bands = []
        for band, *spans in zip(self.bands, *self.spans):
            part = np.vstack([rows[:, band] for rows in spectra]).astype(
                float, copy=False
            )
            folds = (
                part[:, span.start - band.start : span.stop - band.start]
                for span in spans
            )
            bands.append(np.array([own @ own.T for own in folds]))
        return np.stack(bands, axis=1)

    def products(self, columns: np.ndarray) -> np.ndarray:
        """Products of the columns of each trial by band, (n_trials, n_columns, size) to
        (n_trials, n_bands, n, n).
        """
        return np.stack(
            [(part := columns[..., band]) @ part.swapaxes(1, 2) for band in self.bands],
            axis=1,
        )


class ChannelWindows(Windows):
    """Windows of rows that each have several channels, one after the other: the bands
    of every channel are bands.
    """

    def __init__(self, channels: int, *given: Any) -> None:
        super().__init__(*given)
        self.bands, *self.spans = (
            [
                slice(b.start + c * self.size, b.stop + c * self.size)
                for c in range(channels)
                for b in bands
            ]
            for bands in (self.bands, *self.spans)
        )
        self.channels = channels

    def spectra(self, rows: Rows, kind: Any = float) -> np.ndarray:
        """Spectra of rows, those of all channels beside each other, (n_rows, n_channels
        * size).
        """
        return super().spectra(rows, kind).reshape(-1, self.channels * self.size)
