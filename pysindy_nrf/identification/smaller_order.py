"""The smallest order of the power series that leaves as little as the one fitted."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout
from ..chain.sites import Site
from ..equations.chain_solve import solve
from ..equations.errors import pooled_error
from ..equations.normal_equations import NormalEquations
from ..exceptions import NRFError
from ..laws.power_series import PowerSeries, exponents_of
from .problem import Problem

# Share of the error that more terms must take off, and the error, percent, below which
# nothing is missing: those of the choice of an order (selection/one_se_rule.py).
LEAST_GAIN = 0.15
LEAST_ERROR = 0.02


@dataclass(frozen=True)
class SmallerOrder:
    """A lower degree that does as well.

    Attributes
    ----------
    degree : int
    error : float
        What its balances leave, percent.
    fitted : float
        What those of the fit leave, percent.
    """

    degree: int
    error: float
    fitted: float

    def __str__(self) -> str:
        return (
            f"degree={self.degree} does as well: its balances leave {self.error:.3g} %,"
            f" those of the fit {self.fitted:.3g} %."
        )


def smaller_order(
    problem: Problem, order: SolveOrder, sums: NormalEquations, error: float
) -> SmallerOrder | None:
    """The smallest degree that leaves as little, None if it is that of the fit.

    Parameters
    ----------
    problem : Problem
    order : SolveOrder
    sums : NormalEquations
        Of the entire series; no sample is read again. Those with instruments know no
        error of a fit.
    error : float
        What the balances of the fit leave, percent.
    """
    if sums.instrumented:
        return None
    limit = max(error / (1 - LEAST_GAIN), LEAST_ERROR)
    for degree in range(1, _highest(problem.layout)):
        lowered = _lowered(problem.layout, degree)
        cut = _of_lower_degree(sums, problem.layout, lowered)
        try:
            with warnings.catch_warnings(action="ignore"):
                solution = solve(cut, order, problem.known_masses)
        except NRFError:
            continue
        lowered_error = pooled_error(solution.masses, solution.coefficients, cut)
        if lowered_error <= limit:
            return SmallerOrder(degree, float(lowered_error), error)
    return None


def _highest(layout: LawLayout) -> int:
    """Highest degree of a power series of a layout."""
    return max((_degree_at(layout, site) for site in layout.acting), default=0)


def _degree_at(layout: LawLayout, site: Site) -> int:
    """Total degree of the power series at a site, 0 where the law is another."""
    laws = layout.laws[site]
    if len(laws) != 1 or type(laws[0]) is not PowerSeries:
        return 0
    degree = laws[0].degree
    return degree if isinstance(degree, int) else 0


def _lowered(layout: LawLayout, degree: int) -> LawLayout:
    """The laws with all power series above a degree at this degree."""
    laws = dict(layout.laws)
    for site in layout.acting:
        if _degree_at(layout, site) > degree:
            laws[site] = (PowerSeries(degree),)
    return LawLayout(layout.chain, laws)


def _of_lower_degree(
    sums: NormalEquations, layout: LawLayout, lowered: LawLayout
) -> NormalEquations:
    """The sums of the columns that a lower degree keeps."""
    terms = {}
    for site in layout.acting:
        terms[site] = np.arange(layout.counts[site])
        if lowered.counts[site] < layout.counts[site]:
            exponents = exponents_of(_degree_at(layout, site))
            remaining = exponents_of(_degree_at(lowered, site))
            terms[site] = np.array([exponents.index(pair) for pair in remaining])
    return sums.with_terms(lowered, terms)
