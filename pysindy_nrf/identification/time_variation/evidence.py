"""Whether a coefficient changes: tests with a stated rate of false alarms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .courses import CourseFitter, ShapedFit
from .scan import Noise, log_probability_of_smooth, step_scan

# Probability that anything of a structure that does not change is called changing.
FALSE_ALARM_RATE = 0.01
# Range of a change, as a share of the rms force of its storey, below which it is none:
# what ``monitoring.compare_tests`` asks for, twice. And as a share of the largest
# change: what noise in the motion and the pieces leave of it turns up in others. Both
# were chosen on the 30 first chains that change of ``benchmarks/time_varying.py`` with
# the seed 7000, which it does not report.
LEAST_CHANGE = 0.02
LEAST_OF_LARGEST = 0.1
# Coefficients with most evidence that are fitted beside each other: the storey that
# changes, and the two that share an equation with it.
MAX_RIVALS = 3


def evidence_of(shaped: ShapedFit, unknown: int, noise: Noise) -> float:
    """Logarithm of a bound of the probability that chance looks as much like a change.

    Of one coefficient, added to a fit, sudden or gradual.
    """
    sudden = step_scan(shaped.fit, unknown, noise).log_probability
    gradual = log_probability_of_smooth(shaped.fit, unknown, noise)
    # either of two tests
    return min(min(sudden, gradual) + float(np.log(2)), 0.0)


def least_evidence(n_tests: int) -> float:
    """Logarithm of the probability below which one of some tests shows a change."""
    return float(np.log(FALSE_ALARM_RATE / n_tests))


@dataclass(frozen=True, eq=False)
class Search:
    """Coefficients that change, one after the other.

    Attributes
    ----------
    shaped : ShapedFit
        With the shapes of those that change.
    evidence : dict of int to float
        Logarithm of the probability of the evidence by chance, of each tested
        coefficient when it was taken in, or at the end.
    """

    shaped: ShapedFit
    evidence: dict[int, float]

    @property
    def changing(self) -> list[int]:
        """Unknowns that change."""
        return list(self.shaped.shapes)


def search_for_changes(
    fitter: CourseFitter,
    start: ShapedFit,
    tested: Sequence[int],
    sizes: np.ndarray,
    n_tests: int,
) -> Search:
    """Take in the coefficient that explains most, until none is significant.

    Neighbouring storeys move alike, so that a change of one is evidence for the other,
    too; the fits with a course of each decide.

    Parameters
    ----------
    fitter : CourseFitter
    start : ShapedFit
    tested : sequence of int
    sizes : ndarray of shape (n_unknowns,)
        Force of each coefficient's column over that of its storey, per unit.
    n_tests : int
        Tests among which the rate of false alarms is shared.
    """
    level = least_evidence(n_tests)
    shaped = start
    evidence: dict[int, float] = {}
    pending = list(tested)
    while pending:
        noise = fitter.noise_beside(shaped, tested)
        now = {unknown: evidence_of(shaped, unknown, noise) for unknown in pending}
        evidence |= now
        significant = [u for u in sorted(now, key=now.__getitem__) if now[u] < level]
        if not significant:
            break
        rivals = {u: fitter.shaped(shaped, u) for u in significant[:MAX_RIVALS]}
        best = _best_of(rivals)
        pending.remove(best)
        if _range_of(rivals[best], best, sizes) >= LEAST_CHANGE:
            shaped = rivals[best]
    return Search(_without_small(fitter, start, shaped, sizes), evidence)


def _best_of(rivals: Mapping[int, ShapedFit]) -> int:
    """The coefficient whose course leaves least, for the least dispersion of all."""
    dispersion = min(fit.dispersion for fit in rivals.values())
    return min(rivals, key=lambda unknown: rivals[unknown].criterion(dispersion))


def _range_of(shaped: ShapedFit, unknown: int, sizes: np.ndarray) -> float:
    """Range of a change as a share of the rms force of its storey."""
    return float(np.ptp(shaped.fit.values(unknown)) * sizes[unknown])


def _without_small(
    fitter: CourseFitter, start: ShapedFit, shaped: ShapedFit, sizes: np.ndarray
) -> ShapedFit:
    """The fit without changes that are small beside the largest of them."""
    ranges = {unknown: _range_of(shaped, unknown, sizes) for unknown in shaped.shapes}
    largest = max(ranges.values(), default=0.0)
    least = max(LEAST_CHANGE, LEAST_OF_LARGEST * largest)
    large = {u: shape for u, shape in shaped.shapes.items() if ranges[u] >= least}
    if len(large) == len(shaped.shapes):
        return shaped
    return fitter.fit(large, start)
