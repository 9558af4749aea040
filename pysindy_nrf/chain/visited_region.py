"""The region of the (v, s) plane that a storey has visited."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from ..exceptions import ChannelError

_CELLS = 40
# samples at most; a cell beside a visited one counts as visited, see contains
_MOST = 8_000


@dataclass(frozen=True)
class VisitedRegion:
    """Occupied cells of a rectangle of the (v, s) plane."""

    low: tuple[float, float]  # corners (v, s), m/s and m
    high: tuple[float, float]
    cells: np.ndarray  # (n_v, n_s): which hold a sample

    @classmethod
    def of(cls, v: np.ndarray, s: np.ndarray) -> VisitedRegion:
        """Region visited by samples."""
        low, high = (
            np.array([f(v), f(s)], dtype=float)[None] for f in (np.min, np.max)
        )
        return cls.of_storeys([(v[:, None], s[:, None])], low, high)[0]

    @classmethod
    def of_storeys(
        cls,
        pieces: Sequence[tuple[np.ndarray, np.ndarray]],
        low: np.ndarray,
        high: np.ndarray,
    ) -> list[VisitedRegion]:
        """Regions visited by the samples of several records, one for each storey."""
        step = max(1, -(-sum(len(v) for v, _ in pieces) // _MOST))
        cells = np.zeros((len(low), _CELLS, _CELLS), dtype=bool)
        span = high - low
        scale = np.where(span > 0, _CELLS / np.where(span > 0, span, 1.0), 0.0)
        for piece in pieces:
            places = (
                (x[::step] - low[:, k]) * scale[:, k] for k, x in enumerate(piece)
            )
            i, j = (np.clip(place, 0, _CELLS - 1).astype(int) for place in places)
            cells[np.arange(len(low)), i, j] = True
        return [
            cls(tuple(a), tuple(b), c)
            for a, b, c in zip(low.tolist(), high.tolist(), cells)
        ]

    def contains(self, v: Any, s: Any) -> np.ndarray:
        """Whether points lie in a visited cell, or next to one."""
        near = ndimage.binary_dilation(np.pad(self.cells, 1), np.ones((3, 3)))
        index, inside = [], np.ones(np.broadcast(v, s).shape, dtype=bool)
        for values, a, b, n in zip((v, s), self.low, self.high, self.cells.shape):
            values = np.broadcast_to(np.asarray(values, dtype=float), inside.shape)
            width = (b - a) / n or 1.0
            inside = inside & (values >= a - width) & (values <= b + width)
            index.append(
                np.clip(np.floor((values - a) / width).astype(int) + 1, 0, n + 1)
            )
        return inside & near[index[0], index[1]]

    def nearest(self, v: Any, s: Any) -> tuple[np.ndarray, np.ndarray]:
        """The middle of the visited cell nearest to each point, distances in shares of
        the rectangle.
        """
        low, span = np.array(self.low), np.array(self.high) - np.array(self.low)
        span[span == 0] = 1.0
        middles = (np.argwhere(self.cells) + 0.5) / np.array(self.cells.shape)
        points = (np.column_stack([np.ravel(v), np.ravel(s)]) - low) / span
        chosen = middles[
            ((points[:, None, :] - middles[None]) ** 2).sum(axis=2).argmin(axis=1)
        ]
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
        if (
            len(low) != 2
            or len(high) != 2
            or not np.isfinite([*low, *high]).all()
            or cells.ndim != 2
            or not cells.size
        ):
            raise ChannelError(
                "A visited region is not a rectangle of cells",
                "It needs 'low', 'high' and 'cells'.",
            )
        return cls(low, high, cells)
