"""A problem on the pieces of a record, and the coefficients that are followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ...records.dataset import Dataset
from ..problem import Problem
from .courses import CourseFitter, ShapedFit
from .evidence import Search, search_for_changes
from .piece_sums import (
    EquationSums,
    Unknowns,
    deviance_of,
    equation_sums,
    weighted_products,
    weights_of,
)
from .pieces import Pieces
from .request import Place


@dataclass(frozen=True, eq=False)
class Followed:
    """A problem on the pieces of a record, and the coefficients that are followed."""

    problem: Problem
    data: Dataset
    pieces: Pieces
    places: tuple[Place, ...]

    @cached_property
    def unknowns(self) -> Unknowns:
        return Unknowns.of(self.problem)

    @cached_property
    def equations(self) -> list[EquationSums]:
        return equation_sums(self.problem, self.data, self.pieces.edges)

    @cached_property
    def tested(self) -> list[int]:
        """Numbers of the coefficients that are followed."""
        numbers = []
        for site, label in self.places:
            labels = self.problem.layout.labels(site)
            numbers.append(int(self.unknowns.of_site(site)[labels.index(label)]))
        return numbers

    @cached_property
    def fitter(self) -> CourseFitter:
        return fitter_of(self.equations, self.unknowns.count, self.pieces.middles)

    @cached_property
    def constant(self) -> ShapedFit:
        """All coefficients constant."""
        return self.fitter.constants(self.tested)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Rms of each followed column over the rms force of its site, per unit."""
        segment = self.data.segments[0]
        coefficients = self.constant.fit.over_time.mean(axis=0)
        sizes = np.zeros(self.unknowns.count)
        for number, (site, label) in zip(self.tested, self.places):
            columns = self.problem.layout.columns(
                site, segment.motion(site, segment.valid)
            )
            here = columns[:, self.problem.layout.labels(site).index(label)]
            force = columns @ coefficients[self.unknowns.of_site(site)]
            sizes[number] = np.sqrt(np.mean(here**2) / np.mean(force**2))
        return sizes

    def search(self, suspects: Sequence[int] | None = None) -> Search:
        """Coefficients that change, of all that are followed or of suspects."""
        tested = self.tested if suspects is None else suspects
        return search_for_changes(
            self.fitter, self.constant, tested, self.sizes, len(self.tested)
        )

    def masses(self, values: np.ndarray) -> np.ndarray:
        """Masses of all DOFs by the values of all unknowns, kg."""
        unknowns = self.unknowns
        masses = []
        for dof in range(1, unknowns.layout.n_dof + 1):
            mass = unknowns.known_masses.get(dof)
            if mass is None:
                mass = values[unknowns.of_mass(dof)]
            masses.append(float(mass))
        return np.array(masses)

    def error(self, shaped: ShapedFit) -> float:
        """What a fit leaves of all equations, percent of their right-hand sides."""
        residual = 0.0
        target = 0.0
        for equation in self.equations:
            residual += equation.residual(shaped.fit.over_time)
            target += equation.size
        return 100 * float(np.sqrt(residual / target)) if target else np.nan


def fitter_of(
    equations: Sequence[EquationSums], count: int, middles: np.ndarray
) -> CourseFitter:
    """Fits courses of so many unknowns to equations of motion."""

    def weighting(coefficients: np.ndarray) -> np.ndarray:
        weights = weights_of(equations, coefficients)
        return weighted_products(equations, weights, count)

    deviance = partial(deviance_of, equations)
    return CourseFitter(middles, count, weighting, deviance)
