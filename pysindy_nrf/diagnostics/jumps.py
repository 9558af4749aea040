"""Bias of least squares for forces that jump at velocity reversals.

Near a velocity reversal the sign of the rate is unreliable, because of noise or because the samples are too far apart.
Least squares then attributes a part of the jump to other terms. Leaving out the samples near reversals must not change
the coefficient; the threshold rises until further samples change it by no more than chance.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..common.jackknife import variance
from ..exceptions import NRFError, RankWarning
from ..laws.friction import jump_at_reversal
from ..mechanics.sites import Site
from ..regression.chain_solve import groups_of, solve
from ..regression.gram_pass import GramPass
from ..regression.grams import BlockGrams
from ..regression.layout import LawLayout
from ..regression.segments import SegmentSet
from .windows import Window, collect

# Groups of windows whose scatter gives the standard errors.
_GROUPS = 8
# Share of the force of its balance that is negligible.
_NOTHING = 1e-3


def jump_bias_of(
    model: Any, solve_order: Any, data: SegmentSet, band: Any = None, known_masses: Any = None, inner: Any = None
) -> pd.DataFrame:
    """Coefficients of forces that jump, with and without the samples near velocity reversals."""
    diagnostic = JumpBias(model, solve_order, known_masses, inner, silent=band is not None)
    collect(diagnostic.layout, data, band, diagnostic.active)
    return diagnostic.table()


class JumpBias:
    """Gram matrices with and without the samples near velocity reversals, for :func:`jump_bias_of`."""

    def __init__(
        self,
        model: Any,
        solve_order: Any,
        known_masses: Any = None,
        inner: Any = None,
        silent: bool = False,
        layout: LawLayout | None = None,
    ) -> None:
        self.model, self.solve_order, self.known, self.inner = model, solve_order, dict(known_masses or {}), inner
        self.layout = layout or LawLayout(model.chain, model.laws)
        self.places = [] if silent else jumping_terms(self.layout)
        if self.places:
            groups = groups_of(self.layout, solve_order)
            self.whole, *self.kept = (
                GramPass(self.layout, groups, self.known, n_blocks=_GROUPS) for _ in (None, *SHARES)
            )

    @property
    def active(self) -> list[JumpBias]:
        """This diagnostic if any law jumps, else none."""
        return [self] if self.places else []

    def add(self, number: int, window: Window) -> None:
        """Take a window in."""
        self.whole.add(window.block, number % _GROUPS)
        for share, kept in zip(SHARES, self.kept):
            away = np.ones(window.n_samples, dtype=bool)
            for site in {site for site, _, _ in self.places}:
                away &= moving(window.rate(site), share)
            if away.any():
                kept.add(window.block.take(away), number % _GROUPS)

    def _solved(self, total: BlockGrams) -> np.ndarray:
        coefficients = solve(total, self.solve_order, self.known, self.inner).coefficients
        return np.array([coefficients[site][at] for site, at, _ in self.places])

    def _with_chance(self, grams: BlockGrams) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients from all groups of windows, and with each group left out."""
        rest = grams.leave_one_out()
        return self._solved(grams.sum()), np.array([self._solved(rest[g]) for g in range(_GROUPS)])

    def _settling(self, kept: list[BlockGrams]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The same from fewer and fewer samples, as long as they tell all terms apart."""
        for grams in kept:
            try:
                yield self._with_chance(grams)
            except (NRFError, np.linalg.LinAlgError):
                return

    def table(self) -> pd.DataFrame:
        """As :func:`jump_bias_of` returns it; empty where nothing jumps or too few samples are left."""
        empty = pd.DataFrame(columns=["found", "away", "lost", "wrong", "unit"])
        if not self.places:
            return empty
        all_windows, fewer = self.whole.grams(), [kept.grams() for kept in self.kept]
        total = all_windows.sum()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RankWarning)  # the fit has warned
                found, without = self._with_chance(all_windows)
                kept = list(self._settling(fewer))
        except (NRFError, np.linalg.LinAlgError):
            return empty
        whole = _rms(total, self.places)
        told = np.all([acting_there(_rms(grams.sum(), self.places), whole) for grams, _ in zip(fewer, kept)], axis=0)
        if not kept or not told.any():
            return empty
        away, rest = kept[first_settled([a[told] for a, _ in kept], [r[:, told] for _, r in kept])]
        lost = np.where(away, (away - found) / np.where(away, away, 1.0), 0.0)
        size = np.abs(away - found) * _weights(total, self.places, self.model.masses)
        wrong = made_wrong(found, away, rest - without) & (size > _NOTHING)
        values = self.model.coefficients
        rows = [(values[s][k], away[i], lost[i], wrong[i], unit) for i, (s, k, unit) in enumerate(self.places)]
        labels = [f"{site}: {self.layout.labels(site)[at]}" for site, at, _ in self.places]
        return pd.DataFrame(rows, index=labels, columns=empty.columns)[told]


def _rms(total: BlockGrams, places: list[tuple[Site, int, str]]) -> np.ndarray:
    """Of the columns of some terms, in the balances that they act on first."""
    out = []
    for site, at, _ in places:
        dofs = (site.p,)
        column = total.positions(dofs)[0][site].start + at
        out.append(np.sqrt(total.matrices[dofs][column, column] / max(total.sizes[dofs], 1)))
    return np.array(out)


def _weights(total: BlockGrams, places: list[tuple[Site, int, str]], masses: np.ndarray) -> np.ndarray:
    """Force of each term with a coefficient of one, as a share of the applied or inertia force of its balance."""
    out = []
    for site, at, _ in places:
        where, mass_at, target_at = total.positions((site.p,))
        length = np.sqrt(np.diag(total.matrices[site.p,]))
        inertia = 0.0 if mass_at is None else masses[site.p - 1] * length[mass_at]
        balance = max(length[target_at], inertia)
        out.append(length[where[site].start + at] / balance if balance else np.inf)
    return np.array(out)


def sentences_of(table: pd.DataFrame) -> list[str]:
    """Messages on the wrong coefficients in a table of :func:`jump_bias_of`."""
    return [
        f"{name} is {row['found']:.4g} {row['unit']}, but {row['away']:.4g} without the samples near velocity "
        "reversals: noise, or a sampling rate too low for the jump, makes its sign wrong there, and least squares "
        "attributes the difference to other terms. Use estimation='iv'."
        for name, row in table.iterrows()
        if row["wrong"]
    ]


def jumping_terms(layout: LawLayout) -> list[tuple[Site, int, str]]:
    """Terms whose column jumps where the rate changes its sign: site, number there, unit of the coefficient."""
    out = []
    for site in layout.acting:
        at = 0
        for law in layout.laws[site]:
            terms = law.terms()
            if not law.has_memory:
                near, wide = np.abs(jump_at_reversal(law, np.ones(len(law.covariates)))).T
                out += [(site, at + k, term.unit) for k, term in enumerate(terms) if near[k] > 0.5 * wide[k] > 0]
            at += len(terms)
    return out


# Shares of the rms rate below which a sample counts as near standstill, in the order in which they are tried.
SHARES = (0.0, 0.03, 0.1, 0.2, 0.4)
# Samples on each side of a velocity reversal that are left out too.
_BESIDE = 2
# Part of its rms that the column of a force must keep where samples are left out.
_KEPT = 0.1
# Standard errors of a difference that are no longer chance, and the error of a coefficient that is acceptable.
_BEYOND, _WRONG = 3.0, 0.1


def moving(rate: np.ndarray, share: float) -> np.ndarray:
    """Mask of samples away from velocity reversals and faster than a share of the rms rate."""
    out = np.abs(rate) >= share
    reversals = np.flatnonzero(np.diff(np.sign(rate)))
    near = (reversals[:, None] + np.arange(1 - _BESIDE, 1 + _BESIDE)).ravel()
    out[np.clip(near, 0, len(out) - 1)] = False
    return out


def acting_there(kept: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Mask of forces that still act in the samples kept; others cannot be estimated away from standstill."""
    return kept >= _KEPT * whole


def first_settled(found: Sequence[np.ndarray], without: Sequence[np.ndarray]) -> int:
    """Index of the first estimate, each from fewer samples, from which all later ones differ by chance only."""
    for i in range(len(found) - 1):
        apart = [
            _beyond_chance(later - found[i], rest - without[i])
            for later, rest in zip(found[i + 1 :], without[i + 1 :])
        ]
        if not np.any(apart):
            return i
    return len(found) - 1


def made_wrong(found: np.ndarray, away: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Mask of coefficients that differ from those away from standstill by more than a tenth and more than chance."""
    gap = away - found
    return (np.abs(gap) > _WRONG * np.abs(away)) & _beyond_chance(gap, difference)


def _beyond_chance(gap: np.ndarray, parts: np.ndarray) -> np.ndarray:
    return np.abs(gap) > _BEYOND * np.sqrt(variance(parts))
