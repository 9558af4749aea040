"""The courses once more, along a free run of the structure that changes.

Noise in the motion makes coefficients too small. That of friction suffers most: the
sign of a noisy rate is wrong wherever the rate is small. The motion of a free run has
no noise of the motion sensors. Its columns stand in for the measured ones, and the
right-hand side is what the courses of the run ask for and what they leave along the
measured motion (see :mod:`..residual_along_runs`). Penalties, weights and dispersion
follow from these equations; a last step solves them with the columns of the run as
instruments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...chain.laws_by_site import with_coefficients
from ...chain.model import ChainModel
from ...exceptions import SimulationError
from ...records.dataset import Segment
from ..free_runs import simulated
from ..instruments import LEAST_CORRELATION, correlation_of, delay_of
from ..spectra import common_band
from .courses import ShapedFit, Shapes
from .evidence import evidence_of, least_evidence
from .followed import Followed, fitter_of
from .penalised import PenalisedFit, two_stage
from .piece_sums import (
    EquationAlongRun,
    equation_sums_along,
    weighted_crossed,
    weights_of,
)
from .values import Estimate

# Runs: the second one is that of courses that noise does not bias.
RUNS = 2


@dataclass(frozen=True, eq=False)
class AlongRun(Estimate):
    """Courses along a free run, which has no noise of the motion sensors.

    Attributes
    ----------
    equations : sequence of EquationAlongRun
    least_squares : PenalisedFit
        Along the measured motion.
    """

    equations: Sequence[EquationAlongRun]
    least_squares: PenalisedFit

    def bias(self, number: int) -> np.ndarray:
        """What is of second order in the bias of least squares.

        Instruments take away the first order. With a relative bias r the second one is
        about r^2.
        """
        values = self.shaped.fit.values(number)
        first_order = self.least_squares.values(number) - values
        return first_order**2 / np.sqrt(np.mean(values**2))

    def is_bounded(self, label: str) -> bool:
        """Of all terms."""
        return True

    def of_what_is_seen(self, tested: Sequence[int]) -> AlongRun:
        """Without the changes that are not significant along the run.

        Noise in the motion lowers a coefficient by more where the motion is weaker,
        which looks like a change. The weakest goes first, and the others are asked
        again: it may have taken their place.
        """
        remaining = self
        while remaining.shaped.shapes:
            evidence = {}
            without = {}
            for number in remaining.shaped.shapes:
                without[number] = remaining._without(number, tested)
                evidence[number] = without[number]._evidence(number, tested)
            weakest = max(evidence, key=evidence.__getitem__)
            if evidence[weakest] < least_evidence(len(tested)):
                break
            remaining = without[weakest]
        return remaining

    def _without(self, number: int, tested: Sequence[int]) -> AlongRun:
        """One coefficient constant."""
        shapes = {u: s for u, s in self.shaped.shapes.items() if u != number}
        constant = self._fitted(shapes, tested)
        over_time = constant.shaped.fit.over_time
        equations = [each.with_coefficients(over_time) for each in self.equations]
        fitter = fitter_of(equations, self.fitter.n_unknowns, self.fitter.middles)
        again = replace(constant, fitter=fitter, equations=equations)
        return again._fitted(shapes, tested)

    def _fitted(self, shapes: Shapes, tested: Sequence[int]) -> AlongRun:
        """Other shapes along the same run."""
        start = self.shaped if shapes else self.fitter.constants(tested)
        fit = self.fitter.fit(shapes, start)
        return replace(self, shaped=_by_instruments(fit, self.equations))

    def _evidence(self, number: int, tested: Sequence[int]) -> float:
        """Evidence for a change of a coefficient that is constant here."""
        noise = self.fitter.noise_beside(self.shaped, tested)
        return evidence_of(self.shaped, number, noise)


def along_free_run(followed: Followed, shaped: ShapedFit) -> AlongRun | None:
    """The shapes of a fit, fitted along free runs; None if no run follows the motion.

    A run of courses that noise bends may diverge; that of the constant structure is an
    instrument, too. Each floor is fused by itself: the noise of its motion is then
    independent of the run.
    """
    for start in (shaped, followed.constant):
        along = _from_start(followed, shaped, start.fit.over_time)
        if along is not None:
            return along
    return None


def _from_start(
    followed: Followed, shaped: ShapedFit, over_time: np.ndarray
) -> AlongRun | None:
    """The shapes of a fit along runs, the first one with some coefficients."""
    apart = replace(followed, data=followed.data.apart)
    pieces = followed.pieces
    along = None
    for _ in range(RUNS):
        run = _following_run(apart, over_time)
        if run is None:
            break
        equations = equation_sums_along(
            apart.problem, apart.data, pieces.edges, run, over_time
        )
        fitter = fitter_of(equations, followed.unknowns.count, pieces.middles)
        fit = fitter.fit(shaped.shapes, fitter.constants(followed.tested))
        fit = _by_instruments(fit, equations)
        along = AlongRun(fitter, fit, equations, shaped.fit)
        over_time = fit.fit.over_time
    return along


def _by_instruments(
    shaped: ShapedFit, equations: Sequence[EquationAlongRun]
) -> ShapedFit:
    """The fit with the columns of the run as instruments of the measured ones."""
    weights = weights_of(equations, shaped.fit.over_time)
    crossed = weighted_crossed(equations, weights, len(shaped.fit.courses))
    fit = two_stage(shaped.fit, crossed / shaped.dispersion)
    return replace(shaped, fit=fit)


def _following_run(followed: Followed, over_time: np.ndarray) -> Segment | None:
    """The free run with some coefficients, if it follows the measured motion."""
    (segment,) = followed.data.segments
    if segment.unknown:
        return None
    model, courses = _structure(followed, segment, over_time)
    delay = delay_of(segment, common_band([segment], followed.problem.band)[1])
    try:
        run = simulated(model, segment, delay, limited=True, courses=courses)
    except SimulationError:
        # it diverges, or a mass is not positive
        return None
    follows = correlation_of([segment], [run], [delay]) >= LEAST_CORRELATION
    return run if follows else None


def _structure(
    followed: Followed, segment: Segment, over_time: np.ndarray
) -> tuple[ChainModel, dict[str, np.ndarray]]:
    """A model with mean coefficients, and the courses of those that change."""
    unknowns = followed.unknowns
    layout = unknowns.layout
    middles = followed.pieces.middles
    t = segment.t
    assert t is not None  # the record has a clock
    courses = {}
    coefficients = {}
    for site in layout.acting:
        here = over_time[:, unknowns.of_site(site)]
        coefficients[site] = here.mean(axis=0)
        for label, values in zip(layout.labels(site), here.T):
            if np.ptp(values) > 0:
                name = f"{site}: {label}"
                courses[name] = np.interp(t[segment.valid], middles, values)
    masses = followed.masses(over_time[0])
    laws = with_coefficients(layout.laws, coefficients)
    return ChainModel(masses, laws, layout.chain), courses
