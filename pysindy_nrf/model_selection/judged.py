"""Held-out scores of one candidate on one fold, from moments; the same numbers as the scorers give."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..chain_solve import Solution
from ..errors import Pooled, balance_sizes, pooled_error
from ..exceptions import NRFError
from ..free_run import free_run_error
from ..moments import Moments
from ..segments import BlockRows
from ..solved import model_of
from .fold_moments import FoldMoments, Order

# Residual, as a share of the reference, below which a Gram matrix no longer holds it to ten digits.
CLEAN = 1e-3


class DigitsLost(Exception):
    """A residual is too small to be read off a Gram matrix."""


@dataclass
class Heldout:
    """Moments of the held-out side of a fold, sums and counts of its accelerations, and what the rest says."""

    moments: Moments
    sums: np.ndarray
    counts: np.ndarray
    solution: Solution
    fold: int


def on_folds(fold_moments: FoldMoments, order: Order, scorings: Iterable[str]) -> dict[str, np.ndarray]:
    """Scores of one candidate on all folds.

    Parameters
    ----------
    fold_moments : FoldMoments
    order : Order
    scorings : iterable of {"balance", "acceleration", "free_run"}

    Returns
    -------
    dict of str to ndarray of shape (n_folds,)
        Greater is better; NaN where a fit failed, as in GridSearchCV.

    Raises
    ------
    DigitsLost
    """
    scores = {name: np.full(fold_moments.n_folds, np.nan) for name in scorings}
    for fold in range(fold_moments.n_folds):
        try:
            solution, walk, _ = fold_moments.fit(order, fold)
        except NRFError:
            continue
        test, sums, counts = fold_moments.total(fold, "test")
        held = Heldout(fold_moments.cut(test, order, order.groups(walk)), sums, counts, solution, fold)
        if fold_moments.kind == "gram":
            _require_digits(held)
        for name, values in scores.items():
            values[fold] = _SCORES[name](fold_moments, order, held)
    return scores


def balances_on_folds(fold_moments: FoldMoments, order: Order, dofs: Iterable[int]) -> np.ndarray:
    """Pooled error of some balances on all folds, percent NRMSE; infinite where a fit failed."""
    errors = np.full(fold_moments.n_folds, np.inf)
    for fold in range(fold_moments.n_folds):
        try:
            solution, walk, _ = fold_moments.fit(order, fold)
        except NRFError:
            continue
        test = fold_moments.cut(fold_moments.total(fold, "test")[0], order, order.groups(walk))
        pooled = Pooled()
        for j in dofs:
            sizes = balance_sizes(j, solution.masses, solution.coefficients, test)
            if sizes is not None:
                pooled.add(sizes)
        errors[fold] = pooled.percent
    return errors


def _balance(fold_moments: FoldMoments, order: Order, held: Heldout) -> float:
    return -pooled_error(held.solution.masses, held.solution.coefficients, held.moments)


def _acceleration(fold_moments: FoldMoments, order: Order, held: Heldout) -> float:
    left = error = 0.0
    for j in range(1, order.layout.n_dof + 1):
        part = held.moments.parts[(j,)]
        if part.n_samples:
            own = np.zeros(part.matrix.shape[1])
            own[held.moments.positions((j,))[1]] = 1.0
            error += (part.norm(residual_weights(held.moments, held.solution, (j,))) / held.solution.masses[j]) ** 2
            left += part.norm(own) ** 2 - held.sums[j - 1] ** 2 / held.counts[j - 1]
    return 1.0 - error / left if left else float("nan")


def residual_weights(moments: Moments, solution: Solution, dofs: tuple[int, ...]) -> np.ndarray:
    """Weights of the columns of one balance, or of several summed, whose sum is the residual."""
    where, mass_at, target_at = moments.positions(dofs)
    group = moments.groups[dofs]
    weights = np.zeros(moments.parts[dofs].matrix.shape[1])
    for site, sign in zip(group.sites, group.signs):
        weights[where[site]] = sign * solution.coefficients[site]
    if mass_at is not None:
        weights[mass_at] = solution.masses[dofs[0]]
    weights[target_at] = -1.0
    return weights


def _require_digits(held: Heldout) -> None:
    for j in range(1, held.moments.layout.n_dof + 1):
        sizes = balance_sizes(j, held.solution.masses, held.solution.coefficients, held.moments)
        if sizes is not None and sizes.residual < CLEAN * sizes.reference:
            raise DigitsLost


def _free_run(fold_moments: FoldMoments, order: Order, held: Heldout) -> float:
    error = free_run_error(model_of(order.layout, held.solution), fold_moments, _runs(fold_moments, held.fold))
    return -error if np.isfinite(error) else float("nan")


def _runs(fold_moments: FoldMoments, fold: int) -> list[BlockRows]:
    """Contiguous held-out rows, record by record."""
    out = []
    for i, seg in enumerate(fold_moments.data.segments):
        held = fold_moments.membership[fold_moments.class_of[seg.rows][seg.valid], fold] == 2
        edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
        out += [BlockRows(i, slice(int(lo), int(hi))) for lo, hi in zip(edges[::2], edges[1::2])]
    return out


_SCORES: dict[str, Any] = {"balance": _balance, "acceleration": _acceleration, "free_run": _free_run}
SCORINGS = tuple(_SCORES)
