"""What least squares takes from a force that jumps where the motion turns.

The sign of a rate is wrong next to the instants at which the motion turns: by noise, and where the samples are too far
apart for the jump. Least squares gives what such a column loses to the terms beside it. The samples next to the
turns tell how much: without them the coefficient must be the same. How slow a sample must be to count as next to a
turn, the noise decides: as many are left out as change the coefficient by more than chance.
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
from .windows import Window, show

# Groups of windows whose scatter says what is chance.
_GROUPS = 8
# Share of the force of its balance that is nothing to an engineer.
_NOTHING = 1e-3


def jump_bias_of(
    model: Any, walk: Any, data: SegmentSet, band: Any = None, known_masses: Any = None, inner: Any = None
) -> pd.DataFrame:
    """Coefficients of forces that jump, with and without the samples next to the turns of the motion."""
    judge = JumpBias(model, walk, known_masses, inner, silent=band is not None)
    show(judge.layout, data, band, judge.asked)
    return judge.table()


class JumpBias:
    """Collects what :func:`jump_bias_of` needs to know of some windows.

    Parameters
    ----------
    model, walk, known_masses, inner
        As for :func:`jump_bias_of`.
    silent : bool
        Say nothing, whatever the laws: of filtered columns and of estimates that are not least squares.
    layout : LawLayout, optional
        Of the laws of the model, if it is at hand.
    """

    def __init__(
        self,
        model: Any,
        walk: Any,
        known_masses: Any = None,
        inner: Any = None,
        silent: bool = False,
        layout: LawLayout | None = None,
    ) -> None:
        self.model, self.walk, self.known, self.inner = model, walk, dict(known_masses or {}), inner
        self.layout = layout or LawLayout(model.chain, model.laws)
        self.places = [] if silent else jumping_terms(self.layout)
        if self.places:
            groups = groups_of(self.layout, walk)
            self.whole, *self.kept = (
                GramPass(self.layout, groups, self.known, n_blocks=_GROUPS) for _ in (None, *SHARES)
            )

    @property
    def asked(self) -> list[JumpBias]:
        """This judge, if any law jumps; nobody otherwise."""
        return [self] if self.places else []

    def see(self, number: int, window: Window) -> None:
        """Take a window in."""
        self.whole.add(window.block, number % _GROUPS)
        for share, kept in zip(SHARES, self.kept):
            away = np.ones(window.n_samples, dtype=bool)
            for site in {site for site, _, _ in self.places}:
                away &= moving(window.rate(site), share)
            if away.any():
                kept.add(window.block.take(away), number % _GROUPS)

    def _solved(self, total: BlockGrams) -> np.ndarray:
        coefficients = solve(total, self.walk, self.known, self.inner).coefficients
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
                warnings.simplefilter("ignore", RankWarning)  # the fit has said so
                found, without = self._with_chance(all_windows)
                kept = list(self._settling(fewer))
        except (NRFError, np.linalg.LinAlgError):
            return empty
        whole = _rms(total, self.places)
        told = np.all([lives_there(_rms(grams.sum(), self.places), whole) for grams, _ in zip(fewer, kept)], axis=0)
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
    """What a table of :func:`jump_bias_of` says to an engineer."""
    return [
        f"{name} is {row['found']:.4g} {row['unit']}, but {row['away']:.4g} without the samples next to the turns of "
        "the motion: noise, or a sampling rate too low for the jump, turns its sign there, and least squares gives "
        "what is lost to other terms. Use estimation='iv'."
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


# Shares of the rms rate below which a sample counts as next to rest, in the order in which they are tried.
SHARES = (0.0, 0.03, 0.1, 0.2, 0.4)
# Samples on each side of a turn that are left out with them.
_BESIDE = 2
# Part of its rms that the column of a force must keep where samples are left out.
_LIVES = 0.1
# Standard errors of a difference that are no longer chance, and the share of a coefficient that an engineer allows.
_BEYOND, _WRONG = 3.0, 0.1


def moving(rate: np.ndarray, share: float) -> np.ndarray:
    """Samples away from the turns of a motion, and faster than a share of its rms rate."""
    out = np.abs(rate) >= share
    turns = np.flatnonzero(np.diff(np.sign(rate)))
    near = (turns[:, None] + np.arange(1 - _BESIDE, 1 + _BESIDE)).ravel()
    out[np.clip(near, 0, len(out) - 1)] = False
    return out


def lives_there(kept: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Which forces still act in the samples that are left; what rises only next to rest is not told by the others."""
    return kept >= _LIVES * whole


def first_settled(found: Sequence[np.ndarray], without: Sequence[np.ndarray]) -> int:
    """The first of several estimates, each from fewer samples, from which none of the later ones differs but by
    chance.
    """
    for i in range(len(found) - 1):
        apart = [
            _beyond_chance(later - found[i], rest - without[i])
            for later, rest in zip(found[i + 1 :], without[i + 1 :])
        ]
        if not np.any(apart):
            return i
    return len(found) - 1


def made_wrong(found: np.ndarray, away: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Which coefficients from all samples differ from those away from rest by more than a tenth, and than chance."""
    gap = away - found
    return (np.abs(gap) > _WRONG * np.abs(away)) & _beyond_chance(gap, difference)


def _beyond_chance(gap: np.ndarray, parts: np.ndarray) -> np.ndarray:
    return np.abs(gap) > _BEYOND * np.sqrt(variance(parts))
