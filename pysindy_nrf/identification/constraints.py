r"""Estimates that obey what is known of the parameters.

The estimate is replaced by the nearest one that obeys, in the metric of its covariance
P (minimum distance): :math:`\min_\theta (\theta - \hat\theta)^T P^{-1} (\theta -
\hat\theta)` where :math:`A \theta = b` and :math:`l \le \theta \le u`. No balance is
solved jointly with another. A warning is raised if the data contradict the knowledge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import linalg, optimize, stats

from ..chain.layout import with_coefficients
from ..chain.model import ChainModel
from ..common.warn import warn_user
from ..exceptions import BiasWarning, ChainError
from .intervals import Resolver, parameters_of
from .parameters import Known, LinearEquations, bounds_of, in_words, linear_equations

# Probability under which data and knowledge are called contradictory.
_UNLIKELY = 1e-3
# And the smallest gap, as a share of the terms, that is worth a warning.
_NOTICED = 1e-4
# Weight of the equations in units of the metric, the root of round-off: with larger
# ones the metric is lost, with smaller ones the equations.
_WEIGHT_OF_EQUATIONS = 1e7
# Standard errors from a bound within which a parameter lies on it.
_ON_A_BOUND = 1e-9
# Gap of the equations, as a share, that the search may leave.
_GAP_LEFT = 1e-6
# Round-off of a parameter, as a share: the smallest standard error of the metric.
_ROUND_OFF = 1e-9


@dataclass(frozen=True)
class Projection:
    """Turns a model into the nearest one that obeys."""

    known_masses: dict[int, float]
    names: list[str]
    covariance: np.ndarray
    equations: LinearEquations
    lower: np.ndarray
    upper: np.ndarray

    def __call__(self, model: ChainModel) -> ChainModel:
        """The nearest model that obeys."""
        theta = parameters_of(model, self.known_masses).to_numpy()
        nearest = pd.Series(self.nearest(theta), index=self.names)

        masses = [
            nearest.get(f"m{j}", mass) for j, mass in enumerate(model.masses, start=1)
        ]
        values = {}
        for site, force in model.restoring_forces.items():
            if force.laws:
                terms = [f"{site}: {term}" for term in force.coefficients.index]
                values[site] = nearest[terms].to_numpy()
        laws = with_coefficients(model.laws, values)
        return ChainModel(masses, laws, model.chain, model.visited, model.info)

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Nearest parameters, in the metric of the covariance."""
        scale = np.sqrt(np.diag(self.covariance))
        root = linalg.cholesky(
            self.covariance / scale[:, None] / scale, lower=True, check_finite=False
        )
        factors = self.equations.factors * scale
        gap = self.equations.values - self.equations.factors @ theta
        length = np.linalg.norm(factors, axis=1)
        factors = factors / length[:, None]
        gap = gap / length

        # steps in standard errors; equations are rows so heavy that nothing moves them
        metric = linalg.solve_triangular(root, np.eye(len(theta)), lower=True)
        rows = np.vstack([metric, _WEIGHT_OF_EQUATIONS * factors])
        target = np.append(np.zeros(len(theta)), _WEIGHT_OF_EQUATIONS * gap)
        bounds = (self.lower - theta) / scale, (self.upper - theta) / scale
        step = optimize.lsq_linear(rows, target, bounds, method="bvls").x

        remaining = np.abs(factors @ step - gap).max(initial=0.0)
        if remaining > _GAP_LEFT * max(np.abs(gap).max(initial=0.0), 1.0):
            raise ChainError("The constraints contradict each other", "Leave one out.")
        point = theta + scale * step
        point = np.where(point < self.lower + _ON_A_BOUND * scale, self.lower, point)
        return np.where(point > self.upper - _ON_A_BOUND * scale, self.upper, point)


def constrained(
    model: ChainModel, known: Known, resolver: Resolver
) -> tuple[ChainModel, Callable[[ChainModel], ChainModel]]:
    """The nearest model that obeys, and the function that makes others obey.

    Parameters
    ----------
    model : ChainModel
    known : mapping of str to Parameter
    resolver : Resolver
        Solves again on pieces of the data, which gives the covariance.

    Raises
    ------
    ChainError
        If the model lacks a parameter, or what is known contradicts itself.
    """
    known_masses = dict(resolver.known_masses)
    theta = parameters_of(model, known_masses)
    names = list(theta.index)
    _refuse_spreads(known)

    equations = linear_equations(known, names, model.chain, known_masses)
    equations = _without_known_masses(equations, model)
    lower, upper = bounds_of(known, names, model.chain)
    covariance = _regular_covariance(theta, resolver)

    projection = Projection(known_masses, names, covariance, equations, lower, upper)
    obeying = projection(model)
    _warn_of_contradiction(theta, equations, covariance, known)
    return obeying, projection


def _refuse_spreads(known: Known) -> None:
    for name, parameter in known.items():
        if parameter.spread is not None:
            raise ChainError(
                f"{name} {parameter} has a spread, which is for records in which a"
                " floor has no sensor",
                "Leave it out, or give the value without a spread.",
            )


def _without_known_masses(
    equations: LinearEquations, model: ChainModel
) -> LinearEquations:
    """The equations that have a free parameter; the others must be right."""
    empty = ~np.asarray(equations.factors.any(axis=1))
    gap = np.abs(equations.values[empty]).max(initial=0.0)
    if gap > 1e-6 * np.abs(model.masses).sum():
        raise ChainError(
            f"The known masses differ from a constraint by {gap:.4g}"
            f" {model.units.mass}",
            "Correct known_masses, or leave the constraint out.",
        )
    return equations.only(~empty)


def _regular_covariance(theta: pd.Series, resolver: Resolver) -> np.ndarray:
    """Covariance of the parameters that can be inverted.

    It is shrunk towards its diagonal where the pieces are few, and has round-off as the
    smallest standard error.
    """
    known_masses = dict(resolver.known_masses)
    free = resolver.without_constraints()
    raw = free.covariance(lambda model: parameters_of(model, known_masses))

    shrinkage = len(theta) / (len(theta) + len(resolver.record))
    floor = (_ROUND_OFF * np.abs(theta.to_numpy())) ** 2 + 1e-300
    variance = np.diag(raw) + floor
    shrunk = (1 - shrinkage) * raw
    return shrunk + np.diag(variance - np.diag(shrunk))


def _warn_of_contradiction(
    theta: pd.Series, equations: LinearEquations, covariance: np.ndarray, known: Known
) -> None:
    if not len(equations.values):
        return
    factors = equations.factors
    gap = factors @ theta.to_numpy() - equations.values
    of_gap = factors @ covariance @ factors.T
    error = np.sqrt(np.diag(of_gap))
    correlation = of_gap / error[:, None] / error
    scaled = gap / error

    distance = float(scaled @ np.linalg.lstsq(correlation, scaled, rcond=1e-10)[0])
    freedom = np.linalg.matrix_rank(correlation, tol=1e-10)
    terms = np.abs(theta.to_numpy() * np.abs(factors)).max()
    unlikely = stats.chi2.sf(distance, freedom) < _UNLIKELY
    if not unlikely or np.abs(gap).max() <= _NOTICED * terms:
        return

    worst = int(np.argmax(np.abs(scaled)))
    involved = [
        f"{name} = {theta[name]:.4g}"
        for name, factor in zip(theta.index, factors[worst])
        if factor
    ]
    warn_user(
        f"The data contradict the constraints {in_words(known)}: without them"
        f" {', '.join(involved)}, {abs(scaled[worst]):.0f} standard errors away. The"
        " constrained estimate satisfies the constraints, not the data.",
        BiasWarning,
    )
