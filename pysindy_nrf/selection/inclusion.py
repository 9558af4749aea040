"""How often a term and a storey's law are found again on other parts of the data."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pysindy as ps

from ..chain.layout import LawLayout
from ..chain.sites import Site
from ..equations.accumulation import pieces_of
from ..equations.chain_solve import groups_of, solve
from ..equations.normal_equations import NormalEquations
from ..exceptions import NRFError
from ..identification.problem import Problem
from ..records.dataset import Dataset

# Thresholds of PySINDy's STLSQ, shares of a storey's force, among which that is taken
# whose terms on all data are nearest to those chosen.
THRESHOLDS = np.geomspace(0.003, 0.1, 10)
# Ridge of STLSQ: columns have rms one, so it outweighs none.
RIDGE = 1e-8

# By site: which terms are kept.
TermMasks = Mapping[Site, np.ndarray]


@dataclass(frozen=True)
class Draws:
    """Parts of the data on which the terms are looked for again.

    Neighbouring samples of a vibration are nearly copies, so consecutive pieces are
    drawn, not samples.

    Attributes
    ----------
    problem : Problem
    pieces : NormalEquations
        Sums of consecutive pieces of the data.
    """

    problem: Problem
    pieces: NormalEquations
    forced: list[int]
    unknown: list[int]

    @classmethod
    def of(cls, problem: Problem, data: Dataset) -> Draws:
        """Sums of the pieces; the samples are read once."""
        order = problem.solve_order(data.forced, data.unknown)
        layout = problem.layout
        groups = groups_of(layout, order)
        filters = problem.filters(data)
        known = dict(problem.known_masses)
        pieces = pieces_of(data, layout, groups, filters, known)
        return cls(problem, pieces, list(data.forced), list(data.unknown))

    @property
    def layout(self) -> LawLayout:
        """Columns of the entire series."""
        return self.problem.layout

    def masks(self, weights: np.ndarray, threshold: float) -> TermMasks | None:
        """Terms that STLSQ keeps on pieces taken so many times; None if it fails."""
        optimizer = ps.STLSQ(threshold=threshold, alpha=RIDGE)
        problem = replace(self.problem, optimizer=optimizer)
        order = problem.solve_order(self.forced, self.unknown)
        known = dict(problem.known_masses)
        try:
            with warnings.catch_warnings(action="ignore"):
                total = self.pieces.sum(weights)
                coefficients = solve(total, order, known, optimizer).coefficients
        except NRFError:
            return None
        return {site: values != 0 for site, values in coefficients.items()}

    def nearest_threshold(self, chosen: TermMasks) -> float:
        """The threshold whose terms on all data differ least from those chosen."""
        everything = np.ones(len(self.pieces))
        differences = []
        for threshold in THRESHOLDS:
            masks = self.masks(everything, threshold)
            differences.append(np.inf if masks is None else _difference(masks, chosen))
        nearest = np.flatnonzero(differences == np.min(differences))
        return float(THRESHOLDS[nearest[len(nearest) // 2]])

    def weights(
        self, kind: str, n_draws: int, rng: np.random.Generator
    ) -> list[np.ndarray]:
        """How often each piece is taken in each draw."""
        n_pieces = len(self.pieces)
        draws = []
        for _ in range(n_draws):
            if kind == "bagging":
                counts = rng.multinomial(n_pieces, np.full(n_pieces, 1 / n_pieces))
                draws.append(counts.astype(float))
            else:
                half = np.zeros(n_pieces)
                half[rng.permutation(n_pieces)[: n_pieces // 2]] = 1.0
                draws.append(half)
        return draws


def inclusion_table(
    draws: Draws, chosen: TermMasks, n_draws: int, random_state: int | None
) -> pd.DataFrame:
    """Shares of draws in which terms are kept, and storeys keep the terms chosen.

    Returns
    -------
    DataFrame
        By site and term, ``bagging`` and ``stability``; the term ``"all"`` is the
        entire law of the site.
    """
    rng = np.random.default_rng(random_state)
    threshold = draws.nearest_threshold(chosen)
    columns = {}
    for kind in ("bagging", "stability"):
        masks_of_draws = []
        for weights in draws.weights(kind, n_draws, rng):
            masks = draws.masks(weights, threshold)
            if masks is not None:
                masks_of_draws.append(masks)
        columns[kind] = _shares(draws.layout, masks_of_draws, chosen)
    table = pd.DataFrame(columns)
    return table.rename_axis(["site", "term"])


def _shares(
    layout: LawLayout, masks_of_draws: list[TermMasks], chosen: TermMasks
) -> pd.Series:
    """Shares of draws; NaN where no draw could be solved."""
    shares = {}
    for site in layout.acting:
        if site not in chosen:
            continue
        of_draws = np.array([draw[site] for draw in masks_of_draws]).reshape(
            len(masks_of_draws), -1
        )
        for k, label in enumerate(layout.labels(site)):
            shares[str(site), label] = (
                of_draws[:, k].mean() if len(masks_of_draws) else np.nan
            )
        same = (
            (of_draws == chosen[site]).all(axis=1)
            if len(masks_of_draws)
            else np.full(1, np.nan)
        )
        shares[str(site), "all"] = same.mean()
    return pd.Series(shares)


def _difference(masks: TermMasks, chosen: TermMasks) -> int:
    """Terms that stand in one of two choices alone."""
    return sum(int((masks[site] != mask).sum()) for site, mask in chosen.items())
