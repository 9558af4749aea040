"""Windowed spectra of rows of samples, by fold and band.

The balance of forces is algebraic in time: it holds for windowed columns as it holds
for the columns themselves, so a window costs no leakage. Every decision of the loop is
taken on products of windowed spectra. The mean of every column over a fold is taken
out: the zero of a sensor drifts, and a constant force is asked for by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike
from scipy.fft import rfft, rfftfreq

from ..exceptions import ChannelError
from ..records.dataset import BlockRows, Dataset

# Rows of some records side by side, (n_rows, n_valid of all), from the numbers of the
# records.
Rows = Callable[[tuple[int, ...]], Sequence[np.ndarray] | np.ndarray]
# Samples of windows that are transformed at once: they stay in the processor's cache.
SAMPLES_AT_ONCE = 100_000


@dataclass(frozen=True)
class WindowSettings:
    """Numbers that make spectra."""

    # Bands, equal on a logarithmic axis: about eight to the decade over three decades.
    n_bands: int = 24


WINDOWS = WindowSettings()


@dataclass(frozen=True)
class _Batch:
    """Windows of one group of records that are transformed together."""

    group: int
    # First sample of each window in the rows of the group, (n_windows, 1).
    starts: np.ndarray
    # Lines of each transform that the bands read.
    lines: slice
    # Where their values stand in the row of all.
    places: slice


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

    Attributes
    ----------
    blocks : list of BlockRows
        The folds.
    spans : list of list of slice
        Columns of the spectra of each band in each fold.
    bands : list of slice
        Columns of the spectra of each band; the folds of a band stand side by side.
    size : int
        Length of a row of spectra, real and imaginary parts side by side.
    """

    def __init__(
        self,
        data: Dataset,
        blocks: Sequence[BlockRows],
        length: float,
        edges: np.ndarray | None = None,
        centred: bool = True,
    ) -> None:
        self.data = data
        self.length = length
        self.centred = centred
        self._steps = [segment.dt or 1.0 for segment in data.segments]
        self._samples = [2 * max(4, round(0.5 * length / dt)) for dt in self._steps]
        self.blocks = [b for b in blocks if self._n_rows(b) >= self._samples[b.segment]]
        self.edges = self._default_edges() if edges is None else edges

        self._lines = []
        for samples, dt in zip(self._samples, self._steps):
            frequencies = rfftfreq(samples, dt)
            self._lines.append(np.searchsorted(frequencies, self.edges))

        self.spans, self.bands = self._place_bands()
        self.size = self.bands[-1].stop
        self._groups = self._alike_records()
        self._hann = [_hann(self._samples[group[0]]) for group in self._groups]
        self._batches, self._order = self._place_windows()
        self._means = self._mean_directions()

    def _n_rows(self, block: BlockRows) -> int:
        return block.rows.stop - block.rows.start

    def _longest_window(self) -> tuple[int, float]:
        """Samples and sampling step of the longest window."""
        return max(
            (self._samples[b.segment], self._steps[b.segment]) for b in self.blocks
        )

    def _default_edges(self) -> np.ndarray:
        samples, dt = self._longest_window()
        lines = np.geomspace(2, samples // 2 + 1, WINDOWS.n_bands)
        lines = np.unique(np.rint(lines).astype(int))
        return np.concatenate([[0.0], (lines - 0.5) / (samples * dt)])

    def _place_bands(self) -> tuple[list[list[slice]], list[slice]]:
        """Columns of the spectra of each band in each fold, and of each band."""
        widths = np.array(
            [2 * self.count(b) * np.diff(self._lines[b.segment]) for b in self.blocks]
        )
        stops = np.cumsum(widths.T).reshape(widths.T.shape)
        starts = stops - widths.T

        spans = []
        for k in range(len(self.blocks)):
            ends = zip(starts[:, k].tolist(), stops[:, k].tolist())
            spans.append([slice(start, stop) for start, stop in ends])
        ends = zip(starts[:, 0].tolist(), stops[:, -1].tolist())
        return spans, [slice(start, stop) for start, stop in ends]

    def _alike_records(self) -> list[tuple[int, ...]]:
        """Records with the same windows, whose rows stand side by side.

        Only so many at a time as the cache of the processor takes.
        """
        n_valid = [segment.n_valid for segment in self.data.segments]
        batch = np.cumsum(n_valid) // SAMPLES_AT_ONCE
        alike: dict[tuple[int, ...], list[int]] = {}
        for record in dict.fromkeys(b.segment for b in self.blocks):
            lines = self._lines[record].tolist()
            key = (self._samples[record], *lines, int(batch[record]))
            alike.setdefault(key, []).append(record)
        return [tuple(records) for records in alike.values()]

    def _place_windows(self) -> tuple[list[_Batch], np.ndarray]:
        """Batches of windows, and the order in which their values make a spectrum."""
        order = np.empty(self.size // 2, dtype=np.int32)
        batches: list[_Batch] = []
        place = 0

        for number, group in enumerate(self._groups):
            samples = self._samples[group[0]]
            lines = slice(self._lines[group[0]][0], self._lines[group[0]][-1])
            n_lines = lines.stop - lines.start
            begin, starts = place, []
            for fold, block in enumerate(self.blocks):
                if block.segment not in group:
                    continue
                windows = np.arange(self.count(block))[:, None]
                first = self._first_row(group, block)
                starts.append(first + samples // 2 * windows)
                # line by line, window by window
                places = (place + n_lines * windows + np.arange(n_lines)).T.ravel()
                order[self._values_of(fold)] = places
                place += len(places)

            every = np.concatenate(starts)
            n_batches = -(-len(every) * samples // SAMPLES_AT_ONCE)
            for batch in np.array_split(every, n_batches):
                stop = begin + len(batch) * n_lines
                batches.append(_Batch(number, batch, lines, slice(begin, stop)))
                begin = stop

        return batches, order

    def _first_row(self, group: tuple[int, ...], block: BlockRows) -> int:
        """First row of a block in the rows of its group."""
        before = group[: group.index(block.segment)]
        return sum(self.data.segments[i].n_valid for i in before) + block.rows.start

    def _values_of(self, fold: int) -> np.ndarray:
        """Where the complex values of a fold stand in a spectrum."""
        parts = [np.arange(s.start // 2, s.stop // 2) for s in self.spans[fold]]
        return np.concatenate(parts)

    def _mean_directions(self) -> np.ndarray:
        """Spectrum of a constant in each fold, of length one; none if means stay in.

        The mean of a fold stands in the first lines.
        """
        if not self.centred or self.edges[0] != 0:
            return np.zeros((0, 0))

        def constant(group: tuple[int, ...]) -> np.ndarray:
            return np.ones((1, sum(self.data.segments[i].n_valid for i in group)))

        spectrum = self._transformed(constant, float)[0]
        means = np.zeros((self.bands[0].stop, len(self.blocks)))
        for k, bands in enumerate(self.spans):
            line = spectrum[bands[0]]
            means[bands[0], k] = line / np.sqrt(line @ line)
        return means

    def count(self, block: BlockRows) -> int:
        """Number of windows in a block."""
        size = self._samples[block.segment]
        return 1 + 2 * (self._n_rows(block) - size) // size

    def within(self, low: float | None, high: float | None) -> Windows:
        """The same windows with the lines of one frequency band, Hz, alone."""
        lowest = low or 0.0
        highest = self.edges[-1] if high is None else min(high, self.edges[-1])
        inside = self.edges[(self.edges > lowest) & (self.edges < highest)]
        edges = np.concatenate([[lowest], inside, [highest]])

        lines = np.searchsorted(rfftfreq(*self._longest_window()), edges)
        edges = edges[np.unique(lines, return_index=True)[1]]
        if len(edges) < 2:
            raise ChannelError(
                f"No spectral line of a window of {self.length:.3g} s lies between"
                f" {lowest:g} and {highest:g} Hz",
                f"Give longer records, or a band wider than {1 / self.length:.3g} Hz.",
            )
        return self.over(self.blocks, edges)

    def up_to(self, band: int) -> Windows:
        """The same windows, spectra cut above a band."""
        return self.over(self.blocks, self.edges[: band + 2])

    def over(
        self,
        blocks: Sequence[BlockRows],
        edges: np.ndarray | None = None,
        data: Dataset | None = None,
    ) -> Windows:
        """The same windows on other rows, with other bands, or of other records."""
        return Windows(
            self.data if data is None else data,
            blocks,
            self.length,
            self.edges if edges is None else edges,
            self.centred,
        )

    def with_means(self) -> Windows:
        """The same windows with the means of the folds left in."""
        return Windows(self.data, self.blocks, self.length, self.edges, centred=False)

    def spectra(self, rows: Rows, kind: DTypeLike = float) -> np.ndarray:
        """Spectra of rows of each group of records, (n_rows, size).

        Real and imaginary parts stand side by side.
        """
        out = self._transformed(rows, kind)
        lowest = out[:, : len(self._means)]
        lowest -= lowest @ self._means @ self._means.T
        return out

    def _transformed(self, rows: Rows, kind: DTypeLike) -> np.ndarray:
        by_group = [rows(group) for group in self._groups]
        n_rows = len(by_group[0])
        out = np.empty((n_rows, self.size // 2), dtype=np.result_type(kind, 1j))
        at_once = self._rows_at_once()
        values = np.empty((at_once, self.size // 2), dtype=complex)

        for start in range(0, n_rows, at_once):
            chunk = slice(start, min(start + at_once, n_rows))
            lines = values[: chunk.stop - chunk.start]
            samples = [np.asarray(group[chunk], dtype=float) for group in by_group]
            for batch, windowed in self._windowed(samples):
                into = lines[:, batch.places]
                into = into.reshape(len(lines), len(batch.starts), -1)
                spectrum = rfft(windowed, axis=-1, overwrite_x=True)
                into[:] = spectrum[..., batch.lines]
            out[chunk] = lines.take(self._order, axis=1)

        return out.view(kind)

    def _rows_at_once(self) -> int:
        """Rows whose windows stay in the processor's cache together."""
        samples = 0
        for batch in self._batches:
            samples += len(batch.starts) * len(self._hann[batch.group])
        return max(1, SAMPLES_AT_ONCE // samples)

    def _windowed(
        self, by_group: Sequence[np.ndarray]
    ) -> Iterator[tuple[_Batch, np.ndarray]]:
        """Samples of each batch times the window, (n_rows, n_windows, n_samples)."""
        for batch in self._batches:
            hann = self._hann[batch.group]
            rows = batch.starts + np.arange(len(hann))
            windowed = by_group[batch.group].take(rows, axis=1)
            windowed *= hann
            yield batch, windowed

    def products(self, *spectra: np.ndarray) -> np.ndarray:
        """Products of the rows of some spectra by fold and band.

        Returns
        -------
        ndarray of shape (n_folds, n_bands, n_rows, n_rows)
        """
        by_band = []
        for band, *spans in zip(self.bands, *self.spans):
            rows = np.vstack([lines[:, band] for lines in spectra])
            rows = rows.astype(float, copy=False)
            by_fold = []
            for span in spans:
                fold = rows[:, span.start - band.start : span.stop - band.start]
                by_fold.append(fold @ fold.T)
            by_band.append(np.array(by_fold))
        return np.stack(by_band, axis=1)

    def products_of_trials(self, columns: np.ndarray) -> np.ndarray:
        """Products of the columns of each trial by band.

        Parameters
        ----------
        columns : ndarray of shape (n_trials, n_columns, size)

        Returns
        -------
        ndarray of shape (n_trials, n_bands, n_columns, n_columns)
        """
        by_band = []
        for band in self.bands:
            in_band = columns[..., band]
            by_band.append(in_band @ in_band.swapaxes(1, 2))
        return np.stack(by_band, axis=1)


def _hann(n_samples: int) -> np.ndarray:
    """Hann window, scaled so that the sum over windows is that of the samples."""
    scale = np.sqrt(2.0 / n_samples / 0.75)
    return np.sin(np.pi * np.arange(n_samples) / n_samples) ** 2 * scale


class ChannelWindows(Windows):
    """Windows of rows that each have several channels, one after the other.

    The bands of every channel are bands.
    """

    def __init__(
        self,
        n_channels: int,
        data: Dataset,
        blocks: Sequence[BlockRows],
        length: float,
        edges: np.ndarray | None = None,
    ) -> None:
        super().__init__(data, blocks, length, edges)
        self.n_channels = n_channels
        self.bands = self._repeated(self.bands)
        self.spans = [self._repeated(spans) for spans in self.spans]

    def _repeated(self, bands: Sequence[slice]) -> list[slice]:
        """The bands of one channel, then those of the next, and so on."""
        out = []
        for channel in range(self.n_channels):
            offset = channel * self.size
            out += [slice(b.start + offset, b.stop + offset) for b in bands]
        return out

    def spectra(self, rows: Rows, kind: DTypeLike = float) -> np.ndarray:
        """Spectra of rows, those of all channels side by side.

        Returns
        -------
        ndarray of shape (n_rows, n_channels * size)
        """
        every = super().spectra(rows, kind)
        return every.reshape(-1, self.n_channels * self.size)
