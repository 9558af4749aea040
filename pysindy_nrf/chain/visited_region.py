"""The region of the (v, s) plane that a storey has visited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..exceptions import ChannelError

# Cells along each side of the rectangle.
CELLS = 40
# Samples that are looked at; a cell beside a visited one counts as visited, too.
MAX_SAMPLES = 8_000


class RegionData(TypedDict):
    """A visited region as plain data."""

    low: list[float]
    high: list[float]
    cells: list[str]


@dataclass(frozen=True)
class VisitedRegion:
    """Occupied cells of a rectangle of the (v, s) plane.

    Attributes
    ----------
    low, high : (float, float)
        Corners (v, s), m/s and m.
    cells : ndarray of bool, shape (n_v, n_s)
        Which cells a sample lies in.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    cells: np.ndarray

    @classmethod
    def of(cls, v: np.ndarray, s: np.ndarray) -> VisitedRegion:
        """Region visited by samples (n_samples,)."""
        low = np.array([[np.min(v), np.min(s)]], dtype=float)
        high = np.array([[np.max(v), np.max(s)]], dtype=float)
        return cls.of_storeys([(v[:, None], s[:, None])], low, high)[0]

    @classmethod
    def of_storeys(
        cls,
        pieces: Sequence[tuple[np.ndarray, np.ndarray]],
        low: np.ndarray,
        high: np.ndarray,
    ) -> list[VisitedRegion]:
        """Regions visited by rates and drifts of several records, one a storey.

        ``pieces`` are arrays (n_samples, n_storeys) of v and of s; ``low`` and ``high``
        are the corners (n_storeys, 2).
        """
        n_storeys = len(low)
        n_samples = sum(len(v) for v, _ in pieces)
        step = max(1, -(-n_samples // MAX_SAMPLES))
        span = high - low
        moves = span > 0
        scale = np.where(moves, CELLS / np.where(moves, span, 1.0), 0.0)

        cells = np.zeros((n_storeys, CELLS, CELLS), dtype=bool)
        for v, s in pieces:
            row = (v[::step] - low[:, 0]) * scale[:, 0]
            column = (s[::step] - low[:, 1]) * scale[:, 1]
            inside = np.clip([row, column], 0, CELLS - 1).astype(int)
            cells[np.arange(n_storeys), inside[0], inside[1]] = True

        corners = zip(low.tolist(), high.tolist(), cells)
        return [cls((a[0], a[1]), (b[0], b[1]), inside) for a, b, inside in corners]

    def contains(self, v: npt.ArrayLike, s: npt.ArrayLike) -> np.ndarray:
        """Whether points lie in a visited cell, or next to one."""
        points = np.stack(np.broadcast_arrays(*map(_as_float, (v, s))), axis=-1)
        low, high = np.array(self.low), np.array(self.high)
        count = np.array(self.cells.shape)
        width = (high - low) / count
        width[width == 0] = 1.0

        near = (points >= low - width) & (points <= high + width)
        # one empty cell around, so that a point beside the rectangle has one, too
        cell = np.floor((points - low) / width).astype(int) + 1
        cell = np.clip(cell, 0, count + 1)
        grown = ndimage.binary_dilation(np.pad(self.cells, 1), np.ones((3, 3)))
        return near.all(axis=-1) & grown[cell[..., 0], cell[..., 1]]

    def nearest(
        self, v: npt.ArrayLike, s: npt.ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """The middle of the visited cell nearest to each point.

        Distances are shares of the rectangle.
        """
        low = np.array(self.low)
        span = np.array(self.high) - low
        span[span == 0] = 1.0
        points = (np.column_stack([np.ravel(v), np.ravel(s)]) - low) / span

        middles = (np.argwhere(self.cells) + 0.5) / np.array(self.cells.shape)
        squares = ((points[:, None, :] - middles[None]) ** 2).sum(axis=2)
        v_near, s_near = (low + middles[squares.argmin(axis=1)] * span).T
        return v_near, s_near

    def to_dict(self) -> RegionData:
        """Plain data for JSON."""
        rows = []
        for row in self.cells:
            rows.append("".join(np.where(row, "x", ".")))
        return {"low": list(self.low), "high": list(self.high), "cells": rows}

    @classmethod
    def from_dict(cls, data: RegionData) -> VisitedRegion:
        """Region from plain data."""
        low = [float(x) for x in data["low"]]
        high = [float(x) for x in data["high"]]
        cells = np.array([[mark == "x" for mark in row] for row in data["cells"]])

        is_rectangle = len(low) == len(high) == 2 and np.isfinite(low + high).all()
        if not is_rectangle or cells.ndim != 2 or not cells.size:
            what = "A visited region is not a rectangle of cells"
            raise ChannelError(what, "It needs 'low', 'high' and 'cells'.")
        return cls((low[0], low[1]), (high[0], high[1]), cells)


def _as_float(values: npt.ArrayLike) -> np.ndarray:
    return np.asarray(values, dtype=float)
