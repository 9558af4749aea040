"""Windowed spectra of the measured motion, fold by fold and band by band.

The balance of forces is algebraic in time: it holds for windowed columns as it holds for the columns themselves, so a
window costs no leakage. Every decision of the loop is taken on Gram matrices of these spectra. The mean of every column
over a fold is taken out: the zero of a sensor drifts, and a constant force is asked for by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..regression.segments import BlockRows, SegmentSet
from .constants import BANDS


class Windows:
    """Half-overlapping Hann windows of some blocks of samples.

    Parameters
    ----------
    data : SegmentSet
    blocks : sequence of BlockRows
        Those that hold at least one window are the folds.
    length : float
        Of a window, s.
    edges : ndarray, optional
        Hz; by default the mean of a window, then bands that are equal on a logarithmic axis.
    centred : bool
        Whether the mean over each fold is taken out.
    """

    def __init__(
        self,
        data: SegmentSet,
        blocks: Sequence[BlockRows],
        length: float,
        edges: np.ndarray | None = None,
        centred: bool = True,
    ) -> None:
        steps = [segment.dt or 1.0 for segment in data.segments]
        self.data, self.length, self.centred = data, length, centred
        self.sizes = [2 * max(4, round(0.5 * length / dt)) for dt in steps]
        self.blocks = [b for b in blocks if b.rows.stop - b.rows.start >= self.sizes[b.segment]]
        if edges is None:
            size, dt = max((self.sizes[b.segment], steps[b.segment]) for b in self.blocks)
            cuts = np.unique(np.rint(np.geomspace(2, size // 2 + 1, BANDS)).astype(int))
            edges = np.concatenate([[0.0], (cuts - 0.5) / (size * dt)])
        self.edges = edges
        self._lines = [np.searchsorted(np.fft.rfftfreq(size, dt), edges) for size, dt in zip(self.sizes, steps)]
        self._hann = [np.sin(np.pi * np.arange(n) / n) ** 2 * np.sqrt(2.0 / n / 0.75) for n in self.sizes]
        # Columns of the spectra that hold each band of each fold; the folds of a band stand side by side.
        widths = np.array([2 * self.count(b) * np.diff(self._lines[b.segment]) for b in self.blocks])
        ends = np.concatenate([[0], np.cumsum(widths.T)])
        first = ends[:-1].reshape(widths.T.shape).T
        self.spans = [[slice(int(a), int(a + w)) for a, w in zip(lo, width)] for lo, width in zip(first, widths)]
        self.bands = [slice(int(a), int(b)) for a, b in zip(first[0], [*first[0, 1:], ends[-1]])]
        self.size = int(ends[-1])
        self._order = np.concatenate([np.arange(s.start, s.stop) for spans in self.spans for s in spans])
        self._ones: list[np.ndarray] = []
        if centred:
            ones = self._transformed({b.segment: np.ones((1, b.rows.stop)) for b in self.blocks})[0]
            self._ones = [part / np.sqrt(part @ part) for part in (ones[spans[0]] for spans in self.spans)]

    def count(self, block: BlockRows) -> int:
        """Number of windows in a block."""
        size = self.sizes[block.segment]
        return 1 + 2 * (block.rows.stop - block.rows.start - size) // size

    def upto(self, band: int) -> Windows:
        """The same windows, spectra cut above a band."""
        return Windows(self.data, self.blocks, self.length, self.edges[: band + 2], self.centred)

    def spectra(self, rows: Mapping[int, np.ndarray]) -> np.ndarray:
        """Spectra of rows of each record, real and imaginary parts beside each other, (n_rows, size)."""
        out = self._transformed(rows)
        for spans, ones in zip(self.spans, self._ones):
            part = out[:, spans[0]]
            part -= np.outer(part @ ones, ones)
        return out

    def _transformed(self, rows: Mapping[int, np.ndarray]) -> np.ndarray:
        out = np.empty((next(iter(rows.values())).shape[0], self.size))
        at = 0
        for block in self.blocks:
            size, lines = self.sizes[block.segment], self._lines[block.segment]
            part = rows[block.segment][:, block.rows]
            windows = np.lib.stride_tricks.sliding_window_view(part, size, axis=1)[:, :: size // 2]
            windows = windows[:, : self.count(block)] * self._hann[block.segment]
            found = np.fft.rfft(windows)[:, :, lines[0] : lines[-1]]
            flat = np.ascontiguousarray(found.swapaxes(1, 2)).view(float).reshape(len(out), -1)
            out[:, self._order[at : at + flat.shape[1]]] = flat
            at += flat.shape[1]
        return out

    def grams(self, left: np.ndarray, right: np.ndarray | None = None) -> np.ndarray:
        """Products of spectra by fold and band, (n_folds, n_bands, n_left, n_right)."""
        right = left if right is None else right
        out = np.empty((len(self.spans), len(self.edges) - 1, len(left), len(right)))
        for fold, spans in enumerate(self.spans):
            for band, columns in enumerate(spans):
                np.matmul(left[:, columns], right[:, columns].T, out=out[fold, band])
        return out

    def band_grams(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Products of spectra by band, all folds together, (n_bands, n_left, n_right)."""
        return np.array([left[:, columns] @ right[:, columns].T for columns in self.bands])

    def products(self, columns: np.ndarray) -> np.ndarray:
        """Products of the columns of each trial by band, (n_trials, n_columns, size) to (n_trials, n_bands, n, n)."""
        count, width, _ = columns.shape
        starts = [b.start for b in self.bands]
        out = np.empty((count, len(starts), width, width))
        for i in range(width):
            for j in range(i + 1):
                out[:, :, i, j] = np.add.reduceat(columns[:, i] * columns[:, j], starts, axis=1)
                out[:, :, j, i] = out[:, :, i, j]
        return out
