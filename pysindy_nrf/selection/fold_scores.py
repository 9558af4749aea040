"""Errors on held-out folds and information criteria, from the Gram matrices of all folds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..regression.chain_solve import Solution, StepFit
from ..regression.errors import balance_sizes, free_run_error, pooled_error, pooled_percent
from ..regression.grams import BlockGrams
from ..regression.segments import BlockRows
from ..regression.solution import model_of
from .fold_moments import EVERY, FoldMoments, Order
from .one_se_rule import FLOOR

# Residual, as a share of the reference, below which a Gram matrix no longer holds it to ten digits.
CLEAN = 1e-3


class DigitsLost(Exception):
    """A residual is too small to be read off a Gram matrix."""


@dataclass
class Heldout:
    """Roots of the held-out side of a fold, sums and counts of its accelerations, and what the rest says."""

    grams: BlockGrams
    sums: np.ndarray
    counts: np.ndarray
    solution: Solution
    fold: Any


def _held_out(fold_moments: FoldMoments, order: Order) -> Iterator[tuple[Heldout, Any]]:
    """All folds at once, or one by one where they differ too much or one of them fails; and where they stand."""

    def one(fold: Any) -> Heldout:
        solution, solve_order, _ = fold_moments.fit(order, fold)
        test, sums, counts = fold_moments.total(fold, "test")
        return Heldout(fold_moments.cut(test, order, order.groups(solve_order)), sums, counts, solution, fold)

    try:
        yield one(EVERY), slice(None)
        return
    except NRFError:
        pass
    for fold in range(fold_moments.n_folds):
        try:
            yield one(fold), fold
        except NRFError:
            continue


def on_folds(fold_moments: FoldMoments, order: Order, scorings: Iterable[str]) -> dict[str, np.ndarray]:
    """Scores of one candidate on all folds."""
    scores = {name: np.full(fold_moments.n_folds, np.nan) for name in scorings}
    for held, where in _held_out(fold_moments, order):
        if fold_moments.kind == "gram":
            _require_digits(held)
        for name, values in scores.items():
            values[where] = _SCORES[name](fold_moments, order, held)
    return scores


def balances_on_folds(fold_moments: FoldMoments, order: Order, dofs: Iterable[int]) -> np.ndarray:
    """Pooled error of some balances on all folds, percent NRMSE; infinite where a fit failed."""
    errors = np.full(fold_moments.n_folds, np.inf)
    for held, where in _held_out(fold_moments, order):
        found = held.solution.masses, held.solution.coefficients, held.grams
        errors[where] = pooled_percent(balance_sizes(j, *found) for j in dofs)
    return errors


def _balance(fold_moments: FoldMoments, order: Order, held: Heldout) -> Any:
    return -pooled_error(held.solution.masses, held.solution.coefficients, held.grams)


def _acceleration(fold_moments: FoldMoments, order: Order, held: Heldout) -> Any:
    left = error = np.zeros(held.grams.shape)
    for j in range(1, order.layout.n_dof + 1):
        if np.any(held.grams.sizes[j,]):
            # of the residual, of the acceleration
            weights = np.zeros((*left.shape, held.grams.matrices[j,].shape[-1], 2))
            weights[..., 0] = residual_weights(held.grams, held.solution, (j,))
            weights[..., held.grams.positions((j,))[1], 1] = 1.0
            residual, own = np.moveaxis(held.grams.norms((j,), weights), -1, 0)
            error = error + (residual / held.solution.masses[j]) ** 2
            left = left + own**2 - held.sums[..., j - 1] ** 2 / held.counts[..., j - 1]
    return 1.0 - np.divide(error, left, out=np.full(left.shape, np.nan), where=left != 0)


def residual_weights(grams: BlockGrams, solution: Solution, dofs: tuple[int, ...]) -> np.ndarray:
    """Weights of the columns of one balance, or of several summed, whose sum is the residual."""
    where, mass_at, target_at = grams.positions(dofs)
    group = grams.groups[dofs]
    weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1]))
    for site, sign in zip(group.sites, group.signs):
        weights[..., where[site]] = sign * solution.coefficients[site]
    if mass_at is not None:
        weights[..., mass_at] = solution.masses[dofs[0]]
    weights[..., target_at] = -1.0
    return weights


def _require_digits(held: Heldout) -> None:
    for j in range(1, held.grams.layout.n_dof + 1):
        sizes = balance_sizes(j, held.solution.masses, held.solution.coefficients, held.grams)
        if sizes is not None and np.any(sizes.residual < CLEAN * sizes.reference):
            raise DigitsLost


def _free_run(fold_moments: FoldMoments, order: Order, held: Heldout) -> Any:
    if held.fold == EVERY:
        return [
            _free_run(fold_moments, order, replace(held, solution=held.solution.of(fold), fold=fold))
            for fold in range(fold_moments.n_folds)
        ]
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


def information(fits: list[StepFit], grams: BlockGrams, shares: dict[tuple[int, ...], float]) -> tuple[float, float]:
    r"""Akaike's and Schwarz's criterion of a chain, summed over the steps of its solve."""
    aic = bic = 0.0
    for fit in fits:
        dofs = fit.step.dofs
        seen = grams.sizes[dofs] if dofs in grams.groups else grams.n_samples
        size = max(seen * shares.get(dofs, 1.0), 2.0)
        level = 2.0 * size * np.log(max(fit.share, FLOOR) * fit.residual / fit.share if fit.share else FLOOR)
        aic += level + 2.0 * fit.n_columns
        bic += level + np.log(size) * fit.n_columns
    return float(aic), float(bic)


def independent_shares(fold_moments: FoldMoments, order: Order) -> dict[tuple[int, ...], float]:
    r"""Independent samples in the residual of each balance, as a share of its samples."""
    solution, solve_order, grams = fold_moments.fit(order, None)
    shares = {}
    for dofs in grams.groups:
        square, size = fold_moments.piece_norms(order, dofs, residual_weights(grams, solution, dofs))
        held = size > 0
        if held.sum() < 4:
            continue
        square = square[held]
        size, whole = size[held], square.sum() / size[held].sum()
        spread = np.average((square / size / whole - 1.0) ** 2, weights=size) if whole > 0 else 0.0
        shares[dofs] = float(np.clip(2.0 / (spread * size.mean()), 0.0, 1.0)) if spread > 0 else 1.0
    return shares
