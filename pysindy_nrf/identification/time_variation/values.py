"""The values of a course, and all that widens its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from .courses import CourseFitter, ShapedFit
from .penalised import PenalisedFit
from .piece_sums import BEST_SHARE

LEVEL = 0.95
# Share of the information on a coefficient over which its first and its last values are
# averaged.
FIFTH = 0.2


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
    steps : sequence of Step
    """

    values: np.ndarray
    error: np.ndarray
    steps: Sequence[Step]

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


def course_values(
    fitter: CourseFitter, shaped: ShapedFit, otherwise: PenalisedFit, number: int
) -> CourseValues:
    """Values of one course.

    The variance is that of the posterior, of the calibration of sensors, of the
    instants of steps, and the square of the difference to the same courses along a
    motion that was fused otherwise.
    """
    fit = shaped.fit
    values = fit.values(number)
    variance = fit.variance(number) + (BEST_SHARE * values) ** 2
    variance += (otherwise.values(number) - values) ** 2
    steps = _steps(fitter, shaped, number)
    for step in steps:
        variance += step.height**2 * step.passed * (1 - step.passed)
    return CourseValues(values, np.sqrt(variance), steps)


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
