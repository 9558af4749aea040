"""Free shape parameters as further columns of the equations of motion.

Near an estimate a force is linear in a shape parameter, too: its derivative by the
parameter is one more column, and the step of the parameter its coefficient. Shape
parameters and coefficients are then estimated together, in one linear solve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from ..chain.identifiability import SolveOrder
from ..chain.laws_by_site import with_coefficients
from ..chain.layout import Group, LawLayout, Layout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.accumulation import Whitener, pieces_of
from ..equations.chain_solve import Solution, groups_of, scales_of
from ..equations.normal_equations import NormalEquations
from ..equations.shape_search import FIRST_STEP_AT_LINE, ShapeSearch
from ..laws.base import ForceLaw
from ..records.dataset import Dataset, Segment, half_the_rate
from .problem import Problem

# Half the distance of the two shapes whose difference stands for a derivative, on the
# scale of the search: a logarithm, or a share of the range of what may be zero. Ten
# times as much bends the power n of a Bouc-Wen loop so far that alpha ends 16 % off.
HALF_SPAN = 0.02


def shape_derivatives(
    declared: Problem, problem: Problem, data: Dataset, with_lines: bool = False
) -> ShapeDerivatives | None:
    """Derivatives by the shape parameters that were free; None if there are none.

    Instants have no derivative, since forces jump there.

    Parameters
    ----------
    declared : Problem
        With the shape parameters that are free.
    problem : Problem
        The same with values.
    data : Dataset
    with_lines : bool
        Whether frequencies are among them.
    """
    laws = _laws_with_derivatives(declared, problem, with_lines)
    if not any(law.free_shape for group in laws.values() for law in group):
        return None
    scales = scales_of(data, problem.layout)
    fastest = half_the_rate(data.segments)
    search = ShapeSearch(LawLayout(problem.chain, laws), scales, fastest=fastest)
    u = search.scale.point(_values_of(problem, search))
    search.widen(u)

    half_span = HALF_SPAN * np.where(search.scale.log, 1.0, search.high - search.low)
    for k, (site, _, shape) in enumerate(search.free):
        if shape.is_frequency:
            half_span[k] = FIRST_STEP_AT_LINE / scales[site][2]
            if search.scale.log[k]:
                half_span[k] /= search.scale.values(u)[k]
    numbers = tuple(range(len(search.free)))
    return ShapeDerivatives(problem, search, u, half_span, numbers)


def _laws_with_derivatives(
    declared: Problem, problem: Problem, with_lines: bool
) -> dict[Site, list[ForceLaw]]:
    """The declared laws; those without a derivative keep the values of the problem."""
    laws: dict[Site, list[ForceLaw]] = {}
    for site, group in declared.laws.items():
        laws[site] = []
        for law, law_with_values in zip(group, problem.laws[site]):
            has_derivative = not any(
                shape.instant or (shape.is_frequency and not with_lines)
                for shape in law.shapes
            )
            laws[site].append(law if has_derivative else law_with_values)
    return laws


def shapes_of_motion(declared: Problem | None) -> list[str]:
    """Free shape parameters of the motion, with their sites; not those of a clock.

    Parameters
    ----------
    declared : Problem, optional
    """
    if declared is None:
        return []
    names = []
    for site, group in declared.laws.items():
        for law in group:
            for shape in law.shapes:
                of_clock = shape.instant or shape.is_frequency
                if law.shape[shape.name] is None and not of_clock:
                    names.append(f"{shape.name} in {site}")
    return names


def _values_of(problem: Problem, search: ShapeSearch) -> np.ndarray:
    values = []
    for site, number, shape in search.free:
        values.append(problem.laws[site][number].shape[shape.name])
    return np.array(values, dtype=float)


class _LayoutWithDerivatives(Layout):
    """The columns of the laws of each site, and behind them derivatives."""

    def __init__(self, laws: LawLayout, names: Mapping[Site, Sequence[str]]) -> None:
        widths = {}
        for site in laws.sites:
            widths[site] = laws.counts[site] + len(names.get(site, ()))
        super().__init__(laws.chain, widths)
        self._laws = laws
        self._names = names

    def labels(self, site: str) -> list[str]:
        """Labels of the terms at a site, and names of its shape parameters."""
        return [*self._laws.labels(site), *self._names.get(Site(site), ())]


@dataclass(frozen=True, eq=False)
class ShapeDerivatives:
    """Laws with derivatives of their forces, as differences of two laws.

    Attributes
    ----------
    problem : Problem
        With values for all shape parameters.
    search : ShapeSearch
        The free ones, and their ranges.
    u : ndarray of shape (n_shapes,)
        Where derivatives are taken, on the scale of the search.
    half_span : ndarray of shape (n_shapes,)
        Distance of each of the two laws.
    numbers : tuple of int
        The parameters that have a column.
    """

    problem: Problem
    search: ShapeSearch
    u: np.ndarray
    half_span: np.ndarray
    numbers: tuple[int, ...]

    def without(self, numbers: Sequence[int]) -> ShapeDerivatives:
        """The same, in which some parameters keep their values."""
        rest = tuple(k for k in self.numbers if k not in numbers)
        return replace(self, numbers=rest)

    def columns_without(self, site: Site, numbers: Sequence[int]) -> list[int]:
        """Columns of a site but those of some parameters."""
        n_terms = self.problem.layout.counts[site]
        of_site = [k for k in self.numbers if self.search.free[k][0] == site]
        derivatives = [i for i, k in enumerate(of_site) if k not in numbers]
        return [*range(n_terms), *(n_terms + i for i in derivatives)]

    @property
    def layout(self) -> Layout:
        """Columns of the laws of each site, and behind them the derivatives."""
        names: dict[Site, list[str]] = {}
        for k in self.numbers:
            site, _, shape = self.search.free[k]
            names.setdefault(site, []).append(shape.name)
        return _LayoutWithDerivatives(self.problem.layout, names)

    def pieces(
        self,
        order: SolveOrder,
        data: Dataset,
        coefficients: Mapping[Site, np.ndarray],
        runs: Sequence[Segment | None] | None = None,
        whiteners: Mapping[tuple[int, ...], Whitener] | None = None,
    ) -> NormalEquations:
        """Sums of products of the columns of the laws and the derivatives.

        Parameters
        ----------
        order : SolveOrder
        data : Dataset
        coefficients : mapping of Site to ndarray
            Of the laws whose derivatives are taken.
        runs : sequence of Segment or None, optional
            Motions by record whose columns are the instruments.
        whiteners : mapping of tuple of int to Whitener, optional
            By equation.
        """
        chain = self.problem.chain
        neighbours = LawLayout(chain, self._laws_with_neighbours())
        groups = [
            neighbours.group(group.dofs)
            for group in groups_of(self.problem.layout, order)
        ]
        pieces = pieces_of(
            data,
            neighbours,
            groups,
            self.problem.filters(data),
            self.problem.known_masses,
            runs,
            whiteners=whiteners,
        )
        layout = self.layout
        changes = self._changes(coefficients)
        combinations = {}
        for group in groups:
            change = _change_of(group, changes, pieces.instrumented)
            combinations[layout.group(group.dofs)] = change
        return pieces.transformed(layout, combinations)

    def steps(self, solution: Solution) -> np.ndarray:
        """Steps of all parameters, on the scale of the search.

        Zero for those that keep their values.
        """
        counts = self.problem.layout.counts
        of_site = {}
        for site, values in solution.coefficients.items():
            of_site[site] = list(values[counts[site] :])
        steps = np.zeros(len(self.u))
        for k in self.numbers:
            steps[k] = of_site[self.search.free[k][0]].pop(0)
        return steps

    def model(self, solution: Solution) -> ChainModel:
        """The model that a solution describes, its shape parameters included."""
        counts = self.problem.layout.counts
        coefficients = {}
        for site, values in solution.coefficients.items():
            coefficients[site] = values[: counts[site]]
        laws = dict(self.problem.laws)
        laws |= self.search.trial(self.u + self.steps(solution)).laws
        dofs = range(1, self.problem.chain.n_dof + 1)
        masses = np.array([solution.masses[j] for j in dofs], dtype=float)
        valued = with_coefficients(laws, coefficients)
        return ChainModel(masses, valued, self.problem.chain)

    def _laws_with_neighbours(self) -> dict[Site, list[ForceLaw]]:
        """Laws of each site, and behind them those above and below each parameter."""
        laws = {site: list(group) for site, group in self.problem.laws.items()}
        for k in self.numbers:
            site, number, _ = self.search.free[k]
            for end in self._ends(k):
                point = self.u.copy()
                point[k] = end
                laws[site].append(self.search.trial(point).laws[site][number])
        return laws

    def _ends(self, k: int) -> tuple[float, float]:
        """A parameter above and below its value, within its range."""
        low, high = self.search.low[k], self.search.high[k]
        above = min(self.u[k] + self.half_span[k], high)
        below = max(self.u[k] - self.half_span[k], low)
        return float(above), float(below)

    def _changes(
        self, coefficients: Mapping[Site, np.ndarray]
    ) -> dict[Site, np.ndarray]:
        """From columns with neighbours to [columns | derivatives of the forces]."""
        layout = self.problem.layout
        parts = {site: [np.eye(layout.counts[site])] for site in layout.acting}
        for k in self.numbers:
            site, number, _ = self.search.free[k]
            above, below = self._ends(k)
            n_terms = [len(law.terms()) for law in self.problem.laws[site]]
            first = sum(n_terms[:number])
            of_law = coefficients[site][first : first + n_terms[number]]
            derivative = np.concatenate([of_law, -of_law]) / (above - below)
            parts[site].append(derivative[:, None])
        return {site: linalg.block_diag(*group) for site, group in parts.items()}


def _change_of(
    group: Group, changes: Mapping[Site, np.ndarray], instrumented: bool
) -> np.ndarray:
    """Change of the columns of one equation, and of its instruments."""
    n_more = 2 if len(group.dofs) == 1 else 1  # acceleration, right-hand side
    of_sites = [changes[site] for site in group.sites]
    of_motion = linalg.block_diag(*of_sites, np.eye(n_more))
    if not instrumented:
        return of_motion
    return linalg.block_diag(of_motion, of_motion[:-1, :-1])
