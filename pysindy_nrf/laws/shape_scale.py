"""The scale on which shape parameters are searched, wherever that is done."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .base import Scales, Shape


class ShapeScale:
    """Shape parameters in the coordinates of a search: logarithms where :class:`Shape` says so.

    A frequency goes up to the fastest that the records can tell: what excites a structure may be faster than it moves.

    Parameters
    ----------
    shapes : sequence of Shape
    scales : sequence of (float, float, float, (float, float))
        Rms drift (m), rms rate (m/s), longest record (s), first and last time (s) at the site of each.
    fastest : float
        Half the sampling rate, Hz; infinite without a clock, and frequencies then end where their law says.

    Attributes
    ----------
    log : ndarray of bool, shape (n_shapes,)
        Which are searched as logarithms.
    low, high : ndarray of shape (n_shapes,)
        Bounds of the search, in its coordinates.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> from pysindy_nrf.laws.shape_scale import ShapeScale
    >>> shapes = laws.Dahl.shapes + laws.HarmonicForce.shapes
    >>> scale = ShapeScale(shapes, [(0.001, 0.05, 20.0, (0.0, 20.0))] * len(shapes), fastest=500.0)
    >>> scale.values(scale.high).round(6).tolist()  # 1/m and Hz
    [3000000.0, 500.0]
    """

    def __init__(
        self, shapes: Sequence[Shape], scales: Sequence[Scales], fastest: float = np.inf
    ) -> None:
        bounds = np.array([p.bounds(*own) for p, own in zip(shapes, scales)], dtype=float).reshape(-1, 2)
        if np.isfinite(fastest):
            bounds[[p.is_frequency for p in shapes], 1] = fastest
        self.log = np.array([p.log for p in shapes], dtype=bool)
        self.low, self.high = (self.point(ends) for ends in bounds.T)

    def point(self, values: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Coordinates of the search at values of all shape parameters."""
        log = self.log[k]
        return np.where(log, np.log(np.where(log, values, 1.0)), values)

    def values(self, point: np.ndarray, k: int | slice = slice(None)) -> np.ndarray:
        """Shape parameters at a point of the search."""
        log = self.log[k]
        return np.where(log, np.exp(np.where(log, point, 0.0)), point)
