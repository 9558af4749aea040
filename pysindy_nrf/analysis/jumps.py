"""What least squares takes from a force that jumps where the motion turns.

The sign of a rate is wrong next to the instants at which the motion turns: by noise, and where the samples are too far
apart for the jump. Least squares gives what such a column loses to the terms beside it. The samples next to the
turns tell how much: without them the coefficient must be the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from ..chain_solve import groups_of, solve
from ..exceptions import NRFError, RankWarning
from ..laws.jumps import across_rest
from ..layout import LawLayout
from ..leaving_out import variance
from ..moments import Block, Moments
from ..segments import SegmentSet
from ..sites import Site
from .bias import windows

# Samples on each side of a turn that are left out.
_BESIDE = 2
# Groups of windows whose scatter says what is chance, and how many standard errors are none.
_GROUPS, _BEYOND = 8, 3.0
# Share of a coefficient that an engineer allows.
_WRONG = 0.1


def jump_bias_of(
    model: Any, walk: Any, data: SegmentSet | None, band: Any = None, known_masses: Any = None, inner: Any = None
) -> pd.DataFrame:
    """Coefficients of forces that jump, with and without the samples next to the turns of the motion.

    Parameters
    ----------
    model : ChainModel
        By least squares.
    walk : Walk
    data : SegmentSet or None
        Nothing is said without.
    band : (float, float) or None
        Hz; a filter spreads every jump, and nothing is said then.
    known_masses : mapping of int to float, optional
        kg.
    inner : PySINDy optimizer, optional

    Returns
    -------
    DataFrame
        Index = term, e.g. ``"storey 2: sgn(v)"``; ``found``, ``away`` (from some thousand samples, without those next
        to a turn), ``lost`` (share of ``away``), ``wrong`` (bool: by more than a tenth and more than chance), ``unit``.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.analysis.jumps import jump_bias_of
    >>> storey = [laws.LinearElastic(1e5), laws.LinearViscous(60.0), laws.CoulombFriction(20.0)]
    >>> F = excitation.band_limited_random(1, 10.0, 2000.0, dofs=1, rms=200.0, band=(1, 30), random_state=0)
    >>> record = simulate(ChainModel([10.0], {"storey 1": storey}), F, 1 / 2000)
    >>> model = NRFRegressor(laws={"storey 1": storey}).fit(record)  # samples close enough, and no noise
    >>> model.jump_bias_["away"].round(1).to_dict(), model.jump_bias_["wrong"].tolist()
    ({'storey 1: sgn(v)': 20.0}, [False])
    """
    layout = LawLayout(model.chain, model.laws)
    places = [] if band is not None or data is None else jumping_terms(layout)
    columns = ["found", "away", "lost", "wrong", "unit"]
    if not places or data is None:
        return pd.DataFrame(columns=columns)
    sites = {site for site, _, _ in places}
    known = dict(known_masses or {})
    whole, kept = ([Moments(layout, groups_of(layout, walk), known_masses=known) for _ in range(_GROUPS)] for _ in "ab")
    for i, (terms, offered, a, force) in enumerate(windows(layout, data, None)):
        away = np.ones(a.shape[1], dtype=bool)
        for site in sites:  # the first column offered is the sign of the rate
            turns = np.flatnonzero(np.diff(offered[site][0]))
            near = (turns[:, None] + np.arange(1 - _BESIDE, 1 + _BESIDE)).ravel()
            away[np.clip(near, 0, len(away) - 1)] = False
        whole[i % _GROUPS].add(Block(terms, a, force))
        if away.any():
            kept[i % _GROUPS].add(Block(terms[:, away], a[:, away], force[:, away]))

    def solved(parts: list[Moments], chosen: Iterable[int]) -> np.ndarray:
        total = parts[0].empty()
        for g in chosen:
            total.merge(parts[g])
        coefficients = solve(total, walk, known, inner).coefficients
        return np.array([coefficients[site][at] for site, at, _ in places])

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RankWarning)  # the fit has said so
            out = [solved(side, range(_GROUPS)) for side in (whole, kept)]
            rest = [[g for g in range(_GROUPS) if g != left] for left in range(_GROUPS)]
            difference = [solved(kept, some) - solved(whole, some) for some in rest]
    except (NRFError, np.linalg.LinAlgError):  # too few samples are left
        return pd.DataFrame(columns=columns)
    chance = np.sqrt(variance(difference))
    gap, away_from = out[1] - out[0], out[1]
    lost = np.where(away_from, gap / np.where(away_from, away_from, 1.0), 0.0)
    wrong = (np.abs(lost) > _WRONG) & (np.abs(gap) > _BEYOND * chance)
    values = model.coefficients
    found = [values[site][at] for site, at, _ in places]
    labels = [f"{site}: {layout.labels(site)[at]}" for site, at, _ in places]
    table = {"found": found, "away": away_from, "lost": lost, "wrong": wrong, "unit": [unit for _, _, unit in places]}
    return pd.DataFrame(table, index=labels)


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
                near, wide = np.abs(across_rest(law, np.ones(len(law.covariates)))).T
                out += [(site, at + k, term.unit) for k, term in enumerate(terms) if near[k] > 0.5 * wide[k] > 0]
            at += len(terms)
    return out
