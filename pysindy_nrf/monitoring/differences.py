"""Differences between two tests as unknowns of one linear problem.

The unknowns are departures of the masses from those given, changes of the masses, a
change of the gain of all forces, changes of each cut's terms, and one factor of all
stiffnesses. All cuts share the masses. Standard errors come from leaving out one block
of a test at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from ..equations.normal_equations import variance
from ..exceptions import ChainError
from .force_change import Cut

# Added to the squares of columns of unit length. Columns may depend on each other; only
# their span counts.
RIDGE = 1e-9
# Share of a column's squares that others must leave for its value to be known. What the
# ridge leaves of a column that depends on them is some of its own size.
LEAST_LEFT = 100 * RIDGE
# Share of the force; a residual below is round-off.
EXACT = 1e-6
STOREYS = ("storey", "all storeys")
ALL_STOREYS = "all storeys"
ALL_FORCES = "all forces"
_LEAST = np.finfo(float).tiny


@dataclass(frozen=True)
class Difference:
    """What may have changed: a term of a storey, a mass, a gain."""

    place: str
    term: str

    @property
    def is_mass(self) -> bool:
        """Whether it is a mass."""
        return self.place.startswith("dof")

    @property
    def is_gain(self) -> bool:
        """Whether it is the gain of the force sensors."""
        return self.place == ALL_FORCES


class Differences:
    """The linear problem of all differences between two tests.

    Parameters
    ----------
    cuts : sequence of Cut
    fitted_masses : ndarray of shape (2, n_dof)
        Masses as fitted to each test, kg.
    free : sequence of int
        DOFs whose mass is not known.

    Attributes
    ----------
    masses : ndarray of shape (n_dof,)
        Their mean, by which the forces of the cuts follow, kg.
    unknowns : list of Difference
    always : list of int
        Unknowns that nobody asks about: departures of masses.
    asked : list of int
        Those that are differences: of free masses, of the gain, and of terms.
    """

    def __init__(
        self, cuts: Sequence[Cut], fitted_masses: np.ndarray, free: Sequence[int]
    ) -> None:
        self.cuts = list(cuts)
        self.masses = fitted_masses.mean(axis=0)
        self.n_masses = len(self.masses)
        dofs = range(1, self.n_masses + 1)

        self.unknowns = [Difference("", f"m{j}") for j in dofs]
        self.unknowns += [Difference(f"dof {j}", "m") for j in dofs]
        self.unknowns.append(Difference(ALL_FORCES, "gain"))
        for cut in self.cuts:
            self.unknowns += [Difference(cut.place, term) for term in cut.terms]
        self._of_single_stiffnesses = self._stiffnesses()
        if len(self.cuts) > 1:
            self.unknowns.append(Difference(ALL_STOREYS, "k"))

        self.always = [j - 1 for j in free]
        changes_of_masses = [self.n_masses + j - 1 for j in free]
        others = range(2 * self.n_masses, len(self.unknowns))
        self.asked = changes_of_masses + list(others)

        self._total = self._sums(fitted_masses - self.masses)

    def cut(self, place: str) -> Cut:
        """The cut below a storey's floor.

        Raises
        ------
        ChainError
            If not all forces above it are known.
        """
        for cut in self.cuts:
            if cut.place == place:
                return cut
        raise ChainError(
            f"The force of {place} is not known in both tests",
            "Measure all forces above it.",
        )

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the standard errors."""
        n_blocks: list[int] = []
        for cut in self.cuts:
            n_blocks += map(len, cut.grams)
        return min(n_blocks) - 1

    # -- values ----------------------------------------------------------------

    def solved(self, used: Sequence[int]) -> np.ndarray:
        """Values of unknowns: from all blocks, and without each of them."""
        numbers = np.array(used, int)
        grams = self._total[:, numbers[:, None], numbers]
        return _solve(grams, self._total[:, numbers, -1:])[..., 0]

    def masses_of_tests(self, changed: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Masses of both tests where some unknowns changed, kg."""
        used = self.always + list(changed)
        values = np.zeros(len(self.unknowns))
        values[used] = self.solved(used)[0]
        before = self.masses + values[: self.n_masses]
        return before, before + values[self.n_masses : 2 * self.n_masses]

    def unexplained(self, used: Sequence[int], asked: Sequence[int]) -> np.ndarray:
        """Gram matrices of [unknowns that are asked about | force], less those used.

        From all blocks, and without each of them.
        """
        order = np.concatenate([used, asked, [len(self.unknowns)]]).astype(int)
        return unexplained(self._total[:, order[:, None], order], len(used))

    def is_known(self, asked: Sequence[int], remaining: np.ndarray) -> np.ndarray:
        """Whether the squares that remain of unknowns are enough for a value."""
        squares = np.diagonal(self._total[0])[list(asked)]
        return remaining > LEAST_LEFT * squares

    def variance(self, values: np.ndarray) -> np.ndarray:
        """Variance of values found from all blocks, and without each of them."""
        n_first = len(self.cuts[0].grams[0])
        before = values[1 : 1 + n_first]
        after = values[1 + n_first :]
        return variance(before) + variance(after)

    def probability(self, values: np.ndarray, n_asked: int) -> np.ndarray:
        """Probability of each value if it were zero, of several together."""
        error = np.maximum(np.sqrt(self.variance(values)), _LEAST)
        alone = 2 * special.stdtr(self.freedom, -np.abs(values[0]) / error)
        return np.minimum(alone * n_asked, 1.0)  # Bonferroni

    def size(self, unknown: int, values: np.ndarray) -> np.ndarray:
        """Change by one unknown, percent of its spring's force, mass or forces."""
        name = self.unknowns[unknown]
        if name.is_mass:
            return 100 * np.abs(values) / self.masses[int(name.place[4:]) - 1]
        if name.place in (ALL_STOREYS, ALL_FORCES):
            return 100 * np.abs(values)
        return self.cut(name.place).size([name.term], np.asarray(values)[..., None])

    def by_term(self, used: Sequence[int], values: np.ndarray) -> dict[int, np.ndarray]:
        """Values of unknowns, a factor of all stiffnesses as that of each storey."""
        terms: dict[int, np.ndarray] = {}
        for unknown, value in zip(used, values.T):
            for number, multiple in self.parts(unknown).items():
                terms[number] = terms.get(number, 0.0) + multiple * value
        return terms

    def parts(self, unknown: int) -> dict[int, float]:
        """Unknowns of single places that one stands for, and their multiples."""
        if self.unknowns[unknown].place == ALL_STOREYS:
            return self._of_single_stiffnesses
        return {unknown: 1.0}

    def _stiffnesses(self) -> dict[int, float]:
        """Stiffness of each storey in the first test, by the unknown it changes by."""
        stiffnesses = {}
        for cut in self.cuts:
            number = self.unknowns.index(Difference(cut.place, "k"))
            stiffnesses[number] = cut.stiffness * cut.domain.unit[1]
        return stiffnesses

    # -- sums ------------------------------------------------------------------

    def _sums(self, departures: np.ndarray) -> np.ndarray:
        """Gram matrices of all unknowns and the forces.

        Of all blocks, and without each block of the first and of the second test. Cuts
        and tests are weighted by what they leave with the masses fitted to each test:
        with those of a common fit, cuts below unforced floors would leave less and
        weigh more the smaller their masses are.
        """
        n_blocks = [len(blocks) for blocks in self.cuts[0].grams]
        first_term = 2 * self.n_masses + 1
        n_terms = sum(len(cut.terms) for cut in self.cuts)
        size = first_term + n_terms + 1
        total = np.zeros((1 + sum(n_blocks), size, size))
        for cut in self.cuts:
            shared = np.arange(2 * self.n_masses + 1)
            terms = np.arange(first_term, first_term + len(cut.terms))
            place = np.concatenate([shared, terms, [size - 1]])
            total[:, place[:, None], place] += self._sums_of_cut(cut, departures)
            first_term += len(cut.terms)
        return self._with_all_storeys(total)

    def _with_all_storeys(self, total: np.ndarray) -> np.ndarray:
        """The same with the factor of all stiffnesses before the force."""
        if len(self.cuts) < 2:
            return total
        size = total.shape[-1]
        columns = np.insert(np.eye(size), size - 1, 0.0, axis=1)
        for number, stiffness in self._of_single_stiffnesses.items():
            columns[number, size - 1] = stiffness
        return columns.T @ total @ columns

    def _sums_of_cut(self, cut: Cut, departures: np.ndarray) -> np.ndarray:
        """Gram matrices of the unknowns of one cut, less what the common law explains.

        Unknowns are in the order of [departures of masses | their changes | gain |
        changes of terms | force].
        """
        force = cut.grams[0].shape[1] - 1
        applied = force - 1
        n_common = applied - self.n_masses
        accelerations = np.arange(n_common, applied)
        terms = np.arange(len(cut.terms))
        common = np.arange(n_common)
        columns = np.concatenate(
            [common, accelerations, accelerations, [applied], terms, [force]]
        )
        # changes are those of the second test
        is_change = np.zeros(len(columns), dtype=bool)
        is_change[n_common + self.n_masses : -1] = True

        n_samples = [len(blocks) for blocks in cut.grams]
        first_of_test = [1, 1 + n_samples[0]]
        total = np.zeros((1 + sum(n_samples), len(columns), len(columns)))
        for test, blocks in enumerate(cut.grams):
            of_test = blocks.sum(axis=0)
            sums = np.repeat(of_test[None], len(total), axis=0)
            start = first_of_test[test]
            sums[start : start + len(blocks)] -= blocks

            weight = cut.count[test] / _residual(of_test, n_common, departures[test])
            acts = np.where(is_change, test, 1)
            acts = np.outer(acts, acts)
            total += weight * sums[:, columns[:, None], columns] * acts
        return unexplained(total, n_common)


def _residual(gram: np.ndarray, n_common: int, departures: np.ndarray) -> float:
    """Squares that the common law leaves of the force with departures of the masses."""
    direction = np.concatenate([-departures, [0.0, 1.0]])
    residual = direction @ unexplained(gram, n_common) @ direction
    return max(residual, EXACT**2 * gram[-1, -1], _LEAST)


def without_repetition(numbers: Iterable[int]) -> list[int]:
    """Numbers in their order, each once."""
    return list(dict.fromkeys(numbers))


def unexplained(grams: np.ndarray, n: int) -> np.ndarray:
    """Gram matrices of the columns behind the first n, less what those explain."""
    cross = grams[..., :n, n:]
    explained = cross.swapaxes(-1, -2) @ _solve(grams[..., :n, :n], cross)
    return grams[..., n:, n:] - explained


def _solve(grams: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of normal equations.

    Their columns span orders of magnitude and may depend on each other.
    """
    scale = np.sqrt(np.diagonal(grams, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)[..., None]
    unit = grams / scale / scale.swapaxes(-1, -2)
    unit += RIDGE * np.eye(grams.shape[-1])
    return np.linalg.solve(unit, right / scale) / scale
