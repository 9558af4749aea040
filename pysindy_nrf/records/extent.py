"""Range of channels: least and largest values, and which channels are finite."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from ..common.threads import in_threads

# Numbers that one thread scans before it takes the next ones: 8 MB of float64.
_NUMBERS_IN_SHARE = 2**20


@dataclass(frozen=True)
class Extent:
    """Least and largest value of channels, with NaN passed over.

    Attributes
    ----------
    low, high : ndarray of shape (n_channels,)
        Plus and minus infinity for a channel that is NaN throughout.
    finite : ndarray of bool, shape (n_channels,)
        Whether all values of a channel are finite.
    """

    low: np.ndarray
    high: np.ndarray
    finite: np.ndarray

    @classmethod
    def of_columns(cls, matrices: Sequence[np.ndarray]) -> Extent:
        """Extent of the columns of matrices, in the order of the matrices."""
        n_channels = sum(matrix.shape[1] for matrix in matrices)
        low = np.full(n_channels, np.inf)
        high = np.full(n_channels, -np.inf)
        bad = np.zeros(n_channels)

        for columns, scanned in in_threads(_scan_share, _shares(matrices)):
            low[columns] = np.minimum(low[columns], scanned[0])
            high[columns] = np.maximum(high[columns], scanned[1])
            bad[columns] += scanned[2]

        return cls(low, high, bad == 0.0)

    def merge(self, other: Extent) -> Extent:
        """Extent of both."""
        return Extent(
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
            self.finite & other.finite,
        )

    def moves(self, channel: int) -> bool:
        """Whether a channel has a value that is neither zero nor NaN."""
        return bool(self.low[channel] < 0.0 or self.high[channel] > 0.0)

    def boxes(self, n_dof: int) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (v, s) of each storey, shape (n_dof, 2).

        The channels are a, v, s and F of ``n_dof`` DOFs.
        """
        low = self.low[n_dof : 3 * n_dof].reshape(2, n_dof).T.copy()
        high = self.high[n_dof : 3 * n_dof].reshape(2, n_dof).T.copy()
        return low, high

    def is_complete(self, n_motions: int) -> bool:
        """Whether all motions are finite, and each force is finite or all NaN.

        The first ``n_motions`` channels are motions, the others forces.
        """
        unknown = (self.low == np.inf) & (self.high == -np.inf)
        forces_known = (self.finite | unknown)[n_motions:].all()
        return bool(self.finite[:n_motions].all() and forces_known)


def _shares(matrices: Sequence[np.ndarray]) -> Iterator[tuple[slice, np.ndarray]]:
    """Rows of the matrices, and the places of their columns among all columns."""
    first_column = 0
    for matrix in matrices:
        columns = slice(first_column, first_column + matrix.shape[1])
        first_column = columns.stop
        if not matrix.size:
            continue

        n_rows = max(_NUMBERS_IN_SHARE // matrix.shape[1], 1)
        for start in range(0, len(matrix), n_rows):
            yield columns, matrix[start : start + n_rows]


def _scan_share(share: tuple[slice, np.ndarray]) -> tuple[slice, np.ndarray]:
    """Least values, largest values, and zero or NaN where something is not finite."""
    columns, matrix = share
    out = np.zeros((3, matrix.shape[1]))
    out[0] = np.inf
    out[1] = -np.inf

    layout: Literal["C", "A"] = "C" if matrix.flags.c_contiguous else "A"
    _compiled_scan(matrix.dtype.name, layout)(np.asarray(matrix), out)
    return columns, out


@cache
def _compiled_scan(
    dtype: str, layout: Literal["C", "A"]
) -> Callable[[np.ndarray, np.ndarray], None]:
    """Compiled pass over rows: one version for each type, read-only arrays or not."""
    from numba import from_dtype, types

    from ..common.compiled import jit

    # four rows a step, so that the three results of a column stay in registers
    def extent_scan(x, out):
        n_by_four = x.shape[0] - x.shape[0] % 4
        for t in range(0, n_by_four, 4):
            for j in range(x.shape[1]):
                low, high, bad = out[0, j], out[1, j], out[2, j]
                for i in range(4):
                    y = x[t + i, j]
                    low = y if y < low else low
                    high = y if y > high else high
                    bad += y * 0.0
                out[0, j], out[1, j], out[2, j] = low, high, bad

        for t in range(n_by_four, x.shape[0]):
            for j in range(x.shape[1]):
                y = x[t, j]
                out[0, j] = y if y < out[0, j] else out[0, j]
                out[1, j] = y if y > out[1, j] else out[1, j]
                out[2, j] += y * 0.0

    scan = jit(extent_scan)
    matrix = types.Array(from_dtype(np.dtype(dtype)), 2, layout, readonly=True)
    scan.compile((matrix, types.Array(types.float64, 2, "C")))
    scan.disable_compile()
    return scan
