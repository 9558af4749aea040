"""How the columns of the laws follow from rates and drifts by multiplication."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..laws.base import ForceLaw
from ..laws.shape import Motion
from .sites import Site

if TYPE_CHECKING:
    from .layout import LawLayout

Power = tuple[int, int]

MONOMIAL = re.compile(r"(1|v(\^\d+)?( s(\^\d+)?)?|s(\^\d+)?)\Z")
# Factor of a step that copies a row of the source: ones.
ONES = -1
# Samples on which a law's columns are compared with what its labels say.
_PROBE = Motion(np.array([0.7, -1.3, 0.4]), np.array([-0.6, 0.8, 1.7]))


@dataclass(frozen=True)
class Recipe:
    """Columns v^h s^j, one multiplication each, and columns of other laws.

    The source of a block holds the rates at ``motions``, then the drifts there, then
    the columns of ``others``.

    Attributes
    ----------
    steps : ndarray of shape (n_steps, 3)
        ``(row, x, p)``: row ``row`` is row ``x`` of the source times row ``p`` of the
        result; p = -1 stands for ones. Rows from the number of terms on are helpers.
    motions : tuple of Site
    others : tuple of (Site, int, int)
        Laws, by site and number at the site, whose columns are no products of rates
        and drifts; and how many columns they have.
    n_source : int
        Rows of the source.
    """

    steps: np.ndarray
    motions: tuple[Site, ...]
    others: tuple[tuple[Site, int, int], ...]
    n_source: int

    @property
    def n_rows(self) -> int:
        """Rows that the steps fill, helpers among them."""
        return int(self.steps[:, 0].max(initial=-1)) + 1

    def finish(self, source: np.ndarray, n_terms: int) -> np.ndarray:
        """All columns of a block, one row each."""
        out = np.empty((max(n_terms, self.n_rows), source.shape[1]))
        for row, x, p in self.steps.tolist():
            factor = 1.0 if p == ONES else out[p]
            np.multiply(source[x], factor, out=out[row])
        return out[:n_terms]


def copies(rows: npt.ArrayLike, sources: npt.ArrayLike) -> np.ndarray:
    """Steps that take rows as they stand in the source."""
    targets = np.asarray(rows, dtype=np.int64)
    ones = np.full(len(targets), ONES)
    return np.column_stack([targets, sources, ones]).astype(np.int64)


def recipe_of(layout: LawLayout) -> Recipe:
    """The recipe of all columns of a layout."""
    products = _Products(layout.n_terms)
    others: list[tuple[Site, int, int]] = []
    first_columns: list[int] = []

    for site in layout.acting:
        wanted: dict[Power, int] = {}
        column = layout.slices[site].start
        for number, law in enumerate(layout.laws[site]):
            width = len(law.terms())
            powers = _powers_of_columns(law)
            if powers:
                wanted.update(zip(powers, range(column, column + width)))
            else:
                others.append((site, number, width))
                first_columns.append(column)
            column += width
        if wanted:
            products.add(site, wanted)

    steps = [products.steps()]
    n_source = 2 * len(products.motions)
    for (_, _, width), column in zip(others, first_columns):
        offset = np.arange(width)
        steps.append(copies(column + offset, n_source + offset))
        n_source += width
    return Recipe(
        np.concatenate(steps), tuple(products.motions), tuple(others), n_source
    )


class _Products:
    """Steps that build monomials of rate and drift, site by site."""

    def __init__(self, n_terms: int) -> None:
        self.motions: list[Site] = []
        self._next_helper = n_terms
        # row, number of the site, whether the drift multiplies (or the rate), factor
        self._steps: list[tuple[int, int, bool, int]] = []

    def add(self, site: Site, wanted: dict[Power, int]) -> None:
        """Build monomials at a site, each in its row; helpers where one is missing."""
        rows: dict[Power, int] = {}
        for power in sorted(wanted, key=sum):
            for step in reversed(_down_to(power, rows)):
                below = _one_below(step)
                row = wanted.get(step, self._next_helper)
                if row == self._next_helper:
                    self._next_helper += 1
                factor = rows.get(below, ONES)
                by_drift = step[1] > 0
                self._steps.append((row, len(self.motions), by_drift, factor))
                rows[step] = row
        self.motions.append(site)

    def steps(self) -> np.ndarray:
        """Steps as a recipe has them; rates stand before drifts in the source."""
        count = len(self.motions)
        steps = [
            (row, number + count * by_drift, factor)
            for row, number, by_drift, factor in self._steps
        ]
        return np.array(steps, dtype=np.int64).reshape(-1, 3)


def _one_below(power: Power) -> Power:
    """The monomial with one factor less; the drift is taken off first."""
    h, j = power
    return (h, j - 1) if j else (h - 1, 0)


def _down_to(power: Power, rows: dict[Power, int]) -> list[Power]:
    """A monomial and those below it, down to one that is there or to a single factor.

    A monomial that is there already is left out.
    """
    chain = []
    while sum(power) > 0 and power not in rows:
        chain.append(power)
        power = _one_below(power)
    return chain


def _powers_of_columns(law: ForceLaw) -> Sequence[Power]:
    """Exponents of a law's columns if they are monomials of rate and drift, or none.

    A user's law may call a column "s" and mean another: its own function decides.
    """
    reads_more = (law.has_memory, law.covariates, law.uses_time, law.uses_acceleration)
    if any(reads_more) or law.free_shape:
        return ()

    powers: list[Power] = []
    for term in law.terms():
        power = powers_of(term.label)
        if power is None or sum(power) == 0:
            return ()
        powers.append(power)

    h, j = np.array(powers, dtype=int).reshape(-1, 2).T
    expected = _PROBE.v[:, None] ** h * _PROBE.s[:, None] ** j
    error = np.abs(law.features(_PROBE) - expected)
    return powers if (error <= 1e-12 * np.abs(expected)).all() else ()


def powers_of(label: str) -> Power | None:
    """Exponents (h, j) of a label such as ``"v^2 s"`` or ``"1"``; None for others."""
    if not MONOMIAL.match(label):
        return None

    power = {"v": 0, "s": 0, "1": 0}
    for factor in label.split():
        base, _, exponent = factor.partition("^")
        power[base] = int(exponent or 1)
    return power["v"], power["s"]
