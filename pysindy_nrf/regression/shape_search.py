"""Shape parameters of laws by variable projection: coefficients eliminated on Gram matrices."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..exceptions import IdentifiabilityError, LawError, RankWarning
from ..laws.shape import Scales, Shape, ShapeScale
from ..mechanics.sites import Site
from .chain_solve import Solution
from .layout import LawLayout
from .segments import Segment, SegmentSet, half_the_rate
from .spectral_lines import balance_lines, driven_at

_SCAN = 13
# Part of the spacing 1/T of the frequencies that a record of T seconds tells apart within which a line is looked for,
# and with which the refinement begins.
_WITHIN, _STEP = 0.6, 0.1

Free = list[tuple[Site, int, Shape]]
Solve = Callable[[LawLayout], tuple[Any, Any]]


def estimate_shapes(
    layout: LawLayout,
    scales: Mapping[Site, Scales],
    solve: Solve,
    data: SegmentSet | None = None,
    filters: Sequence[Any] = (),
) -> LawLayout:
    """Values for every shape parameter that has none."""
    fastest = np.inf if data is None else half_the_rate(data.segments)
    search = _Search(layout, scales, solve, fastest)
    unheard = [place for place in search.free if search.heard(place)]
    for k in sorted(range(len(search.free)), key=lambda k: search.heard(search.free[k])):
        place = search.free[k]
        if data is not None and search.heard(place):
            lines = _lines(search.trial(search.u), unheard, place[0], solve, data, filters)
            unheard = [other for other in unheard if other is not place]
            if search.tune(k, lines, scales[place[0]][2]):
                continue
        search.scan(k, np.linspace(search.low[k], search.high[k], _SCAN))
    return search.refined()


class _Search:
    """The shape parameters without a value, and where their search stands.

    Attributes
    ----------
    free : list of (Site, int, Shape)
    scale : ShapeScale
        Their coordinates in the search.
    low, high, u, step : ndarray of shape (n_free,)
        Bounds, where the search stands, and the first step of the refinement.
    """

    def __init__(
        self,
        layout: LawLayout,
        scales: Mapping[Site, Scales],
        solve: Solve,
        fastest: float,
    ) -> None:
        self.layout, self.solve, self._fastest = layout, solve, fastest
        self.free: Free = [
            (site, i, p)
            for site, held in layout.laws.items()
            for i, law in enumerate(held)
            for p in law.shapes
            if law.shape[p.name] is None
        ]
        self.scale = ShapeScale([p for *_, p in self.free], [scales[site] for site, *_ in self.free], fastest)
        self.low, self.high = self.scale.low, self.scale.high
        self.u = 0.5 * (self.low + self.high)
        self.step = (self.high - self.low) / (_SCAN - 1)

    def heard(self, place: tuple[Site, int, Shape]) -> bool:
        """Whether a parameter is a frequency that is looked for in the records."""
        return bool(np.isfinite(self._fastest)) and place[2].is_frequency

    def trial(self, u: np.ndarray) -> LawLayout:
        """The laws with shape parameters at a point of the search."""
        return _with_shapes(self.layout, self.free, self.scale.values(np.clip(u, self.low, self.high)))

    def cost(self, u: np.ndarray) -> float:
        """Sum of the squared shares that the steps leave unexplained."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RankWarning)
                solution, _ = self.solve(self.trial(u))
        except (IdentifiabilityError, LawError):  # no answer for these values, e.g. a loop like a spring
            return np.inf
        return float(sum(fit.share**2 for fit in solution.fits))

    def at(self, k: int, value: float) -> np.ndarray:
        """Where the search stands, but for one parameter."""
        u = self.u.copy()
        u[k] = value
        return u

    def scan(self, k: int, points: np.ndarray) -> None:
        """Go to the best of some values of one parameter."""
        self.u[k] = points[int(np.argmin([self.cost(self.at(k, point)) for point in points]))]

    def tune(self, k: int, lines: Sequence[float], duration: float) -> bool:
        """Go to the best of some frequencies, Hz, and to the bottom of its valley; False if none is within bounds."""
        from scipy.optimize import minimize_scalar

        points = self.scale.point(np.array(lines, dtype=float), k)
        points = points[(points >= self.low[k]) & (points <= self.high[k])]
        if not len(points):
            return False
        self.scan(k, points)
        apart = 1.0 / duration / (self.scale.values(self.u)[k] if self.scale.log[k] else 1.0)
        ends = self.u[k] + _WITHIN * apart * np.array([-1.0, 1.0])
        best = minimize_scalar(
            lambda value: min(self.cost(self.at(k, value)), 1e6),
            bounds=ends, method="bounded", options={"xatol": 1e-3 * apart, "maxiter": 20},
        )  # fmt: skip
        if best.fun < self.cost(self.u):
            self.u[k] = best.x
        self.step[k] = _STEP * apart
        return True

    def refined(self) -> LawLayout:
        """All parameters refined together, from where the search stands."""
        from scipy.optimize import minimize

        away = np.where(self.u + 0.5 * self.step > self.high, -self.step, self.step)
        best = minimize(
            self.cost, self.u, method="Nelder-Mead", bounds=list(zip(self.low, self.high)),
            options={
                "initial_simplex": np.vstack([self.u, self.u + np.diag(0.5 * away)]),
                "xatol": 1e-10, "fatol": 1e-18, "maxfev": 120 * len(self.free),
            },
        )  # fmt: skip
        return self.trial(best.x)


def _with_shapes(layout: LawLayout, free: Free, values: np.ndarray) -> LawLayout:
    laws = {site: list(held) for site, held in layout.laws.items()}
    for (site, i, p), value in zip(free, values):
        laws[site][i] = laws[site][i].with_values(shape={p.name: float(value)})
    return LawLayout(layout.chain, laws)


# -- frequencies ----------------------------------------------------------------------------------


def _lines(
    layout: LawLayout, unheard: Free, site: Site, solve: Solve, data: SegmentSet, filters: Sequence[Any]
) -> list[float]:
    """Frequencies, Hz, that the balance at a site lacks without the laws whose frequency is not known yet."""
    known = [i for i, seg in enumerate(data.segments) if seg.dt and not np.isnan(seg.F[seg.valid.start, site.p - 1])]
    if not known:
        return []
    longest = max(known, key=lambda i: data.segments[i].valid.stop - data.segments[i].valid.start)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RankWarning)
            solution, _ = solve(layout)
    except (IdentifiabilityError, LawError):
        return []
    without, left = _without(layout, {(place, i) for place, i, _ in unheard}, solution)
    seg = data.segments[longest]
    rows = _rows(seg, without, filters[longest] if filters else None)
    return balance_lines(rows, without, left, site.p, seg.step, site.p in data.forced, False, driven_at(seg))


def _without(layout: LawLayout, out: set[tuple[Site, int]], solution: Solution) -> tuple[LawLayout, Solution]:
    """A layout and its solution without some laws: their coefficients are left out, the others stay what they are."""
    laws, coefficients = {}, {}
    for site, held in layout.laws.items():
        ends = np.cumsum([len(law.terms()) for law in held])[:-1]
        kept = [
            (law, part)
            for i, (law, part) in enumerate(zip(held, np.split(solution.coefficients[site], ends)))
            if (site, i) not in out
        ]
        laws[site] = tuple(law for law, _ in kept)
        coefficients[site] = np.concatenate([np.zeros(0), *(part for _, part in kept)])
    return LawLayout(layout.chain, laws), Solution(solution.masses, coefficients)


def _rows(seg: Segment, layout: LawLayout, filter: Any) -> np.ndarray:
    """Columns ``[terms | a | F]`` along one record; zero for a force that is not known."""
    states: dict | None = {} if filter is None else None
    blocks = [
        np.vstack([b.terms, b.acceleration, np.nan_to_num(b.force)])
        for b in seg.blocks(layout, filter=filter, states=states)
    ]
    return np.hstack(blocks)
