"""The region of the (v, s) plane that a site has visited."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

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
        low = (float(v.min()), float(s.min()))
        high = (float(v.max()), float(s.max()))
        step = max(1, len(v) // _MOST)
        edges = [np.linspace(a, b if b > a else a + 1e-300, _CELLS + 1) for a, b in zip(low, high)]
        counts = np.histogram2d(v[::step], s[::step], bins=edges)[0]
        return cls(low, high, counts > 0)

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
        return cls(
            tuple(data["low"]), tuple(data["high"]), np.array([[c == "x" for c in row] for row in data["cells"]])
        )
