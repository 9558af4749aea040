"""Scores of one candidate on held-out folds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..equations.chain_solve import Solution, model_of
from ..equations.errors import (
    balance_sizes,
    pooled_error,
    pooled_percent,
    residual_weights,
)
from ..equations.free_runs import free_run_error
from ..equations.normal_equations import NormalEquations
from ..exceptions import NRFError
from .folds import EVERY, Fold
from .order_sums import FoldSide, Order, OrderSums

# A number, or one for each fold of a stack.
Scores = float | np.ndarray


@dataclass(frozen=True)
class HeldOut:
    """A candidate that was fitted to the training side of a fold, and the test side.

    Attributes
    ----------
    sums : OrderSums
    order : Order
    fold : int or "every"
        Number, or all folds stacked.
    solution : Solution
    side : FoldSide
    grams : NormalEquations
        Roots of the candidate's columns on the test side.
    """

    sums: OrderSums
    order: Order
    fold: Fold
    solution: Solution
    side: FoldSide
    grams: NormalEquations

    @classmethod
    def fitted(cls, sums: OrderSums, order: Order, fold: Fold) -> HeldOut:
        """Fit a candidate; raises NRFError where it cannot be fitted."""
        solution, solve_order, _ = sums.fit(order, fold)
        side = sums.held_out(fold)
        grams = sums.cut(side.grams, order, solve_order)
        return cls(sums, order, fold, solution, side, grams)

    @property
    def dofs(self) -> range:
        """Degrees of freedom."""
        return range(1, self.order.layout.n_dof + 1)

    def balance_error(self, dofs: Iterable[int]) -> Scores:
        """Pooled error of some equations of motion, percent NRMSE."""
        masses, coefficients = self.solution.masses, self.solution.coefficients
        return pooled_percent(
            balance_sizes(dof, masses, coefficients, self.grams) for dof in dofs
        )


def _balance(held_out: HeldOut) -> Scores:
    """Minus the pooled error of the equations of motion, percent."""
    solution = held_out.solution
    return -pooled_error(solution.masses, solution.coefficients, held_out.grams)


def _acceleration(held_out: HeldOut) -> Scores:
    """R^2 of the accelerations, variance-weighted over the DOFs."""
    grams = held_out.grams
    solution = held_out.solution
    side = held_out.side
    missed = np.zeros(grams.shape)
    variation = np.zeros(grams.shape)
    for dof in held_out.dofs:
        dofs = (dof,)
        if not np.any(grams.sizes[dofs]):
            continue
        # residual, acceleration
        weights = np.zeros((*grams.shape, grams.matrices[dofs].shape[-1], 2))
        weights[..., 0] = residual_weights(
            solution.masses, solution.coefficients, grams, dofs
        )
        weights[..., grams.positions(dofs).mass, 1] = 1.0
        residual, a = np.moveaxis(grams.norms(dofs, weights), -1, 0)

        missed = missed + (residual / solution.masses[dof]) ** 2
        total = side.acceleration_sums[..., dof - 1]
        variation = variation + a**2 - total**2 / side.counts[..., dof - 1]
    undefined = np.full(variation.shape, np.nan)
    return 1.0 - np.divide(missed, variation, out=undefined, where=variation != 0)


def _free_run(held_out: HeldOut) -> Scores:
    """Minus the error of the displacements of free runs, percent."""
    if isinstance(held_out.fold, int):
        return _free_run_of(held_out, held_out.solution, held_out.fold)
    scores = []
    for fold in range(held_out.sums.folds.n_folds):
        scores.append(_free_run_of(held_out, held_out.solution.of(fold), fold))
    return np.array(scores)


def _free_run_of(held_out: HeldOut, solution: Solution, fold: int) -> float:
    sums = held_out.sums
    model = model_of(held_out.order.layout, solution)
    runs = sums.folds.held_out_runs(sums.data, fold)
    error = free_run_error(model, sums.data, sums.filters, runs)
    return -error if np.isfinite(error) else float("nan")


SCORES: dict[str, Callable[[HeldOut], Scores]] = {
    "balance": _balance,
    "acceleration": _acceleration,
    "free_run": _free_run,
}


def _held_out(sums: OrderSums, order: Order) -> Iterator[tuple[HeldOut, int | slice]]:
    """A candidate on all folds, and where their scores stand.

    All folds at once; one by one where they differ too much or one of them fails.
    """
    with suppress(NRFError):
        yield HeldOut.fitted(sums, order, EVERY), slice(None)
        return
    for fold in range(sums.folds.n_folds):
        with suppress(NRFError):
            yield HeldOut.fitted(sums, order, fold), fold


def scores_on_folds(
    sums: OrderSums, order: Order, names: Iterable[str]
) -> dict[str, np.ndarray]:
    """Scores of one candidate on all folds; NaN where a fit failed."""
    scores = {name: np.full(sums.folds.n_folds, np.nan) for name in names}
    for held_out, where in _held_out(sums, order):
        for name, values in scores.items():
            values[where] = SCORES[name](held_out)
    return scores


def errors_on_folds(
    sums: OrderSums, order: Order, dofs: Iterable[int] | None = None
) -> np.ndarray:
    """Relative error of some equations of motion, of all if None, on all folds.

    Infinite where a fit failed.
    """
    errors = np.full(sums.folds.n_folds, np.inf)
    for held_out, where in _held_out(sums, order):
        chosen = held_out.dofs if dofs is None else dofs
        errors[where] = np.asarray(held_out.balance_error(chosen)) / 100.0
    return errors
