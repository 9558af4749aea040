"""The region of the (v, s) plane that a site has visited."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..exceptions import ChannelError

_CELLS = 40
_MOST = 60_000  # samples at most; a cell beside a visited one counts as visited, see contains
_TOGETHER = 1024  # samples


@dataclass(frozen=True)
class VisitedRegion:
    """Occupied cells of a rectangle of the (v, s) plane.

    Attributes
    ----------
    low, high : tuple of (float, float)
        Corners (v, s) of the rectangle, m/s and m.
    cells : ndarray of shape (n_v, n_s), bool
        Which cells hold a sample.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    cells: np.ndarray

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
