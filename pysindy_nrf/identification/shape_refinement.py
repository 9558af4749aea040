"""Shape parameters of laws by instrumental variables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout, Layout
from ..chain.sites import Site
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, model_of, scales_of, solve
from ..equations.shape_search import ShapeSearch
from ..exceptions import IdentifiabilityError, LawError
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from .instrumental_variables import IVResult, instrumental_variables
from .problem import Problem

# On the scale of the search: logarithms, and shares of the range of what may be zero.
# Half the distance of the two shapes whose difference stands for a derivative, wide
# enough for laws with kinks:
HALF_SPAN = 0.2
MAX_STEP = 1.0
# A step that counts as rest:
SETTLED = 0.01
MAX_PASSES = 3


def refine_shapes(
    asked: Problem, problem: Problem, order: SolveOrder, data: Dataset, iv: IVResult
) -> tuple[Problem, IVResult]:
    """Estimate anew with other shape parameters, while their steps contract.

    Parameters
    ----------
    asked : Problem
        As declared, with the shape parameters that are free.
    problem : Problem
        With the values that least squares found.
    order : SolveOrder
    data : Dataset
    iv : IVResult
        Estimate with these values.

    Returns
    -------
    problem : Problem
    iv : IVResult
        With the values of the last pass that led to a settled estimate.
    """
    search = _search_of(asked, problem, data)
    if search is None:
        return problem, iv
    unit = np.where(search.scale.log, 1.0, search.high - search.low)
    u = search.scale.point(_values_of(problem, search))

    largest = MAX_STEP * unit
    for _ in range(MAX_PASSES):
        linearisation = _Linearisation(problem, search, u, HALF_SPAN * unit)
        try:
            step = linearisation.step(order, data, iv)
        except (IdentifiabilityError, LawError):
            break
        if not (np.abs(step) <= largest).all():
            break

        u = np.clip(u + step, search.low, search.high)
        largest = np.maximum(np.abs(step), SETTLED * unit)
        trial = problem.with_laws(search.trial(u).laws)
        start = model_of(trial.layout, iv.solution)
        try:
            refined = instrumental_variables(start, data, trial, order)
        except IdentifiabilityError:
            break
        if not refined.settled:
            break

        problem = trial
        iv = refined
        if (largest <= SETTLED * unit).all():
            break
    return problem, iv


def _search_of(asked: Problem, problem: Problem, data: Dataset) -> ShapeSearch | None:
    """Search of the free shape parameters; None if there are none.

    Lines of a spectrum and instants keep their values: other means find them better.
    """
    laws: dict[Site, list[ForceLaw]] = {}
    for site, declared in asked.laws.items():
        laws[site] = []
        for law, law_with_values in zip(declared, problem.laws[site]):
            by_other_means = any(p.is_frequency or p.instant for p in law.shapes)
            laws[site].append(law_with_values if by_other_means else law)

    layout = LawLayout(problem.chain, laws)
    if not any(law.free_shape for group in laws.values() for law in group):
        return None
    return ShapeSearch(layout, scales_of(data, problem.layout))


def _values_of(problem: Problem, search: ShapeSearch) -> np.ndarray:
    values = []
    for site, number, shape in search.free:
        values.append(problem.laws[site][number].shape[shape.name])
    return np.array(values)


@dataclass(frozen=True)
class _Linearisation:
    """Laws with their derivatives by the shape parameters, as differences of two laws.

    Attributes
    ----------
    problem : Problem
    search : ShapeSearch
    u : ndarray of shape (n_shapes,)
        Where derivatives are taken, on the scale of the search.
    half_span : ndarray of shape (n_shapes,)
        Distance of each of the two laws.
    """

    problem: Problem
    search: ShapeSearch
    u: np.ndarray
    half_span: np.ndarray

    def step(self, order: SolveOrder, data: Dataset, iv: IVResult) -> np.ndarray:
        """Gauss-Newton step of the shape parameters.

        Derivatives along the measured motion are columns, those along the free run
        instruments.
        """
        layout = self.problem.layout
        wide = LawLayout(self.problem.chain, self._laws_with_neighbours())
        changes = self._changes(iv.model.coefficients)
        widths = {site: change.shape[1] for site, change in changes.items()}
        narrow = Layout(self.problem.chain, widths)

        groups = [wide.group(group.dofs) for group in groups_of(layout, order)]
        known = self.problem.known_masses
        filters = self.problem.filters(data)
        total = pieces_of(data, wide, groups, filters, known, iv.runs).sum()

        combinations = {}
        for group in groups:
            n_more = 2 if len(group.dofs) == 1 else 1  # acceleration, right-hand side
            of_sites = [changes[site] for site in group.sites]
            of_motion = linalg.block_diag(*of_sites, np.eye(n_more))
            of_run = of_motion[:-1, :-1]
            combination = linalg.block_diag(of_motion, of_run)
            combinations[narrow.group(group.dofs)] = combination
        solution = solve(
            total.transformed(narrow, combinations).projected(), order, known
        )

        steps: dict[Site, Iterator[float]] = {}
        for site in layout.acting:
            steps[site] = iter(solution.coefficients[site][layout.counts[site] :])
        return np.array([next(steps[site]) for site, *_ in self.search.free])

    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Parameters above and below, (n_shapes, n_shapes): row k moves parameter k."""
        moves = np.diag(self.half_span)
        above = np.clip(self.u + moves, self.search.low, self.search.high)
        below = np.clip(self.u - moves, self.search.low, self.search.high)
        return above, below

    def _laws_with_neighbours(self) -> dict[Site, list[ForceLaw]]:
        """Laws of each site, and behind them those above and below each parameter."""
        laws = {site: list(group) for site, group in self.problem.laws.items()}
        for above, below, (site, number, _) in zip(*self._ends(), self.search.free):
            laws[site].append(self.search.trial(above).laws[site][number])
            laws[site].append(self.search.trial(below).laws[site][number])
        return laws

    def _changes(
        self, coefficients: Mapping[Site, np.ndarray]
    ) -> dict[Site, np.ndarray]:
        """From columns with neighbours to [columns | derivatives of the forces]."""
        layout = self.problem.layout
        parts = {site: [np.eye(layout.counts[site])] for site in layout.acting}

        above, below = self._ends()
        distance = np.diag(above - below)
        for k, (site, number, _) in enumerate(self.search.free):
            n_terms = [len(law.terms()) for law in self.problem.laws[site]]
            first = sum(n_terms[:number])
            of_law = coefficients[site][first : first + n_terms[number]]
            derivative = np.concatenate([of_law, -of_law]) / distance[k]
            parts[site].append(derivative[:, None])
        return {site: linalg.block_diag(*group) for site, group in parts.items()}
