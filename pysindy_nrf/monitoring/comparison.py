"""An explanation of the difference between two tests, in numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..common.unit_system import TRANSLATION, UnitSystem
from ..diagnosis.stiffness_change import StiffnessChange
from .differences import Difference, Differences, without_repetition
from .explanations import Explanation, ExplanationSearch, unknowns_of
from .force_change import surfaces

# Standard errors to either side that hold 95 %.
OF_95_PERCENT = 1.96
_WORDS = {
    "k": "stiffness",
    "c": "damping",
    "k3": "cubic spring",
    "Fc": "friction",
    "c2": "quadratic damping",
    "k2": "asymmetry of the spring",
    "gap": "gap",
    "m": "mass",
    "gain": "gain",
    "shape": "shape of the declared law",
}


def in_words(terms: str) -> str:
    """What changed, as a sentence begins with it."""
    words = []
    for term in terms.split(" + "):
        word = _WORDS.get(term.split()[0])
        words.append(word or term.removeprefix("own "))
    text = " and ".join(dict.fromkeys(words))
    return text[0].upper() + text[1:]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two tests, and the changes that explain their difference.

    Parameters
    ----------
    differences : Differences
    changes : tuple of Change
    units : UnitSystem
        Of the models.
    """

    differences: Differences
    changes: Explanation
    units: UnitSystem = TRANSLATION

    @property
    def used(self) -> list[int]:
        """Unknowns in use: departures of masses, and the changes."""
        return self.differences.always + unknowns_of(self.changes)

    def masses_of_tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Masses of both tests, kg."""
        return self.differences.masses_of_tests(unknowns_of(self.changes))

    @property
    def gain_of_forces(self) -> float:
        """Gain of the force sensors in the second test over that in the first."""
        values = self.differences.solved(self.used)[0]
        for unknown, value in zip(self.used, values):
            if self.differences.unknowns[unknown].is_gain:
                return float(1.0 / (1.0 - value))
        return 1.0

    def same(self, place: str, term: str, level: float) -> bool:
        """Whether no difference of a storey's term is significant, however small."""
        names = (Difference(place, term), Difference(place, f"own {term}"))
        unknowns = self.differences.unknowns
        asked = [i for i, name in enumerate(unknowns) if name in names]
        search = ExplanationSearch(self.differences, level, 0.0)
        return bool(asked) and search.best(self.changes, asked) is None

    def error_of_shape(self, place: str) -> float:
        """Standard error of the difference of shape parameters, as a share of it."""
        name = Difference(place, "shape")
        if name not in self.differences.unknowns:
            return np.nan
        unknown = self.differences.unknowns.index(name)
        used = without_repetition(self.used + [unknown])
        values = self.differences.solved(used)[:, used.index(unknown)]
        return float(np.sqrt(self.differences.variance(values)))

    def map(
        self, place: str, v: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """Change of a storey's force at points.

        Parameters
        ----------
        place : str
        v, s : ndarray of shape (n_points,)
            m/s and m.

        Returns
        -------
        change, error : ndarray of shape (n_points,)
            N; the standard error.
        n_terms : int
            Terms that the change has.
        """
        unit = self.differences.cut(place).domain.unit
        unknowns = self.differences.unknowns
        linear = (Difference(place, "k"), Difference(place, "c"))
        used = self.used + [i for i, name in enumerate(unknowns) if name in linear]
        used = without_repetition(used)
        values = self.differences.by_term(used, self.differences.solved(used))
        at_points = surfaces(v / unit[0], s / unit[1])

        columns = []
        shown = []
        for unknown, of_term in values.items():
            name = unknowns[unknown]
            if name.place == place and name.term in at_points:
                columns.append(of_term)
                shown.append(at_points[name.term])
        forces = np.column_stack(columns) @ np.array(shown)
        error = np.sqrt(self.differences.variance(forces))
        return forces[0], error, len(shown)

    def table(self) -> pd.DataFrame:
        """What changed, place by place, the largest first.

        Columns ``place``, ``term``, ``change`` and ``error`` (%), ``amount``, ``unit``
        (N rms or kg) and ``p``.
        """
        unknowns = self.differences.unknowns
        values = self._values
        rows = []
        for place in dict.fromkeys(unknowns[unknown].place for unknown in values):
            here = [unknown for unknown in values if unknowns[unknown].place == place]
            of_place = np.column_stack([values[unknown] for unknown in here])
            rows.append(self._row(place, here, of_place))
        columns = ["place", "term", "change", "error", "amount", "unit", "p"]
        table = pd.DataFrame(rows, columns=columns)
        # changes by one factor stay in the order of their places
        order = np.argsort(-table["change"].abs().round(9), kind="stable")
        return table.iloc[order].reset_index(drop=True)

    def stiffness_changes(self) -> list[StiffnessChange]:
        """Storeys whose linear stiffness changed, and by how much."""
        changes = []
        for unknown, values in self._values.items():
            name = self.differences.unknowns[unknown]
            if name.term != "k":
                continue
            cut = self.differences.cut(name.place)
            size = cut.size(["k"], values[:, None])
            change = float(np.sign(values[0] * cut.stiffness) * size[0])
            reach = OF_95_PERCENT * float(np.sqrt(self.differences.variance(size)))
            changes.append(
                StiffnessChange(name.place, change, change - reach, change + reach)
            )
        return changes

    @property
    def _values(self) -> dict[int, np.ndarray]:
        """Values of all terms that changed: from all blocks, and without each."""
        solved = self.differences.solved(self.used)
        n_always = len(self.differences.always)
        return self.differences.by_term(self.used[n_always:], solved[:, n_always:])

    def _row(
        self, place: str, here: Sequence[int], values: np.ndarray
    ) -> dict[str, object]:
        """One row of the table: the changes of one place."""
        differences = self.differences
        terms = [differences.unknowns[unknown].term for unknown in here]
        size = self._size(here, values)
        first = values[0, 0]
        name = differences.unknowns[here[0]]
        unit = "N rms"
        if name.is_mass:
            of_one_percent = self._mass_before(place) / 100
            unit = "kg"
        elif name.is_gain:
            of_one_percent = differences.cuts[0].applied / 100
        else:
            cut = differences.cut(place)
            of_one_percent = cut.spring / 100
            if terms[0] == "k":  # against a stiffness that may be negative
                first *= cut.stiffness
        return {
            "place": place,
            "term": " + ".join(terms),
            "change": np.sign(first) * size[0],
            "error": float(np.sqrt(differences.variance(size))),
            "amount": size[0] * of_one_percent,
            "unit": self.units.of(unit),
            "p": self._probability(here),
        }

    def _size(self, here: Sequence[int], values: np.ndarray) -> np.ndarray:
        """Changes at one place, percent of its spring's force, mass or gain."""
        names = [self.differences.unknowns[unknown] for unknown in here]
        if names[0].is_gain:
            return 100 * np.abs(1.0 / (1.0 - values[:, 0]) - 1.0)
        if names[0].is_mass:
            return 100 * np.abs(values[:, 0]) / self._mass_before(names[0].place)
        cut = self.differences.cut(names[0].place)
        return cut.size([name.term for name in names], values)

    def _mass_before(self, place: str) -> float:
        """Mass of a DOF in the first test, kg."""
        return float(self.masses_of_tests()[0][int(place.removeprefix("dof ")) - 1])

    def _probability(self, here: Sequence[int]) -> float:
        """The least probability of the changes that some unknowns stand for."""
        probabilities = []
        for change in self.changes:
            if not set(here).isdisjoint(self.differences.parts(change.unknown)):
                probabilities.append(change.probability)
        return min(probabilities)
