"""Shape parameters of a law without a value: where a search looks for them, and how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from ..chain.sites import Site
from ..laws.base import ForceLaw
from ..laws.shape import Shape, ShapeScale
from .folds import FOLDS
from .search_data import SearchData

# Error reduction, dB, of the laws at a point.
Objective = Callable[[tuple[ForceLaw, ...]], float]


@dataclass(frozen=True)
class AxesSettings:
    """Effort of a scan and of a refinement."""

    # Points of a scan along each axis, by the number of shape parameters.
    points_of_one: int = 9
    points_of_two: int = 5
    points_of_three: int = 4
    # Spacing of spectral lines, as a share.
    line_spacing: float = 0.002
    # Points tried about an instant, within so many spacings: the reduction is narrow
    # there, and flat where the instant is held out.
    instant_points: int = 31
    instant_reach: float = 1.5
    # Evaluations of a refinement for each shape parameter; after how many it ends if it
    # comes to less than asked.
    evaluations: int = 25
    first_evaluations: int = 8
    # Loss of the middle of the interval of an instant, dB, below which it is taken.
    loss_of_middle: float = 0.05


AXES = AxesSettings()
# A loss that no law has, dB.
LARGE_LOSS = 1e6


class ShapeAxes:
    """Shape parameters of a law that have no value, in the coordinates of a search.

    At several sites the law has the same point, in multiples of the motion of each.
    """

    def __init__(self, law: ForceLaw, data: SearchData, sites: Sequence[Site]) -> None:
        self.law = law
        self.data = data
        self.shapes: list[Shape] = [p for p in law.shapes if law.shape[p.name] is None]
        self.scales = []
        for site in sites:
            sizes = [data.scales(site)] * len(self.shapes)
            self.scales.append(ShapeScale(self.shapes, sizes, data.fastest))
        self.low = self.scales[0].low
        self.high = self.scales[0].high

    @property
    def is_frequency(self) -> bool:
        """Whether the only parameter is a frequency: lines of a residual are tried."""
        return len(self.shapes) == 1 and self.shapes[0].is_frequency

    @property
    def is_instant(self) -> bool:
        """Whether the only parameter is a time; it is dated to within a window."""
        return len(self.shapes) == 1 and self.shapes[0].instant

    @property
    def n_points(self) -> int:
        """Points of the scan along each axis."""
        if self.is_instant:
            return FOLDS.n_windows
        if len(self.shapes) < 2:
            return AXES.points_of_one
        return AXES.points_of_two if len(self.shapes) == 2 else AXES.points_of_three

    @property
    def spacing(self) -> np.ndarray:
        """Distance of the points of the scan along each axis."""
        return (self.high - self.low) / self.n_points

    def laws_at(self, point: np.ndarray) -> tuple[ForceLaw, ...]:
        """The laws at a point, one for each site."""
        point = np.clip(point, self.low, self.high)
        laws = []
        for scale in self.scales:
            values = scale.values(point - self.low + scale.low)
            shape = {p.name: float(x) for p, x in zip(self.shapes, values)}
            laws.append(self.law.with_values(shape=shape))
        return tuple(laws)

    def point_of(self, law: ForceLaw) -> np.ndarray:
        """The point at which a law stands at the first site."""
        values = [law.shape[p.name] for p in self.shapes]
        return self.scales[0].point(np.array(values, dtype=float))

    def grid(self, lines: Sequence[float] = ()) -> list[np.ndarray]:
        """Points of the scan; spectral lines, Hz, for a frequency.

        A third parameter starts at the lower end of its range, where its law is
        simplest.
        """
        if not self.shapes:
            return [np.zeros(0)]
        if self.is_frequency:
            points = self.scales[0].point(np.array(lines, dtype=float), 0)
            inside = (points >= self.low[0]) & (points <= self.high[0])
            return [np.array([u]) for u in points[inside]]

        middles = (np.arange(self.n_points) + 0.5) / self.n_points
        shares = [middles if k < 2 else np.zeros(1) for k in range(len(self.shapes))]
        extent = self.high - self.low
        return [self.low + np.array(p) * extent for p in product(*shares)]

    def refined(
        self,
        reduction: Objective,
        start: np.ndarray,
        reach: float,
        enough: float = -np.inf,
    ) -> np.ndarray:
        """The point of the largest reduction near a start.

        Parameters
        ----------
        reduction : callable
        start : ndarray of shape (n_shapes,)
        reach : float
            First step, as a share of the spacing of the scan.
        enough : float
            Error reduction, dB, below which the point is found roughly.
        """
        if not self.shapes:
            return start

        start = np.clip(start, self.low, self.high)
        spacing = self.spacing
        if self.is_frequency:
            spacing = np.full(1, AXES.line_spacing)
        if self.is_instant:
            start = self._best_instant(reduction, start)
            spacing = 0.1 * spacing

        best, largest = self._climb(reduction, start, reach * spacing, enough)
        if self.is_instant:
            middle = np.mean(self.dated(best), axis=0)
            if reduction(self.laws_at(middle)) >= largest - AXES.loss_of_middle:
                return middle
        return best

    def _best_instant(self, reduction: Objective, start: np.ndarray) -> np.ndarray:
        """The best of the points about an instant."""
        reach = AXES.instant_reach
        offsets = np.linspace(-reach, reach, AXES.instant_points)[:, None]
        near = np.clip(start + self.spacing * offsets, self.low, self.high)
        return max(near, key=lambda point: reduction(self.laws_at(point)))

    def _climb(
        self, reduction: Objective, start: np.ndarray, step: np.ndarray, enough: float
    ) -> tuple[np.ndarray, float]:
        """The point to which a simplex climbs, and its reduction."""
        n_first = AXES.first_evaluations * len(start)
        reductions: list[float] = []

        def loss(point: np.ndarray) -> float:
            if len(reductions) >= n_first and max(reductions) < enough:
                return LARGE_LOSS
            reductions.append(reduction(self.laws_at(point)))
            return -max(reductions[-1], -LARGE_LOSS)

        away = np.where(start + step > self.high, -step, step)
        options = {
            "initial_simplex": np.vstack([start, start + np.diag(away)]),
            "xatol": 1e-4,
            "fatol": 1e-4,
            "maxfev": AXES.evaluations * len(start),
        }
        best = minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=list(zip(self.low, self.high)),
            options=options,
        )
        return np.clip(best.x, self.low, self.high), -best.fun

    def dated(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends between which an instant lies.

        A window away, or two from a piece there that is not searched: the taper of the
        windows hides what is near it.
        """
        record = self.data.searched[0]
        segment = self.data.data.segments[record]
        times = np.asarray(segment.t)
        runs = self.data.runs_in_record(record)
        window = self.spacing

        for earlier, later in zip(runs[:-1], runs[1:]):
            low = self.scales[0].point(times[[earlier.stop]])
            high = self.scales[0].point(times[[later.start]])
            if low - window / 2 <= point <= high + window / 2:
                return low - 2 * window, high + 2 * window
        return point - window, point + window
