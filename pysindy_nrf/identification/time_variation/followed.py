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
    def _sums(self) -> tuple[Unknowns, list[EquationSums]]:
        return equation_sums(self.problem, self.data, self.pieces.edges)

    @property
    def unknowns(self) -> Unknowns:
        return self._sums[0]

    @property
    def equations(self) -> list[EquationSums]:
        return self._sums[1]

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
        count = self.unknowns.count

        def weighting(coefficients: np.ndarray) -> np.ndarray:
            weights = weights_of(self.equations, coefficients)
            return weighted_products(self.equations, weights, count)

        deviance = partial(deviance_of, self.equations)
        return CourseFitter(self.pieces.middles, count, weighting, deviance)

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

    def error(self, shaped: ShapedFit) -> float:
        """What a fit leaves of all equations, percent of their right-hand sides."""
        residual = 0.0
        target = 0.0
        for equation in self.equations:
            residual += equation.residual(shaped.fit.over_time)
            target += equation.size
        return 100 * float(np.sqrt(residual / target)) if target else np.nan
