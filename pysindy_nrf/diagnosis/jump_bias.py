"""Forces that jump at velocity reversals, and the noise that spoils their sign there.

Leaving out the samples near reversals, where the sign of the rate is unreliable, must
not change the coefficient of such a force.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from ..chain.identifiability import SolveOrder
from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.accumulation import ProductSums
from ..equations.chain_solve import groups_of, solve
from ..equations.normal_equations import NormalEquations, variance
from ..exceptions import NRFError, RankWarning
from ..laws.friction import jump_at_reversal
from .sample_windows import Window

# Groups of windows, whose scatter gives the standard errors.
GROUPS = 8
# Shares of the rms rate below which a sample counts as near standstill, in the order in
# which they are tried.
STANDSTILL_SHARES = (0.0, 0.03, 0.1, 0.2, 0.4)
# Samples on each side of a velocity reversal that are left out, too.
SAMPLES_BESIDE_REVERSAL = 2
# Part of its rms that the column of a force must keep where samples are left out.
LEAST_PART_OF_COLUMN = 0.1
# Standard errors of a difference that are no longer chance.
BEYOND_CHANCE = 3.0
# Relative error of a coefficient that is acceptable.
ACCEPTABLE_ERROR = 0.1
# Share of the force of its equation of motion that is negligible.
NEGLIGIBLE_FORCE = 1e-3
# Change of a column over a reversal near zero rate, as a share of that over a wide one,
# above which it jumps.
JUMP = 0.5

COLUMNS = ["found", "away", "lost", "wrong", "unit"]
# Made once: it takes as long as a solve.
_NO_JUMPS = pd.DataFrame(columns=COLUMNS)


@dataclass(frozen=True)
class JumpingTerm:
    """A term whose column jumps where the rate changes its sign."""

    site: Site
    number: int  # at the site
    unit: str  # of its coefficient


def jumping_terms(layout: LawLayout) -> list[JumpingTerm]:
    """Terms of laws without memory whose column jumps at a velocity reversal."""
    jumping = []
    for site in layout.acting:
        first = 0
        for law in layout.laws[site]:
            terms = law.terms()
            if not law.has_memory:
                jumps = jump_at_reversal(law, np.ones(len(law.covariates)))
                near, wide = np.abs(jumps).T
                for k in np.flatnonzero((near > JUMP * wide) & (wide > 0)).tolist():
                    jumping.append(JumpingTerm(site, first + k, terms[k].unit))
            first += len(terms)
    return jumping


def moving(rate: np.ndarray, share: float) -> np.ndarray:
    """Mask of samples away from reversals and faster than a share of the rms rate."""
    is_fast = np.abs(rate) >= share
    reversals = np.flatnonzero(np.diff(np.sign(rate)))
    beside = np.arange(1 - SAMPLES_BESIDE_REVERSAL, 1 + SAMPLES_BESIDE_REVERSAL)
    near = (reversals[:, None] + beside).ravel()
    is_fast[np.clip(near, 0, len(is_fast) - 1)] = False
    return is_fast


@dataclass(frozen=True)
class _Coefficients:
    """Coefficients of the jumping terms from some samples.

    Attributes
    ----------
    all : ndarray of shape (n_terms,)
        From all groups of windows.
    left_out : ndarray of shape (GROUPS, n_terms)
        With each group left out.
    """

    all: np.ndarray
    left_out: np.ndarray

    def of_terms(self, mask: np.ndarray) -> _Coefficients:
        """Those of some terms."""
        return _Coefficients(self.all[mask], self.left_out[:, mask])


class JumpBias:
    """Gram matrices with and without the samples near velocity reversals.

    Parameters
    ----------
    model : ChainModel
    solve_order : SolveOrder
    known_masses : mapping of int to float, optional
    inner : optimizer, optional
        Of the equations, as for :func:`pysindy_nrf.equations.chain_solve.solve`.
    silent : bool
        Whether nothing is judged.
    layout : LawLayout, optional
        Columns of the model's laws.
    """

    def __init__(
        self,
        model: ChainModel,
        solve_order: SolveOrder,
        known_masses: Mapping[int, float] | None = None,
        inner: BaseEstimator | None = None,
        silent: bool = False,
        layout: LawLayout | None = None,
    ) -> None:
        self.model = model
        self.solve_order = solve_order
        self.known = dict(known_masses or {})
        self.inner = inner
        self.layout = layout or LawLayout(model.chain, model.laws)
        self.terms = [] if silent else jumping_terms(self.layout)
        if self.terms:
            self.all_samples = self._empty_pass()
            self.moving = [self._empty_pass() for _ in STANDSTILL_SHARES]

    def _empty_pass(self) -> ProductSums:
        groups = groups_of(self.layout, self.solve_order)
        return ProductSums(self.layout, groups, self.known, n_blocks=GROUPS)

    @property
    def active(self) -> list[JumpBias]:
        """This diagnostic if any law jumps, else none."""
        return [self] if self.terms else []

    def add(self, number: int, window: Window) -> None:
        """Take a window in, which goes to a group by its number."""
        group = number % GROUPS
        self.all_samples.add(window.block, group)

        sites = {term.site for term in self.terms}
        for share, moving_pass in zip(STANDSTILL_SHARES, self.moving):
            away = np.ones(window.n_samples, dtype=bool)
            for site in sites:
                away &= moving(window.rate(site), share)
            if away.any():
                moving_pass.add(window.block.take(away), group)

    def table(self) -> pd.DataFrame:
        """Coefficients with and without the samples near reversals.

        Returns
        -------
        DataFrame
            ``jump_bias_`` of a regressor, by term: the coefficient of the fit (found)
            and that away from reversals (away), the share that is lost, and whether the
            first is wrong; empty where nothing jumps or too few samples are left.
        """
        if not self.terms:
            return _NO_JUMPS.copy()
        grams = self.all_samples.grams()
        fewer = [moving_pass.grams() for moving_pass in self.moving]

        # the fit has warned
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            from_all = self._solved(grams)
            if from_all is None:
                return _NO_JUMPS.copy()
            away = self._solved_one_by_one(fewer)
        total = grams.sum()
        determined = self._determined(total, fewer[: len(away)])
        if not away or not determined.any():
            return _NO_JUMPS.copy()
        number = first_settled([estimate.of_terms(determined) for estimate in away])
        return self._compared(total, from_all, away[number])[determined]

    def _solved(self, grams: NormalEquations) -> _Coefficients | None:
        """Coefficients of the jumping terms; None if they cannot be solved for."""
        left_out = grams.leave_one_out()
        try:
            estimate = self._jumping_coefficients(grams.sum())
            others = [self._jumping_coefficients(left_out[g]) for g in range(GROUPS)]
        except (NRFError, np.linalg.LinAlgError):
            return None
        return _Coefficients(estimate, np.array(others))

    def _jumping_coefficients(self, total: NormalEquations) -> np.ndarray:
        solution = solve(total, self.solve_order, self.known, self.inner)
        values = []
        for term in self.terms:
            values.append(solution.coefficients[term.site][term.number])
        return np.array(values)

    def _solved_one_by_one(
        self, choices: Sequence[NormalEquations]
    ) -> list[_Coefficients]:
        """Solutions from fewer and fewer samples, while they determine all terms."""
        solutions: list[_Coefficients] = []
        for sums in choices:
            solution = self._solved(sums)
            if solution is None:
                break
            solutions.append(solution)
        return solutions

    def _determined(
        self, total: NormalEquations, fewer: Sequence[NormalEquations]
    ) -> np.ndarray:
        """Mask of terms that act in the samples away from standstill, too."""
        least = LEAST_PART_OF_COLUMN * self._rms_of_columns(total)
        determined = np.ones(len(self.terms), dtype=bool)
        for grams in fewer:
            determined &= self._rms_of_columns(grams.sum()) >= least
        return determined

    def _rms_of_columns(self, total: NormalEquations) -> np.ndarray:
        """Rms of the columns of the terms, in the equations they enter with +."""
        rms = []
        for term in self.terms:
            dofs = (term.site.p,)
            slices, _, _ = total.positions(dofs)
            k = slices[term.site].start + term.number
            mean = total.matrices[dofs][k, k] / max(total.sizes[dofs], 1)
            rms.append(np.sqrt(mean))
        return np.array(rms)

    def _shares_of_force(self, total: NormalEquations) -> np.ndarray:
        """Force of each term with a coefficient of one, over that of its equation."""
        shares = []
        for term in self.terms:
            dofs = (term.site.p,)
            slices, mass_at, target_at = total.positions(dofs)
            length = np.sqrt(np.diag(total.matrices[dofs]))
            force = length[target_at]
            if mass_at is not None:
                mass = self.model.masses[term.site.p - 1]
                force = max(force, mass * length[mass_at])
            column = length[slices[term.site].start + term.number]
            shares.append(column / force if force else np.inf)
        return np.array(shares)

    def _compared(
        self, total: NormalEquations, from_all: _Coefficients, away: _Coefficients
    ) -> pd.DataFrame:
        """Coefficients from all samples and from those away from standstill."""
        change = away.all - from_all.all
        lost = np.where(away.all, change / np.where(away.all, away.all, 1.0), 0.0)
        is_large = np.abs(change) > ACCEPTABLE_ERROR * np.abs(away.all)
        is_sure = _is_beyond_chance(change, away.left_out - from_all.left_out)
        force = np.abs(change) * self._shares_of_force(total)
        wrong = is_large & is_sure & (force > NEGLIGIBLE_FORCE)

        rows = []
        names = []
        values = self.model.coefficients
        for k, term in enumerate(self.terms):
            value = values[term.site][term.number]
            rows.append((value, away.all[k], lost[k], wrong[k], term.unit))
            names.append(f"{term.site}: {self.layout.labels(term.site)[term.number]}")
        return pd.DataFrame(rows, index=names, columns=COLUMNS)


def first_settled(estimates: Sequence[_Coefficients]) -> int:
    """First estimate from which those of fewer samples differ by chance alone."""
    number = 0
    while _differs_from_any(estimates[number], estimates[number + 1 :]):
        number += 1
    return number


def _differs_from_any(estimate: _Coefficients, others: Sequence[_Coefficients]) -> bool:
    """Whether some coefficients differ by more than chance."""
    for other in others:
        gap = other.all - estimate.all
        if _is_beyond_chance(gap, other.left_out - estimate.left_out).any():
            return True
    return False


def _is_beyond_chance(gap: np.ndarray, left_out: np.ndarray) -> np.ndarray:
    """Mask of differences that are larger than chance, by their jackknife."""
    return np.abs(gap) > BEYOND_CHANCE * np.sqrt(variance(left_out))


def sentences_of(table: pd.DataFrame) -> list[str]:
    """Messages on the wrong coefficients in a table of :class:`JumpBias`."""
    sentences = []
    for name, row in table[table["wrong"].astype(bool)].iterrows():
        sentences.append(
            f"{name} is {row['found']:.4g} {row['unit']}, but {row['away']:.4g} without"
            " the samples near velocity reversals: noise, or a sampling rate too low"
            " for the jump, makes its sign wrong there, and least squares attributes"
            " the difference to other terms. Use estimation='iv'."
        )
    return sentences
