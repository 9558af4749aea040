"""Errors on held-out folds, and the simplest order that is as good as the best as far
as the folds can tell.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count, takewhile
from typing import Any

import numpy as np

from ..equations.chain_solve import Solution, model_of
from ..equations.errors import (
    balance_sizes,
    free_run_error,
    pooled_error,
    pooled_percent,
    residual_weights,
)
from ..equations.normal_equations import NormalEquations
from ..exceptions import NRFError
from ..laws.power_series import exponents_of
from ..records.dataset import BlockRows
from .fold_moments import EVERY, FoldMoments, Order

# What more terms must take off the held-out error, and the error below which nothing is
# missing: those of the closed loop. Sensor offsets and slow drift are the same in all
# folds of a test, so the folds do not see them as scatter, and even powers can imitate
# them.
MIN_GAIN = 0.15
FLOOR = 2e-4


def one_standard_error(
    results: Mapping[str, Any],
    *,
    metric: str = "score",
    complexity: Callable[[Mapping[str, Any]], float] | None = None,
    min_gain: float = MIN_GAIN,
) -> int:
    r"""The one-standard-error rule, as ``GridSearchCV(refit=one_standard_error)`` takes
    it.

    Chosen is the simplest candidate whose mean held-out error :math:`\bar e` is within
    one standard error, over the folds, of the best one's (Breiman et al. 1984, sec.
    3.4.3), or from which the best one takes less than ``min_gain``:

    .. math:: \bar e \le \max\left(\bar e_{best} + \mathrm{SE}_{best}, \;
              \frac{\bar e_{best}}{1 - \mathrm{min\_gain}}\right).

    Errors below 0.02 % of the reference are as good as none: round-off is no reason for
    more terms.

    Parameters
    ----------
    results : mapping
        ``cv_results_`` of a scikit-learn search. Scores must be R^2 (1 is best) or
        negative errors in percent (0 is best), as those of
        :mod:`pysindy_nrf.selection.scorers` and ``NRFRegressor.score``.
    metric : str
        Name of the score, if the search had several.
    complexity : callable, optional
        From the parameters of a candidate to its complexity. By default the number of
        terms (``degree``, ``orders``), then the larger ``threshold`` first.
    min_gain : float
        Share of the held-out error that more terms must take off; 0 for the rule of the
        book.

    Returns
    -------
    int
        Index of the chosen candidate.

    Raises
    ------
    NRFError
        If no candidate could be scored, or complexity cannot be read off the
        parameters.

    Examples
    --------
    >>> from pysindy_nrf.selection import one_standard_error
    >>> results = {
    ...     "params": [{"degree": 1}, {"degree": 3}, {"degree": 5}],
    ...     "split0_test_score": [-9.0, -2.1, -2.0],
    ...     "split1_test_score": [-8.0, -2.3, -2.2],
    ... }
    >>> one_standard_error(results)
    1
    """
    scores = fold_scores(results, metric)
    return choose(
        errors_of(scores),
        [(complexity or complexity_of)(params) for params in results["params"]],
        min_gain,
    )


def fold_scores(results: Mapping[str, Any], metric: str = "score") -> np.ndarray:
    """Test scores of ``cv_results_``."""
    names = list(
        takewhile(results.__contains__, (f"split{i}_test_{metric}" for i in count()))
    )
    if not names:
        have = sorted(
            {
                k.split("_test_")[1]
                for k in results
                if k.startswith("split") and "_test_" in k
            }
        )
        raise NRFError(
            f"The search has no scores named {metric!r}",
            f"It has {', '.join(have) or 'none'}: metric=...",
        )
    return np.column_stack([np.asarray(results[name], dtype=float) for name in names])


def errors_of(scores: np.ndarray) -> np.ndarray:
    """Relative errors (rms, share of the reference) behind scores."""
    best = np.nanmax(scores, initial=-np.inf)
    errors = np.sqrt(np.clip(1.0 - scores, 0.0, None)) if best > 0 else -scores / 100.0
    return np.where(np.isfinite(errors), errors, np.inf)


def choose(
    errors: np.ndarray,
    complexity: Sequence[Any],
    min_gain: float = MIN_GAIN,
    paired: bool = False,
) -> int:
    """The rule on errors; see :func:`one_standard_error`."""
    errors = np.maximum(errors, FLOOR)
    mean = errors.mean(axis=1)
    if not np.isfinite(mean).any():
        raise NRFError(
            "No candidate could be fitted and scored on every fold",
            "Use fewer folds or lower orders.",
        )
    best = int(np.argmin(mean))
    alone = np.full(len(errors), standard_error(errors[best]))
    se = (
        np.array([standard_error(row - errors[best]) for row in errors])
        if paired
        else alone
    )
    good = np.flatnonzero(
        mean <= np.maximum(mean[best] + se, mean[best] / (1.0 - min_gain))
    )
    return min(good.tolist(), key=lambda i: (complexity[i], mean[i]))


def standard_error(errors: np.ndarray) -> float:
    """Standard error of the mean over folds."""
    n = len(errors)
    return float(np.std(errors, ddof=1) / np.sqrt(n)) if n > 1 else 0.0


def complexity_of(params: Mapping[str, Any]) -> tuple[float, ...]:
    """Sort key of a candidate: fewer terms first, then the larger threshold or
    weight.
    """
    last = {name.rsplit("__", 1)[-1]: value for name, value in params.items()}
    known = {"degree", "orders"} & last.keys()
    penalties = [k for k in _PENALTIES if k in last]
    fewer = [k for k in _SIZES if k in last]
    if not (known or penalties or fewer):
        cure = (
            "Pass complexity=, e.g. functools.partial(one_standard_error,"
            " complexity=lambda params: ...)."
        )
        raise NRFError(f"The complexity of {dict(params)} is unknown", cure)
    degree = last.get("degree")
    orders = dict(last.get("orders") or {})
    terms = 0.0 if degree is None else float(len(exponents_of(degree)))
    if orders:  # a storey that is not named has the degree
        terms = float(sum(len(exponents_of(o)) for o in orders.values())) + 1e-3 * terms
    return (
        terms,
        *(float(last[k] or 0) for k in fewer),
        *(-float(last[k]) for k in penalties),
    )


_PENALTIES = ("threshold", "reg_weight_lam", "alpha", "kappa", "relax_coeff_nu")
_SIZES = ("max_iter", "group_sparsity", "target_sparsity")


@dataclass
class Heldout:
    """Roots of the held-out side of a fold, sums and counts of its accelerations, and
    what the rest says.
    """

    grams: NormalEquations
    sums: np.ndarray
    counts: np.ndarray
    solution: Solution
    fold: Any


def _held_out(fold_moments: FoldMoments, order: Order) -> Iterator[tuple[Heldout, Any]]:
    """All folds at once, or one by one where they differ too much or one of them fails;
    and where they stand.
    """

    def one(fold: Any) -> Heldout:
        solution, solve_order, _ = fold_moments.fit(order, fold)
        test, sums, counts = fold_moments.total(fold, "test")
        return Heldout(
            fold_moments.cut(test, order, order.groups(solve_order)),
            sums,
            counts,
            solution,
            fold,
        )

    with suppress(NRFError):
        yield one(EVERY), slice(None)
        return
    for fold in range(fold_moments.n_folds):
        with suppress(NRFError):
            yield one(fold), fold


def on_folds(
    fold_moments: FoldMoments, order: Order, scorings: Iterable[str]
) -> dict[str, np.ndarray]:
    """Scores of one candidate on all folds."""
    scores = {name: np.full(fold_moments.n_folds, np.nan) for name in scorings}
    for held, where in _held_out(fold_moments, order):
        for name, values in scores.items():
            values[where] = _SCORES[name](fold_moments, order, held)
    return scores


def balances_on_folds(
    fold_moments: FoldMoments, order: Order, dofs: Iterable[int] | None = None
) -> np.ndarray:
    """Pooled error of some balances, of all if None, on all folds, percent NRMSE;
    infinite where a fit failed.
    """
    errors = np.full(fold_moments.n_folds, np.inf)
    dofs = range(1, order.layout.n_dof + 1) if dofs is None else dofs
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
            weights[..., 0] = residual_weights(
                held.solution.masses, held.solution.coefficients, held.grams, (j,)
            )
            weights[..., held.grams.positions((j,))[1], 1] = 1.0
            residual, own = np.moveaxis(held.grams.norms((j,), weights), -1, 0)
            error = error + (residual / held.solution.masses[j]) ** 2
            left = left + own**2 - held.sums[..., j - 1] ** 2 / held.counts[..., j - 1]
    return 1.0 - np.divide(
        error, left, out=np.full(left.shape, np.nan), where=left != 0
    )


def _free_run(fold_moments: FoldMoments, order: Order, held: Heldout) -> Any:
    if held.fold == EVERY:
        each = (
            replace(held, solution=held.solution.of(fold), fold=fold)
            for fold in range(fold_moments.n_folds)
        )
        return [_free_run(fold_moments, order, one) for one in each]
    runs = _runs(fold_moments, held.fold)
    error = free_run_error(
        model_of(order.layout, held.solution),
        fold_moments.data,
        fold_moments.filters,
        runs,
    )
    return -error if np.isfinite(error) else float("nan")


def _runs(fold_moments: FoldMoments, fold: int) -> list[BlockRows]:
    """Contiguous held-out rows, record by record."""
    out = []
    for i, seg in enumerate(fold_moments.data.segments):
        held = (
            fold_moments.membership[fold_moments.class_of[seg.rows][seg.valid], fold]
            == 2
        )
        edges = np.flatnonzero(
            np.diff(np.concatenate([[0], held.astype(np.int8), [0]]))
        )
        out += [
            BlockRows(i, slice(int(lo), int(hi)))
            for lo, hi in zip(edges[::2], edges[1::2])
        ]
    return out


_SCORES: dict[str, Any] = {
    "balance": _balance,
    "acceleration": _acceleration,
    "free_run": _free_run,
}
SCORINGS = tuple(_SCORES)
