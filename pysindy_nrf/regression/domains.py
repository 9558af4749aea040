"""The range of every channel and the part of the phase plane that a motion visits, in one pass over the samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np

from ..common.threads import in_threads
from ..exceptions import ChannelError

_SHARE = 2**20  # numbers that a thread scans at once


@dataclass(frozen=True)
class Extent:
    """Least and largest value of channels, NaN passed over, and which of them are finite throughout."""

    low: np.ndarray  # +inf for a channel of NaN
    high: np.ndarray  # -inf for a channel of NaN
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


_CELLS = 40
_MOST = 60_000  # samples at most; a cell beside a visited one counts as visited, see contains
_TOGETHER = 1024  # samples


@dataclass(frozen=True)
class VisitedRegion:
    """Occupied cells of a rectangle of the (v, s) plane."""

    low: tuple[float, float]  # corners (v, s), m/s and m
    high: tuple[float, float]
    cells: np.ndarray  # (n_v, n_s): which hold a sample

    @classmethod
    def of(cls, v: np.ndarray, s: np.ndarray) -> VisitedRegion:
        """Region visited by samples."""
        low, high = (np.array([f(v), f(s)], dtype=float)[None] for f in (np.min, np.max))
        return cls.of_storeys([(v[:, None], s[:, None])], low, high)[0]

    @classmethod
    def of_storeys(
        cls, pieces: Sequence[tuple[np.ndarray, np.ndarray]], low: np.ndarray, high: np.ndarray
    ) -> list[VisitedRegion]:
        """Regions visited by the samples of several records, one for each storey."""
        step = max(1, sum(len(v) for v, _ in pieces) // _MOST)
        cells = np.zeros((len(low), _CELLS, _CELLS), dtype=bool)
        span = high - low
        scale = np.where(span > 0, _CELLS / np.where(span > 0, span, 1.0), 0.0)
        for v, s in pieces:
            kind = np.float32 if v.dtype == s.dtype == np.float32 else np.float64
            mark = _marker(np.dtype(kind).name)
            if step == 1:
                mark(*(np.asarray(x, dtype=kind) for x in (v, s)), low, scale, cells)
                continue
            for start in range(0, len(v), _TOGETHER * step):  # gathered first: memory is slow for one at a time
                rows = slice(start, start + _TOGETHER * step, step)
                mark(*(np.ascontiguousarray(x[rows], dtype=kind) for x in (v, s)), low, scale, cells)
        return [cls(tuple(a), tuple(b), c) for a, b, c in zip(low.tolist(), high.tolist(), cells)]

    def contains(self, v: Any, s: Any) -> np.ndarray:
        """Whether points lie in a visited cell, or next to one."""
        near = np.zeros(tuple(n + 2 for n in self.cells.shape), dtype=bool)
        for i in range(3):
            for j in range(3):
                near[i : i + self.cells.shape[0], j : j + self.cells.shape[1]] |= self.cells
        index, inside = [], np.ones(np.broadcast(v, s).shape, dtype=bool)
        for values, a, b, n in zip((v, s), self.low, self.high, self.cells.shape):
            values = np.broadcast_to(np.asarray(values, dtype=float), inside.shape)
            width = (b - a) / n or 1.0
            inside = inside & (values >= a - width) & (values <= b + width)
            index.append(np.clip(np.floor((values - a) / width).astype(int) + 1, 0, n + 1))
        return inside & near[index[0], index[1]]

    def nearest(self, v: Any, s: Any) -> tuple[np.ndarray, np.ndarray]:
        """The middle of the visited cell nearest to each point, distances in shares of the rectangle."""
        low, span = np.array(self.low), np.array(self.high) - np.array(self.low)
        span[span == 0] = 1.0
        middles = (np.argwhere(self.cells) + 0.5) / np.array(self.cells.shape)
        points = (np.column_stack([np.ravel(v), np.ravel(s)]) - low) / span
        chosen = middles[((points[:, None, :] - middles[None]) ** 2).sum(axis=2).argmin(axis=1)]
        v_near, s_near = (low + chosen * span).T
        return v_near, s_near

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "low": list(self.low),
            "high": list(self.high),
            "cells": ["".join("x" if c else "." for c in row) for row in self.cells],
        }

    @classmethod
    def from_dict(cls, data: Any) -> VisitedRegion:
        """Region from plain data."""
        low, high = (tuple(float(x) for x in data[key]) for key in ("low", "high"))
        cells = np.array([[c == "x" for c in row] for row in data["cells"]])
        if len(low) != 2 or len(high) != 2 or not np.isfinite([*low, *high]).all() or cells.ndim != 2 or not cells.size:
            raise ChannelError("A visited region is not a rectangle of cells", "It needs 'low', 'high' and 'cells'.")
        return cls(low, high, cells)


@cache
def _marker(kind: str) -> Callable[..., None]:
    """Compiled: mark the cells that samples fall into, row after row."""
    from numba import from_dtype, types

    from ..laws.compiled import jit

    def mark_cells(v, s, low, scale, cells):
        most_v, most_s = cells.shape[1] - 1, cells.shape[2] - 1
        for t in range(v.shape[0]):
            for k in range(v.shape[1]):
                i = int((v[t, k] - low[k, 0]) * scale[k, 0])
                j = int((s[t, k] - low[k, 1]) * scale[k, 1])
                cells[k, min(max(i, 0), most_v), min(max(j, 0), most_s)] = True

    lines = types.Array(from_dtype(np.dtype(kind)), 2, "A", readonly=True)
    corners = types.Array(types.float64, 2, "C")
    marker = jit(mark_cells)
    marker.compile((lines, lines, corners, corners, types.Array(types.boolean, 3, "C")))
    marker.disable_compile()
    return marker
