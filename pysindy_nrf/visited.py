"""The region of the (v, s) plane that a site has visited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from .exceptions import ChannelError

_CELLS = 40
_MOST = 200_000


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
        """Region visited by samples.

        Parameters
        ----------
        v, s : ndarray of shape (n_samples,)

        Returns
        -------
        VisitedRegion
        """
        return cls.of_pieces([(v, s)], (float(v.min()), float(s.min())), (float(v.max()), float(s.max())))

    @classmethod
    def of_pieces(
        cls, pieces: Sequence[tuple[np.ndarray, np.ndarray]], low: tuple[float, float], high: tuple[float, float]
    ) -> VisitedRegion:
        """Region visited by the samples of several records.

        Parameters
        ----------
        pieces : sequence of (ndarray, ndarray)
            v and s of each.
        low, high : tuple of (float, float)
            Corners (v, s) of the rectangle, m/s and m.

        Returns
        -------
        VisitedRegion
        """
        step = max(1, sum(len(v) for v, _ in pieces) // _MOST)
        cells = np.zeros((_CELLS, _CELLS), dtype=bool)
        for v, s in pieces:
            scale = [_CELLS / (b - a) if b > a else 0.0 for a, b in zip(low, high)]
            _marker()(*(np.asarray(x[::step], dtype=np.float64) for x in (v, s)), *low, *scale, cells)
        return cls(low, high, cells)

    def contains(self, v: Any, s: Any) -> np.ndarray:
        """Whether points lie in a visited cell, or next to one.

        Parameters
        ----------
        v, s : array-like

        Returns
        -------
        ndarray of bool
        """
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
        """The middle of the visited cell nearest to each point, distances in shares of the rectangle.

        Parameters
        ----------
        v, s : array-like of shape (n_points,)

        Returns
        -------
        v, s : ndarray of shape (n_points,)
        """
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
def _marker():
    """Compiled: mark the cells that samples fall into."""
    from numba import types

    from .laws.compiled import jit

    def mark_cells(v, s, v_low, s_low, v_scale, s_scale, cells):
        most_v, most_s = cells.shape[0] - 1, cells.shape[1] - 1
        for t in range(v.size):
            i, j = int((v[t] - v_low) * v_scale), int((s[t] - s_low) * s_scale)
            cells[min(max(i, 0), most_v), min(max(j, 0), most_s)] = True

    line = types.Array(types.float64, 1, "A", readonly=True)
    marker = jit(mark_cells)
    marker.compile((line, line, *[types.float64] * 4, types.Array(types.boolean, 2, "C")))
    marker.disable_compile()
    return marker
