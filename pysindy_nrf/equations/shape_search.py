"""Shape parameters of laws by variable projection.

Coefficients are eliminated on sums of products: a point of the search is one solve.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from ..chain.laws_by_site import coefficients_by_law
from ..chain.layout import LawLayout
from ..chain.sites import Site
from ..exceptions import IdentifiabilityError, LawError, RankWarning
from ..laws.base import ForceLaw
from ..laws.shape import Scales, Shape, ShapeScale
from ..records.dataset import Dataset, half_the_rate
from ..records.zero_phase_filter import ZeroPhaseFilter
from .balances import States, blocks_of_segment
from .solution import Solution
from .spectral_lines import (
    balance_lines,
    driven_at,
    driving_lines,
    spectral_lines,
)

__all__ = [
    "ShapeSearch",
    "balance_lines",
    "driven_at",
    "driving_lines",
    "estimate_shapes",
    "spectral_lines",
]

# Points of a scan over the bounds of a parameter.
N_SCANNED = 13
# Decades by which a range is widened, once, at whose end a search stops.
DECADES_MORE = 1.0
# Share of a range within which a point stands at its end.
AT_THE_END = 1e-3
# Parts of the spacing 1/T of the frequencies that a record of T seconds separates:
# within which a line is looked for, and with which the refinement begins.
WITHIN_LINE = 0.6
FIRST_STEP_AT_LINE = 0.1
# Iterations of the search within a line, and its tolerance in parts of the spacing.
MAX_LINE_STEPS = 20
LINE_TOLERANCE = 1e-3
# Cost of a point that has no solution, where a search needs a number.
WORST_COST = 1e6
# Solves of the joint refinement for each parameter.
MAX_SOLVES_PER_PARAMETER = 120

Free = list[tuple[Site, int, Shape]]
Solve = Callable[[LawLayout], tuple[Solution, object]]


def estimate_shapes(
    layout: LawLayout,
    scales: Mapping[Site, Scales],
    solve: Solve,
    data: Dataset,
    filters: Sequence[ZeroPhaseFilter | None],
) -> LawLayout:
    """Values for every shape parameter that has none.

    Parameters are scanned one after the other, then refined together. Frequencies come
    last: they are tried where the equation of motion lacks a line. Where the search
    stops at the end of a range of sizes, it goes on beyond it once.
    """
    fastest = half_the_rate(data.segments)
    search = ShapeSearch(layout, scales, solve, fastest)
    numbers = range(len(search.free))
    unheard = [search.free[k] for k in numbers if search.is_line(k)]

    for k in sorted(numbers, key=search.is_line):
        if search.is_line(k):
            site = search.free[k][0]
            trial = search.trial(search.u)
            lines = _lacking_lines(trial, unheard, site, solve, data, filters)
            unheard = [place for place in unheard if place is not search.free[k]]
            if search.tune(k, lines, duration=scales[site][2]):
                continue
        search.scan(k, np.linspace(search.low[k], search.high[k], N_SCANNED))
    search.refine()
    beyond = search.widen(search.u)
    for k in beyond:
        search.scan(k, np.linspace(search.low[k], search.high[k], N_SCANNED))
    if beyond:
        search.refine()
    return search.trial(search.u)


class ShapeSearch:
    """The shape parameters without a value, and the point that a search has reached.

    Parameters
    ----------
    layout : LawLayout
    scales : mapping of Site to Scales
    solve : callable, optional
        From a layout with values to its solution and normal equations.
    fastest : float
        Highest frequency, Hz, that the records show.

    Attributes
    ----------
    free : list of (Site, int, Shape)
        The parameters: site, number of the law there, parameter.
    u, low, high, step : ndarray
        The point, its bounds and first steps, in the coordinates of the search.
    """

    def __init__(
        self,
        layout: LawLayout,
        scales: Mapping[Site, Scales],
        solve: Solve | None = None,
        fastest: float = np.inf,
    ) -> None:
        self.layout = layout
        self.solve = solve
        self._fastest = fastest
        self.free: Free = []
        for site, group in layout.laws.items():
            for number, law in enumerate(group):
                for shape in law.shapes:
                    if law.shape[shape.name] is None:
                        self.free.append((site, number, shape))

        shapes = [shape for _, _, shape in self.free]
        sizes = [scales[site] for site, _, _ in self.free]
        self.scale = ShapeScale(shapes, sizes, fastest)
        self.low, self.high = self.scale.low, self.scale.high
        self.u = 0.5 * (self.low + self.high)
        self.step = (self.high - self.low) / (N_SCANNED - 1)

    def is_line(self, k: int) -> bool:
        """Whether a parameter is a frequency that is looked for in the records."""
        return bool(np.isfinite(self._fastest)) and self.free[k][2].is_frequency

    def at_end(self, u: np.ndarray) -> np.ndarray:
        """-1 or 1 for parameters at or beyond the lower or upper end, else 0."""
        near = AT_THE_END * (self.high - self.low)
        return (u >= self.high - near).astype(int) - (u <= self.low + near)

    def has_limit(self, k: int) -> bool:
        """Whether the range of a parameter is not one of sizes of the motion.

        Powers, ratios, instants and frequencies have limits beyond which laws or
        records have no meaning.
        """
        shape = self.free[k][2]
        return not shape.log or shape.scale == "1" or shape.is_frequency

    def widen(self, u: np.ndarray) -> list[int]:
        """Widen the ranges of sizes at whose ends a point stands; their numbers."""
        widened = []
        more = DECADES_MORE * np.log(10.0)
        for k, end in enumerate(self.at_end(u)):
            if not end or self.has_limit(k):
                continue
            if end < 0:
                self.low[k] -= more
            else:
                self.high[k] += more
            widened.append(k)
        return widened

    def trial(self, u: np.ndarray) -> LawLayout:
        """The laws with shape parameters at a point of the search."""
        laws = {site: list(group) for site, group in self.layout.laws.items()}
        values = self.scale.values(np.clip(u, self.low, self.high))
        for (site, number, shape), value in zip(self.free, values):
            law = laws[site][number]
            laws[site][number] = law.with_values(shape={shape.name: float(value)})
        return LawLayout(self.layout.chain, laws)

    def cost(self, u: np.ndarray) -> float:
        """Sum of the squared shares that the steps leave unexplained.

        Infinite where there is no solution, e.g. for a loop like a spring.
        """
        assert self.solve is not None
        try:
            with warnings.catch_warnings(action="ignore", category=RankWarning):
                solution, _ = self.solve(self.trial(u))
        except (IdentifiabilityError, LawError):
            return np.inf
        return float(sum(fit.share**2 for fit in solution.fits))

    def _cost_along(self, k: int, value: float) -> float:
        """The cost at the point reached, but for one parameter."""
        u = self.u.copy()
        u[k] = value
        return self.cost(u)

    def scan(self, k: int, points: np.ndarray) -> None:
        """Go to the best of some values of one parameter."""
        costs = [self._cost_along(k, point) for point in points]
        self.u[k] = points[int(np.argmin(costs))]

    def tune(self, k: int, lines: Sequence[float], duration: float) -> bool:
        """Go to the best of some frequencies, Hz, and to the bottom of its valley.

        False if none is within bounds.
        """
        points = self.scale.point(np.array(lines, dtype=float), k)
        points = points[(points >= self.low[k]) & (points <= self.high[k])]
        if not len(points):
            return False

        self.scan(k, points)
        spacing = 1.0 / duration
        if self.scale.log[k]:
            spacing /= self.scale.values(self.u)[k]
        ends = self.u[k] + WITHIN_LINE * spacing * np.array([-1.0, 1.0])

        def cost(value: float) -> float:
            return min(self._cost_along(k, value), WORST_COST)

        options = {"xatol": LINE_TOLERANCE * spacing, "maxiter": MAX_LINE_STEPS}
        best = minimize_scalar(cost, bounds=ends, method="bounded", options=options)
        if best.fun < self.cost(self.u):
            self.u[k] = best.x
        self.step[k] = FIRST_STEP_AT_LINE * spacing
        return True

    def refine(self) -> None:
        """Go to the best point near the one reached, all parameters together."""
        near_end = self.u + 0.5 * self.step > self.high
        away = np.where(near_end, -self.step, self.step)
        simplex = np.vstack([self.u, self.u + np.diag(0.5 * away)])
        best = minimize(
            self.cost,
            self.u,
            method="Nelder-Mead",
            bounds=list(zip(self.low, self.high)),
            options={
                "initial_simplex": simplex,
                "xatol": 1e-10,
                "fatol": 1e-18,
                "maxfev": MAX_SOLVES_PER_PARAMETER * len(self.free),
            },
        )
        self.u = np.clip(best.x, self.low, self.high)


def _lacking_lines(
    layout: LawLayout,
    unheard: Free,
    site: Site,
    solve: Solve,
    data: Dataset,
    filters: Sequence[ZeroPhaseFilter | None],
) -> list[float]:
    """Frequencies, Hz, that the equation of motion at a site lacks.

    It is solved with all laws; those whose frequency is not known yet are then left
    out, and the others stay what they are.
    """
    longest = _longest_record(data, site.p)
    if longest is None:
        return []
    try:
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            solution, _ = solve(layout)
    except (IdentifiabilityError, LawError):
        return []

    without, rest = _without_laws(layout, solution, unheard)
    segment, filter = data.segments[longest], filters[longest]
    states: States | None = {} if filter is None else None
    rows = []
    for block in blocks_of_segment(segment, without, filter=filter, states=states):
        force = np.nan_to_num(block.force)
        rows.append(np.vstack([block.terms, block.acceleration, force]))
    return balance_lines(
        np.hstack(rows),
        without,
        rest,
        site.p,
        segment.step,
        scaled=site.p in data.forced,
        weighed=False,
        driven=driven_at(segment),
    )


def _longest_record(data: Dataset, dof: int) -> int | None:
    """The longest record with a clock and the force on a DOF, if there is one."""
    longest = None
    n_samples = 0
    for i, segment in enumerate(data.segments):
        unknown = np.isnan(segment.F[segment.valid.start, dof - 1])
        if segment.dt and not unknown and segment.n_valid > n_samples:
            longest = i
            n_samples = segment.n_valid
    return longest


def _without_laws(
    layout: LawLayout, solution: Solution, left_out: Free
) -> tuple[LawLayout, Solution]:
    """The layout without some laws, and the coefficients of the others."""
    gone = {(site, number) for site, number, _ in left_out}
    laws: dict[Site, list[ForceLaw]] = {}
    coefficients: dict[Site, np.ndarray] = {}
    for site, group in layout.laws.items():
        by_law = coefficients_by_law(group, solution.coefficients[site])
        laws[site] = []
        coefficients[site] = np.zeros(0)
        for number, (law, values) in enumerate(zip(group, by_law)):
            if (site, number) not in gone:
                laws[site].append(law)
                coefficients[site] = np.append(coefficients[site], values)
    rest = Solution(solution.masses, coefficients)
    return LawLayout(layout.chain, laws), rest
