"""The course of each coefficient that changes: gradual, sudden, or both.

Candidates are a spline, steps between constants, and a spline with steps. The one with
the least Bayesian information criterion is taken. This is minus twice the logarithm of
the likelihood, for noise of one dispersion, plus log(n) for each degree of freedom. A
step counts as two: its size and its instant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .dispersion import dispersion_of
from .neighbours import LEAST_LEFT, NEIGHBOURS
from .penalised import PenalisedFit, fitted, scores_of
from .scan import Noise, step_scan
from .splines import Course, constant, p_spline

MAX_STEPS = 3
# Pieces between two steps, at least: a period of the first mode. Losses that are nearer
# cannot be told from one.
LEAST_DISTANCE = 8
# Fall of the criterion from which on a further step is taken: very strong evidence
# (Kass and Raftery, Journal of the American Statistical Association 90, 1995).
STRONG = 10.0
# Intervals of the splines of all coefficients at once, by which the noise is seen.
COARSE_INTERVALS = 20
# Passes in which equations are weighted, and the dispersion is estimated.
PASSES = 3

# Of courses of all unknowns in the pieces: weighted products of all equations.
Weighting = Callable[[np.ndarray], np.ndarray]
# Of the same: minus twice the logarithm of the likelihood of white noise.
Deviance = Callable[[np.ndarray], float]


@dataclass(frozen=True)
class Shape:
    """Which functions of time a coefficient follows.

    Attributes
    ----------
    gradual : bool
    steps : tuple of int
        Pieces at whose beginning it jumps.
    """

    gradual: bool
    steps: tuple[int, ...] = ()

    def course(self, middles: np.ndarray) -> Course:
        """Its functions of time."""
        course = p_spline(middles) if self.gradual else constant(len(middles))
        for piece in self.steps:
            course = course.with_step(piece)
        return course


Shapes = Mapping[int, Shape]


@dataclass(frozen=True, eq=False)
class ShapedFit:
    """A fit with its shapes.

    Attributes
    ----------
    fit : PenalisedFit
        Of noise of unit dispersion.
    shapes : mapping of int to Shape
        By unknown; others are constant.
    dispersion : float
        By which the products of the fit were divided.
    deviance : float
        For white noise.
    """

    fit: PenalisedFit
    shapes: Shapes
    dispersion: float
    deviance: float

    def criterion(self, dispersion: float) -> float:
        """Bayesian information criterion for noise of a dispersion."""
        freedom = 0.0
        for unknown, shape in self.shapes.items():
            freedom += self.fit.freedom(unknown) + len(shape.steps)
        n_pieces = len(self.fit.products)
        return self.deviance / dispersion + np.log(n_pieces) * freedom


@dataclass(frozen=True, eq=False)
class CourseFitter:
    """Fits courses on the pieces of a record.

    Attributes
    ----------
    middles : ndarray of shape (n_pieces,)
        Middles of the pieces, s.
    n_unknowns : int
    weighting : callable
        Products of all equations, each over the mean square that it leaves.
    deviance : callable
    """

    middles: np.ndarray
    n_unknowns: int
    weighting: Weighting
    deviance: Deviance

    def constants(self, tested: Sequence[int]) -> ShapedFit:
        """All coefficients constant; the dispersion is the mean over those tested."""
        nothing = np.zeros((len(self.middles), self.n_unknowns))
        products = self.weighting(nothing)
        for _ in range(PASSES):
            fit = fitted(products, self._courses({}))
            products = self.weighting(fit.over_time)
        fit = fitted(products, self._courses({}))
        ratios = [dispersion_of(fit, unknown) for unknown in tested]
        dispersion = float(np.mean(ratios)) if ratios else 1.0
        fit = fitted(products / dispersion, self._courses({}))
        return ShapedFit(fit, {}, dispersion, self.deviance(fit.over_time))

    def fit(self, shapes: Shapes, start: ShapedFit) -> ShapedFit:
        """Fit shapes, with their own weights and dispersion.

        ``start`` is a fit from whose weights the passes begin. The dispersion is the
        mean over the unknowns with a shape.
        """
        if not shapes:
            return start
        courses = self._courses(shapes)
        dispersion = start.dispersion
        fit = fitted(start.fit.products, courses)
        for _ in range(PASSES):
            products = self.weighting(fit.over_time)
            ratios = []
            fit = fitted(products / dispersion, courses, fit.strengths)
            for unknown in shapes:
                ratios.append(dispersion_of(fit, unknown))
            dispersion *= max(float(np.mean(ratios)), 1e-3)
        fit = fitted(products / dispersion, courses, fit.strengths)
        return ShapedFit(fit, dict(shapes), dispersion, self.deviance(fit.over_time))

    def noise_beside(self, shaped: ShapedFit, tested: Sequence[int]) -> Noise:
        """The noise, with the weights of a fit.

        Of a fit in which everything that is tested may change: what changes is no
        noise. Its scores are as large as before the courses absorbed some of them. No
        sensor is calibrated better than to the floor of the weights.
        """
        courses = list(shaped.fit.courses)
        spline = p_spline(self.middles, COARSE_INTERVALS)
        for unknown in tested:
            if unknown not in shaped.shapes:
                courses[unknown] = spline
        everything = fitted(shaped.fit.products, courses, search=False)
        scores = scores_of(shaped.fit.products, everything.over_time)
        n_pieces = len(self.middles)
        absorbed = spline.columns.shape[1] * (NEIGHBOURS + 1) / n_pieces
        scores /= np.sqrt(max(1 - absorbed, LEAST_LEFT))
        return Noise(scores, 1.0 / shaped.dispersion)

    def _courses(self, shapes: Shapes) -> list[Course]:
        courses = [constant(len(self.middles))] * self.n_unknowns
        for unknown, shape in shapes.items():
            courses[unknown] = shape.course(self.middles)
        return courses

    def shaped(self, before: ShapedFit, unknown: int) -> ShapedFit:
        """The best shape of one coefficient given the shapes of others.

        ``before`` is a fit in which it is constant, or has another shape.
        """
        others = {u: shape for u, shape in before.shapes.items() if u != unknown}
        best = self.fit({**others, unknown: Shape(True)}, before)
        steps: tuple[int, ...] = ()
        for _ in range(MAX_STEPS):
            steps = self._one_more_step(others, unknown, steps, best)
            if not steps:
                break
            candidates = [
                self.fit({**others, unknown: Shape(gradual, steps)}, best)
                for gradual in (False, True)
            ]
            following = best_of(candidates)
            if not _is_better(following, best):
                break
            best = following
        return best

    def _one_more_step(
        self,
        others: Shapes,
        unknown: int,
        steps: tuple[int, ...],
        best: ShapedFit,
    ) -> tuple[int, ...]:
        """Steps with a further one where it explains most, each moved to its best."""
        without = self._at_weights({**others, unknown: Shape(False, steps)}, best)
        every = sorted([*steps, step_scan(without, unknown).best])
        for place in range(len(every)) if steps else ():
            rest = tuple(every[:place] + every[place + 1 :])
            without = self._at_weights({**others, unknown: Shape(False, rest)}, best)
            every[place] = step_scan(without, unknown).best
        every.sort()
        too_near = np.diff(every) < LEAST_DISTANCE
        return () if too_near.any() or every[0] < 1 else tuple(every)

    def _at_weights(self, shapes: Shapes, weighted: ShapedFit) -> PenalisedFit:
        """Shapes fitted with the weights of another fit."""
        return fitted(weighted.fit.products, self._courses(shapes))

    def likelihood_of_instants(
        self, shaped: ShapedFit, unknown: int, step: int
    ) -> np.ndarray:
        """Probability of each piece for a step, the spline and other steps as they are.

        Returns
        -------
        ndarray of shape (n_pieces,)
        """
        shape = shaped.shapes[unknown]
        rest = tuple(x for x in shape.steps if x != step)
        courses = list(shaped.fit.courses)
        courses[unknown] = replace(shape, steps=rest).course(self.middles)
        strengths = shaped.fit.strengths
        without = fitted(shaped.fit.products, courses, strengths, search=False)
        scan = step_scan(without, unknown)
        likelihood = np.full(len(self.middles), -np.inf)
        likelihood[scan.pieces] = 0.5 * scan.scores**2
        weights = np.exp(likelihood - likelihood.max())
        # an instant is known to the piece, and may lie within it
        blurred = np.convolve(weights, [0.5, 1.0, 0.5], mode="same")
        return blurred / blurred.sum()


def _is_better(following: ShapedFit, best: ShapedFit) -> bool:
    """Whether a fit with more steps is much better."""
    dispersion = min(following.dispersion, best.dispersion)
    return following.criterion(dispersion) < best.criterion(dispersion) - STRONG


def best_of(candidates: Sequence[ShapedFit]) -> ShapedFit:
    """The fit with the least criterion, for the least dispersion of all."""
    dispersion = min(candidate.dispersion for candidate in candidates)
    return min(candidates, key=lambda fit: fit.criterion(dispersion))
