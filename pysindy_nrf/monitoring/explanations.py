"""Rival explanations of the difference between two tests, and the one to report.

A loss of stiffness in all storeys looks like added mass as long as the forces are small
against the inertia. Taking in one difference after the other therefore finds the first
that removes much, not the one that is right. So several explanations are sought: by
any differences, by the storeys' forces alone, by stiffness, damping or masses alone, by
one factor of all stiffnesses, by the gain of the forces. An explanation suffices if
with it no difference of any other one is significant and large. Of those that do, the
one with the fewest changes is reported; of equally many, that with the fewest masses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .differences import ALL_STOREYS, STOREYS, Differences, without_repetition

# Directions of differences that share this of the squares of the strongest are known.
_LEAST_DIRECTION = 1e-6
# Share of the squares left that differences of a rival must explain to count. Noise in
# the motions makes masses of 1 to 3 % beside strong friction, which explain 0.0004 to
# 0.001; what an explanation truly lacks was 0.1 and more at 0.2 to 2 % noise.
LEAST_SHARE = 0.005
# Share of the squares left that a gain of the forces must explain. In 56 pairs of tests
# of an unchanged structure, noise of up to 3 % makes one of 1 to 2 %, which explains at
# most a share of 0.013.
LEAST_SHARE_OF_GAIN = 0.05


@dataclass(frozen=True)
class Change:
    """An unknown by its number, and its probability if nothing had changed."""

    unknown: int
    probability: float


Explanation = tuple[Change, ...]


def unknowns_of(changes: Sequence[Change]) -> list[int]:
    """Numbers of the unknowns of some changes."""
    return [change.unknown for change in changes]


@dataclass(frozen=True, eq=False)
class ExplanationSearch:
    """Search of what changed between two tests.

    Parameters
    ----------
    differences : Differences
    level : float
        Significance level of all unknowns together.
    least : float
        Smallest change, percent.
    """

    differences: Differences
    level: float
    least: float

    def sufficient(self) -> list[Explanation]:
        """Explanations with which nothing else is needed, the simplest first.

        Where none suffices, the one by any differences. Empty where nothing changed.
        """
        explanations = self._candidates()
        enough = []
        for explanation in explanations:
            rivals = [other for other in explanations if other is not explanation]
            if not any(self._lacks(explanation, rival) for rival in rivals):
                enough.append(explanation)

        enough = self._with_gain(enough or explanations[:1])
        return self._without_larger(sorted(enough, key=self._complexity))

    def best(self, changes: Sequence[Change], asked: Sequence[int]) -> Change | None:
        """The unknown that removes most, if it is significant and large.

        Other places that changed may change in any way.
        """
        differences = self.differences
        used = self._used(changes) + self._other_changes(changes, asked)
        used = without_repetition(used)
        rest = [i for i in asked if i not in used]
        if not rest:
            return None

        remaining = differences.unexplained(used, rest)
        power = np.diagonal(remaining, axis1=1, axis2=2)[:, :-1]
        usable = differences.is_known(rest, power[0])
        values = remaining[:, :-1, -1] / np.where(usable, power, 1.0)

        probability = differences.probability(values, len(differences.unknowns))
        large = self._is_large(rest, values[0])
        wanted = usable & large & (probability < self.level)
        gain = np.where(wanted, values[0] ** 2 * power[0], 0.0)
        if not gain.any():
            return None
        best = int(np.argmax(gain))
        return Change(rest[best], float(probability[best]))

    # -- candidates ------------------------------------------------------------

    def _candidates(self) -> list[Explanation]:
        """Explanations from each pool that are possible and unlike each other."""
        candidates: dict[frozenset[int], Explanation] = {}
        for pool in self._pools():
            explanation = self._needed(self._grown(pool))
            if explanation and self._is_possible(explanation):
                candidates.setdefault(self._terms(explanation), explanation)
        return list(candidates.values())

    def _pools(self) -> list[list[int]]:
        """Unknowns of which an explanation may consist; all of them first."""
        names = self.differences.unknowns
        asked = self.differences.asked
        masses = [i for i in asked if names[i].is_mass]
        forces = [i for i in asked if names[i].place.startswith(STOREYS)]
        factor = [i for i in forces if names[i].place == ALL_STOREYS]
        stiffness = [i for i in forces if names[i].term == "k"]
        damping = [i for i in forces if names[i].term == "c"]
        return [masses + forces, forces, stiffness, damping, masses, factor]

    def _grown(self, pool: Sequence[int]) -> Explanation:
        """One difference after the other: that which removes most."""
        changes: list[Change] = []
        best = self.best(changes, pool)
        while best is not None:
            place = self._place(best)
            here = [i for i in pool if self.differences.unknowns[i].place == place]
            while best is not None:  # which terms of this place
                changes.append(best)
                best = self.best(changes, here)
            best = self.best(changes, pool)
        return tuple(changes)

    def _needed(self, explanation: Explanation) -> Explanation:
        """An explanation without changes that later ones made needless."""
        changes = list(explanation)
        while changes:
            values = self._values(changes)
            n_unknowns = len(self.differences.unknowns)
            probability = self.differences.probability(values, n_unknowns)
            large = self._is_large(unknowns_of(changes), values[0])
            needless = np.where(large, probability, 1.0)
            if needless.max() < self.level:
                break
            del changes[int(np.argmax(needless))]
        return tuple(changes)

    def _is_possible(self, explanation: Explanation) -> bool:
        """Whether all masses are positive in both tests."""
        changed = unknowns_of(explanation)
        masses = self.differences.masses_of_tests(changed)
        return bool(np.min(masses) > 0)

    def _terms(self, explanation: Explanation) -> frozenset[int]:
        """Unknowns of single places that an explanation changes."""
        terms: set[int] = set()
        for change in explanation:
            terms.update(self.differences.parts(change.unknown))
        return frozenset(terms)

    def _without_larger(self, explanations: Sequence[Explanation]) -> list[Explanation]:
        """Explanations without those that only add to the first one."""
        unlike = list(explanations[:1])
        for rival in explanations[1:]:
            if not self._terms(explanations[0]) <= self._terms(rival):
                unlike.append(rival)
        return unlike

    def _with_gain(self, explanations: Sequence[Explanation]) -> list[Explanation]:
        """The same with a change of the gain of all forces, where that suffices.

        With a gain, all masses, stiffnesses and dampings together have no scale. So it
        explains alone, and is compared by what each explanation leaves.
        """
        gain = self._gain_alone()
        if gain is None:
            return list(explanations)

        if any(self._leaves_less(other, gain) for other in explanations):
            return list(explanations)
        as_good = [e for e in explanations if not self._leaves_less(gain, e)]
        return as_good + [gain]

    def _gain_alone(self) -> Explanation | None:
        """A change of the gain of all forces, if it is significant and large."""
        differences = self.differences
        names = differences.unknowns
        asked = [i for i in differences.asked if names[i].is_gain]
        change = self.best((), asked)
        if change is None:
            return None
        before = self._unexplained_squares(())[0]
        after = self._unexplained_squares((change,))[0]
        if before - after > LEAST_SHARE_OF_GAIN * before:
            return (change,)
        return None

    def _leaves_less(self, explanation: Explanation, other: Explanation) -> bool:
        """Whether an explanation leaves significantly less than another."""
        saved = (
            self._unexplained_squares(other) - self._unexplained_squares(explanation)
        )[:, None]
        probability = self.differences.probability(saved, 1)[0]
        return bool(saved[0, 0] > 0 and probability < self.level)

    def _unexplained_squares(self, explanation: Explanation) -> np.ndarray:
        """Squares that an explanation leaves, of all blocks and without each."""
        return self.differences.unexplained(self._used(explanation), [])[:, 0, 0]

    # -- comparison ------------------------------------------------------------

    def _lacks(self, explanation: Explanation, rival: Explanation) -> bool:
        """Whether a difference of a rival is significant and large beside another.

        The differences of the rival are asked about together, in directions that
        explain independently of each other: one by one they may hide each other.
        """
        differences = self.differences
        used = self._used(explanation)
        rest = [unknown for unknown in unknowns_of(rival) if unknown not in used]
        if not rest:
            return False

        remaining = differences.unexplained(used, rest)
        squares = remaining[:, :-1, :-1]
        directions = _independent_directions(squares[0])
        known = differences.is_known(rest, np.diagonal(squares[0]))
        directions = directions * known[:, None]
        grams = directions.T @ squares @ directions
        right = directions.T @ remaining[:, :-1, -1:]
        values = (np.linalg.pinv(grams, hermitian=True) @ right)[..., 0]

        probability = differences.probability(values, values.shape[1])
        certain = np.where(probability < self.level, values[0], 0.0)
        if np.sum(certain**2) < LEAST_SHARE * remaining[0, -1, -1]:
            return False
        return bool(self._is_large(rest, directions @ certain).any())

    def _complexity(self, explanation: Explanation) -> tuple[int, int]:
        """Number of changes, and of those that are not of a storey's force."""
        n_others = 0
        for unknown in unknowns_of(explanation):
            name = self.differences.unknowns[unknown]
            n_others += name.is_mass or name.is_gain
        return len(explanation), n_others

    def _values(self, changes: Sequence[Change]) -> np.ndarray:
        """Values of changes, from all blocks and without each of them."""
        n_always = len(self.differences.always)
        return self.differences.solved(self._used(changes))[:, n_always:]

    def _used(self, changes: Sequence[Change]) -> list[int]:
        """Unknowns in use: departures of masses, and the changes."""
        return self.differences.always + unknowns_of(changes)

    def _is_large(self, unknowns: Sequence[int], values: np.ndarray) -> np.ndarray:
        sizes = []
        for unknown, value in zip(unknowns, values):
            sizes.append(float(self.differences.size(unknown, value)))
        return np.array(sizes) >= self.least

    def _place(self, change: Change) -> str:
        return self.differences.unknowns[change.unknown].place

    def _other_changes(
        self, changes: Sequence[Change], asked: Sequence[int]
    ) -> list[int]:
        """All unknowns of places that changed; but of the one that is asked about."""
        names = self.differences.unknowns
        changed = {self._place(change) for change in changes}
        places = {names[i].place for i in asked}
        if len(places) == 1:
            changed -= places
        numbers = range(self.differences.n_masses, len(names))
        return [i for i in numbers if names[i].place in changed]


def _independent_directions(squares: np.ndarray) -> np.ndarray:
    """Directions in which squares are one and products zero, as columns."""
    scale = np.sqrt(np.maximum(np.diagonal(squares), np.finfo(float).tiny))
    powers, vectors = np.linalg.eigh(squares / np.outer(scale, scale))
    strong = powers > _LEAST_DIRECTION * powers[-1]
    return vectors[:, strong] / np.sqrt(powers[strong]) / scale[:, None]
