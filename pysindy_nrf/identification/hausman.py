r"""Whether least squares may stand where instruments exist: Durbin, Wu and Hausman.

Noise in the motion biases least squares, and not the instruments. Where it does not
matter, both estimate the same, and

.. math:: H = d^T \mathrm{cov}(d)^{-1} d, \quad d = \theta_{iv} - \theta_{ls}

is distributed as chi squared (Hausman, Specification tests in econometrics,
Econometrica 46, 1978). Here every parameter is tested by itself, at a level divided by
their number. The covariance of the difference is that of the differences of influences
of the same pieces of the data, so that neither estimate need be efficient.
"""

import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from ..chain.model import ChainModel
from ..exceptions import NRFError, NRFWarning
from ..records.dataset import Dataset
from .intervals import (
    Resolver,
    least_squares_resolver,
    newey_west,
    parameters_of,
)
from .problem import Estimate

# Probability that estimates which differ by chance alone are told apart.
LEVEL = 0.01
# Standard errors of least squares over those of instruments: more than chance in both,
# which come from some 64 pieces and have errors of 10 % each.
LESS_PRECISE = 2.0
# Standard errors to either side of an estimate that hold 95 %.
HALF_INTERVAL = 1.96


@dataclass(frozen=True)
class Difference:
    """Instruments less least squares, parameter by parameter.

    Attributes
    ----------
    parameters : tuple of str
    by_spread : ndarray of shape (n_parameters,)
        Differences over the standard errors of the difference.
    by_interval : ndarray of shape (n_parameters,)
        Differences over the standard errors of least squares.
    precision : ndarray of shape (n_parameters,)
        Standard errors of least squares over those of the instruments.
    """

    parameters: tuple[str, ...]
    by_spread: np.ndarray
    by_interval: np.ndarray
    precision: np.ndarray

    @property
    def matters(self) -> bool:
        """Whether least squares may not stand with its intervals."""
        return self.exceeds_chance or self.leaves_an_interval or self.is_less_precise

    @property
    def is_less_precise(self) -> bool:
        """Whether least squares has lost what it could be kept for.

        Without noise in the motion it is the more precise of the two. Where it is not,
        as at encoder steps, the test has no power.
        """
        return bool(self.precision.max() > LESS_PRECISE)

    @property
    def sentence(self) -> str:
        """The largest difference, for the user."""
        worst = int(np.argmax(np.abs(self.by_interval)))
        return (
            f"instruments find {self.parameters[worst]}"
            f" {abs(self.by_interval[worst]):.2g} standard errors from least squares,"
            " and leave more of the equations: a law is missing. Declare it."
        )

    @property
    def exceeds_chance(self) -> bool:
        """Whether a difference is larger than the spread of it explains."""
        limit = norm.ppf(1 - LEVEL / 2 / len(self.parameters))
        return bool(np.abs(self.by_spread).max() > limit)

    @property
    def leaves_an_interval(self) -> bool:
        """Whether an interval of least squares excludes what instruments find."""
        return bool(np.abs(self.by_interval).max() > HALF_INTERVAL)


def difference_of(
    least_squares: Estimate,
    data: Dataset,
    by_instruments: ChainModel,
    resolver: Resolver,
) -> Difference | None:
    """The two estimates compared; None where the pieces give no spread.

    Parameters
    ----------
    least_squares : Estimate
    data : Dataset
        Motions whose noise is independent from DOF to DOF, of which the instruments
        are.
    by_instruments : ChainModel
    resolver : Resolver
        Of the instruments.
    """
    problem = least_squares.problem

    def statistic(model: ChainModel) -> pd.Series:
        return parameters_of(model, problem.known_masses)

    of_data = least_squares_resolver(problem, least_squares.order, data)
    try:
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            plain = of_data.influences(statistic)
            instrumental = resolver.influences(statistic)
    except NRFError:
        return None
    if plain.shape != instrumental.shape:
        return None

    change = statistic(by_instruments) - statistic(least_squares.model)
    spread = _errors(instrumental - plain, of_data.record)
    errors = _errors(plain, of_data.record)
    instrumental_errors = _errors(instrumental, of_data.record)
    values = change.to_numpy(float)
    return Difference(
        parameters=tuple(map(str, change.index)),
        by_spread=_ratio(values, spread),
        by_interval=_ratio(values, errors),
        precision=_ratio(errors, instrumental_errors),
    )


def _errors(influences: np.ndarray, record: np.ndarray) -> np.ndarray:
    variance = np.diag(newey_west(influences, record))
    return np.sqrt(np.maximum(variance, 0.0))


def _ratio(values: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Values over their errors, zero where both are."""
    return np.divide(values, errors, out=np.zeros_like(values), where=errors > 0)
