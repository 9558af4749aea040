"""The simplest candidate that is as good as the best within the folds' scatter."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..laws.power_series import exponents_of

# Total degree of a power series, or its box (k, q).
Degree = int | tuple[int, int]
# Parameters of a candidate, and ``cv_results_``: scikit-learn puts anything there.
Parameters = Mapping[str, Any]
SearchResults = Mapping[str, Any]
# Complexity of a candidate, or a sort key of it.
Rank = float | tuple[float, ...]

# What more terms must take off the held-out error, and the error below which nothing is
# missing: those of the closed loop. Sensor offsets and slow drift are the same in all
# folds of a test, so the folds do not see them as scatter, and even powers can imitate
# them.
MIN_GAIN = 0.15
LEAST_ERROR = 2e-4
# Parameters of a candidate that are larger for simpler ones, and smaller for simpler
# ones.
_PENALTIES = ("threshold", "reg_weight_lam", "alpha", "kappa", "relax_coeff_nu")
_SIZES = ("max_iter", "group_sparsity", "target_sparsity")


def one_standard_error(
    results: SearchResults,
    *,
    metric: str = "score",
    complexity: Callable[[Parameters], Rank] | None = None,
    min_gain: float = MIN_GAIN,
) -> int:
    r"""The one-standard-error rule, for ``GridSearchCV(refit=one_standard_error)``.

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
    ranks = [(complexity or complexity_of)(params) for params in results["params"]]
    return choose(errors_of(scores), ranks, min_gain)


def fold_scores(results: SearchResults, metric: str = "score") -> np.ndarray:
    """Test scores of ``cv_results_``, (n_candidates, n_folds)."""
    columns: list[np.ndarray] = []
    while f"split{len(columns)}_test_{metric}" in results:
        name = f"split{len(columns)}_test_{metric}"
        columns.append(np.asarray(results[name], dtype=float))
    if columns:
        return np.column_stack(columns)

    names = set()
    for key in results:
        start, _, name = key.partition("_test_")
        if start.startswith("split") and name:
            names.add(name)
    what = f"The search has no scores named {metric!r}"
    raise NRFError(what, f"It has {', '.join(sorted(names)) or 'none'}: metric=...")


def errors_of(scores: np.ndarray) -> np.ndarray:
    """Relative errors (rms, share of the reference) behind scores."""
    if np.nanmax(scores, initial=-np.inf) > 0:
        errors = np.sqrt(np.clip(1.0 - scores, 0.0, None))
    else:
        errors = -scores / 100.0
    return np.where(np.isfinite(errors), errors, np.inf)


def choose(
    errors: np.ndarray,
    complexity: Sequence[Rank],
    min_gain: float = MIN_GAIN,
    paired: bool = False,
) -> int:
    """The rule on errors (n_candidates, n_folds); see :func:`one_standard_error`.

    ``paired``: the standard error is that of the difference from the best candidate,
    fold by fold.
    """
    floored = np.maximum(errors, LEAST_ERROR)
    mean = floored.mean(axis=1)
    if not np.isfinite(mean).any():
        what = "No candidate could be fitted and scored on every fold"
        raise NRFError(what, "Use fewer folds or lower orders.")

    best = int(np.argmin(mean))
    if paired:
        allowance = np.array([standard_error(row - floored[best]) for row in floored])
    else:
        allowance = np.full(len(floored), standard_error(floored[best]))
    limit = np.maximum(mean[best] + allowance, mean[best] / (1.0 - min_gain))
    good = np.flatnonzero(mean <= limit).tolist()
    return min(good, key=lambda i: (complexity[i], mean[i]))


def standard_error(errors: np.ndarray) -> float:
    """Standard error of the mean over folds."""
    n = len(errors)
    return float(np.std(errors, ddof=1) / np.sqrt(n)) if n > 1 else 0.0


def complexity_of(params: Parameters) -> tuple[float, ...]:
    """Sort key of a candidate: fewer terms first, then the larger threshold."""
    last = {name.rsplit("__", 1)[-1]: value for name, value in params.items()}
    if last.keys().isdisjoint(("degree", "orders", *_PENALTIES, *_SIZES)):
        cure = (
            "Pass complexity=, e.g. functools.partial(one_standard_error,"
            " complexity=lambda params: ...)."
        )
        raise NRFError(f"The complexity of {dict(params)} is unknown", cure)

    key = [_number_of_terms(last.get("degree"), last.get("orders"))]
    for name in _SIZES:
        if name in last:
            key.append(float(last[name] or 0))
    for name in _PENALTIES:
        if name in last:
            key.append(-float(last[name]))
    return tuple(key)


def _number_of_terms(
    degree: Degree | None, orders: Mapping[str, Degree] | None
) -> float:
    """Terms of a candidate; a storey that is not named has the degree."""
    terms = 0.0 if degree is None else float(len(exponents_of(degree)))
    if not orders:
        return terms
    named = sum(len(exponents_of(order)) for order in orders.values())
    return named + 1e-3 * terms
