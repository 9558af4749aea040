"""The range of every channel, in one pass over the samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from ..common.threads import in_threads

_SHARE = 2**20  # numbers that a thread scans at once


@dataclass(frozen=True)
class Extent:
    """Least and largest value of channels, and which of them hold a NaN or an infinity.

    Attributes
    ----------
    low, high : ndarray of shape (n_channels,)
        NaN is passed over; +inf and -inf for a channel of NaN.
    finite : ndarray of shape (n_channels,), bool
    """

    low: np.ndarray
    high: np.ndarray
    finite: np.ndarray

    @classmethod
    def of(cls, matrices: Sequence[np.ndarray]) -> Extent:
        """Extent of the columns of some matrices."""
        low, high, bad = np.zeros((3, sum(matrix.shape[1] for matrix in matrices)))
        low[:], high[:] = np.inf, -np.inf
        for where, (least, most, zero) in in_threads(_scanned, _shares(matrices)):
            low[where], high[where] = np.minimum(low[where], least), np.maximum(high[where], most)
            bad[where] += zero
        return cls(low, high, bad == 0.0)

    def merge(self, other: Extent) -> Extent:
        """Extent of both."""
        return Extent(np.minimum(self.low, other.low), np.maximum(self.high, other.high), self.finite & other.finite)

    def moves(self, channel: int) -> bool:
        """Whether a channel holds anything but zeros and NaN."""
        return bool(self.low[channel] < 0.0 or self.high[channel] > 0.0)

    def is_constant(self, channel: int) -> bool:
        """Whether a channel holds one value only."""
        return bool(self.low[channel] >= self.high[channel])

    def boxes(self, n_dof: int) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (v, s) of each storey, shape (n_dof, 2), where the channels are a, v, s, F of n DOFs."""
        low, high = (x[n_dof : 3 * n_dof].reshape(2, n_dof).T.copy() for x in (self.low, self.high))
        return low, high

    def is_whole(self, n_needed: int) -> bool:
        """Whether the first channels are finite, and each further one too or nothing but NaN."""
        empty = (self.low == np.inf) & (self.high == -np.inf)
        return bool(self.finite[:n_needed].all() and (self.finite | empty)[n_needed:].all())


def _shares(matrices: Sequence[np.ndarray]) -> Iterator[tuple[slice, np.ndarray]]:
    """Rows of the matrices, and where their columns stand among all."""
    at = 0
    for matrix in matrices:
        where = slice(at, at + matrix.shape[1])
        at = where.stop
        if matrix.size:
            rows = max(_SHARE // matrix.shape[1], 1)
            yield from ((where, matrix[start : start + rows]) for start in range(0, len(matrix), rows))


def _scanned(share: tuple[slice, np.ndarray]) -> tuple[slice, np.ndarray]:
    """Least and largest values and a sum of zeros, or of NaN where something is not finite."""
    where, matrix = share
    out = np.zeros((3, matrix.shape[1]))
    out[0], out[1] = np.inf, -np.inf
    _scan(matrix.dtype.name, "C" if matrix.flags.c_contiguous else "A")(np.asarray(matrix), out)
    return where, out


@cache
def _scan(kind: str, layout: Literal["C", "A"]) -> Callable[[np.ndarray, np.ndarray], None]:
    """Compiled pass, row after row; one machine-code version for each type, whoever owns the array."""
    from numba import from_dtype, types

    from ..laws.compiled import jit

    def extent_scan(x, out):
        whole = x.shape[0] - x.shape[0] % 4
        for t in range(0, whole, 4):
            for j in range(x.shape[1]):
                low, high, zero = out[0, j], out[1, j], out[2, j]
                for i in range(4):
                    y = x[t + i, j]
                    low = y if y < low else low
                    high = y if y > high else high
                    zero += y * 0.0
                out[0, j], out[1, j], out[2, j] = low, high, zero
        for t in range(whole, x.shape[0]):
            for j in range(x.shape[1]):
                y = x[t, j]
                out[0, j] = y if y < out[0, j] else out[0, j]
                out[1, j] = y if y > out[1, j] else out[1, j]
                out[2, j] += y * 0.0

    scan = jit(extent_scan)
    scan.compile(
        (types.Array(from_dtype(np.dtype(kind)), 2, layout, readonly=True), types.Array(types.float64, 2, "C"))
    )
    scan.disable_compile()
    return scan
