"""The values of a course, and all that widens its band."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy import stats

from .courses import CourseFitter, ShapedFit
from .penalised import PenalisedFit
from .piece_sums import BEST_SHARE
from .request import LINEAR_TERMS

LEVEL = 0.95
# Share of the information on a coefficient over which its first and its last values are
# averaged.
FIFTH = 0.2
# Negative value, over the median, that noise may give to friction that has worn off.
SIGN_MARGIN = 0.1


@dataclass(frozen=True, eq=False)
class Step:
    """A sudden change of a coefficient.

    Attributes
    ----------
    piece : int
        At whose beginning it is.
    height : float
    passed : ndarray of shape (n_pieces,)
        Probability that it is in a piece or before.
    """

    piece: int
    height: float
    passed: np.ndarray


@dataclass(frozen=True, eq=False)
class CourseValues:
    """A course with its band.

    Attributes
    ----------
    values, error : ndarray of shape (n_pieces,)
        And the standard error.
    error_of_change : float
        Standard error of the last value less the first.
    steps : sequence of Step
    is_bounded : bool
        Whether the standard errors hold all that may move the values.
    """

    values: np.ndarray
    error: np.ndarray
    error_of_change: float
    steps: Sequence[Step]
    is_bounded: bool

    @property
    def lower(self) -> np.ndarray:
        """Lower end of the band."""
        return self.values - stats.norm.ppf((1 + LEVEL) / 2) * self.error

    @property
    def upper(self) -> np.ndarray:
        """Upper end of the band."""
        return self.values + stats.norm.ppf((1 + LEVEL) / 2) * self.error

    @property
    def may_be_constant(self) -> bool:
        """Whether a constant lies within the band all along."""
        return bool(self.lower.max() <= self.upper.min())

    @property
    def is_negative(self) -> bool:
        """Whether it falls below zero, by a tenth of its median.

        Stiffness, damping and friction are positive. What is not takes the place of
        something that is missing: a law, or floors without a sensor.
        """
        size = abs(float(np.median(self.values)))
        return bool(self.values.min() < -SIGN_MARGIN * size)


@dataclass(frozen=True, eq=False)
class Estimate(ABC):
    """Courses of all coefficients.

    Attributes
    ----------
    fitter : CourseFitter
    shaped : ShapedFit
    """

    fitter: CourseFitter
    shaped: ShapedFit

    @abstractmethod
    def bias(self, number: int) -> np.ndarray:
        """What noise in the motion may still move of a course."""

    @abstractmethod
    def of_what_is_seen(self, tested: Sequence[int]) -> Self:
        """Without changes that are no more than what noise in the motion feigns."""

    @abstractmethod
    def is_bounded(self, label: str) -> bool:
        """Whether the bias of the coefficient of a term is known."""


@dataclass(frozen=True, eq=False)
class AlongMotion(Estimate):
    """Courses along the measured motion.

    Attributes
    ----------
    otherwise : PenalisedFit
        The same along a motion that was fused otherwise.
    """

    otherwise: PenalisedFit

    def bias(self, number: int) -> np.ndarray:
        """The difference of both."""
        return self.otherwise.values(number) - self.shaped.fit.values(number)

    def of_what_is_seen(self, tested: Sequence[int]) -> AlongMotion:
        """All of them: their bands hold the bias."""
        return self

    def is_bounded(self, label: str) -> bool:
        """Only of what is linear in the motion.

        Both motions have a noisy rate, and the sign of either is too often wrong.
        """
        return label in LINEAR_TERMS


def course_values(estimate: Estimate, number: int, label: str) -> CourseValues:
    """Values of the course of one coefficient.

    The variance is that of the posterior, of the calibration of sensors and of the
    instants of steps, and the squares of what noise in the motion and the penalty may
    have moved.
    """
    shaped = estimate.shaped
    fit = shaped.fit
    values = fit.values(number)
    variance = fit.variance(number) + (BEST_SHARE * values) ** 2
    of_change = _variance_of_change(fit, number)
    for moved in (estimate.bias(number), fit.smoothed(number)):
        variance += moved**2
        of_change += (moved[-1] - moved[0]) ** 2
    steps = _steps(estimate.fitter, shaped, number)
    for step in steps:
        variance += step.height**2 * step.passed * (1 - step.passed)
    return CourseValues(
        values,
        np.sqrt(variance),
        float(np.sqrt(of_change)),
        steps,
        estimate.is_bounded(label),
    )


def _variance_of_change(fit: PenalisedFit, number: int) -> float:
    """Posterior variance of the last value less the first."""
    columns = fit.courses[number].columns
    here = fit.places[number]
    difference = columns[-1] - columns[0]
    return float(difference @ fit.uncertainty[here, here] @ difference)


def _steps(fitter: CourseFitter, shaped: ShapedFit, number: int) -> list[Step]:
    """Steps of one course."""
    shape = shaped.shapes.get(number)
    if shape is None or not shape.steps:
        return []
    fit = shaped.fit
    heights = fit.coefficients[fit.places[number]][-len(shape.steps) :]
    steps = []
    for piece, height in zip(shape.steps, heights):
        likely = fitter.likelihood_of_instants(shaped, number, piece)
        steps.append(Step(piece, float(height), np.cumsum(likely)))
    return steps


def lasting_share(shaped: ShapedFit, number: int) -> float:
    """How far a course has moved in the end, as a share of its range."""
    values = shaped.fit.values(number)
    information = shaped.fit.products[:, number, number]
    passed = np.cumsum(information) / information.sum()
    first = np.average(values, weights=information * (passed <= FIFTH))
    last = np.average(values, weights=information * (passed >= 1 - FIFTH))
    return float(abs(last - first) / np.ptp(values))
