"""Which terms: those of the power series that held-out data miss when they are left
out.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone

from ..chain.layout import LawLayout
from ..chain.sites import Site
from ..equations.errors import pooled_error
from ..exceptions import NRFError
from ..identification.regressor import NRFRegressor
from .fold_moments import FoldMoments, Monomials, Order
from .one_se_rule import balances_on_folds, choose, standard_error
from .selection import fold_moments_of

# rise of the held-out error, as a share, that the absence of a term may cost at most
MARGIN = 0.02


class SparsitySelection:
    """What :func:`select_sparsity` found.

    Attributes
    ----------
    table : DataFrame
        One row for each step: ``left_out`` (the term, none in the first row), ``terms``
        that are left (masses not counted), ``error`` and ``standard_error`` of the
        held-out balance over the folds (percent NRMSE).
    terms : Series
        By site and term: coefficients (N, SI), 0 where left out.
    """

    def __init__(
        self,
        table: pd.DataFrame,
        order: Order,
        coefficients: Mapping[Site, Any],
        estimator: Any,
    ) -> None:
        self.table, self._order, self._estimator = table, order, estimator
        labels = {
            (str(s), label): float(c)
            for s in coefficients
            for label, c in coefficients[s].items()
        }
        self.terms = pd.Series(labels, name="coefficient").rename_axis(["site", "term"])

    def regressor(self) -> NRFRegressor:
        """An estimator, not yet fitted, with the terms that are left."""
        laws = {str(s): list(held) for s, held in self._order.layout.laws.items()}
        return clone(self._estimator).set_params(laws=laws, orders=None)

    def __repr__(self) -> str:
        return (
            f"SparsitySelection({self._order.layout.n_terms} of {len(self.terms)}"
            " terms)"
        )


def select_sparsity(
    X: Any,
    F: Any = None,
    *,
    degree: Any = 3,
    cv: Any = 6,
    record: Any = None,
    time: Any = None,
    base_acceleration: Any = None,
    covariates: Any = None,
    **regressor_params: Any,
) -> SparsitySelection:
    """Leave out the terms of the power series that held-out data do not miss, from one
    pass over the samples.

    In each step the term goes whose absence raises the balance error least. The steps
    end where the folds can tell the error from the least so far: by more than one
    standard error of the difference, and by more than 2 %. Each storey keeps one term
    at least. No threshold is needed, and none would fit all storeys.

    Parameters
    ----------
    X, F, record, time, base_acceleration, covariates, cv
        As for :func:`~pysindy_nrf.selection.select_order`.
    degree : int or (int, int)
        Of the power series that is thinned out.
    **regressor_params
        Of :class:`NRFRegressor`: ``strategy``, ``known_masses``, ``laws`` and
        ``orders`` (kept whole), ``band``, ...

    Returns
    -------
    SparsitySelection
        ``table`` (one row for each step), ``terms`` (coefficients); ``regressor()``: an
        estimator with the terms left.

    Raises
    ------
    NRFError
        If the whole series cannot be fitted on every fold.

    Examples
    --------
    >>> from pysindy_nrf import datasets, selection
    >>> found = selection.select_sparsity(datasets.load_demo())
    >>> kept = found.terms[found.terms != 0]
    >>> kept["storey 1"].index.tolist(), kept["storey 2"].index.tolist()
    (['v', 's', 's^3'], ['v', 's'])
    """
    estimator = NRFRegressor(degree=degree, **regressor_params)
    beside = dict(
        record=record,
        time=time,
        base_acceleration=base_acceleration,
        covariates=covariates,
    )
    held = fold_moments_of(estimator, [degree], X, F, cv, beside)
    whole = order = held.order(dict.fromkeys(held.union, degree))
    least = errors = balances_on_folds(held, order) / 100.0
    if not np.isfinite(errors).all():
        raise NRFError(
            "The whole series cannot be fitted on every fold",
            "Use fewer folds or a lower degree.",
        )
    support = {
        site: np.ones(order.layout.counts[site], dtype=bool) for site in held.union
    }
    rows = [("", order, errors)]
    while (weakest := _weakest(held, whole, support)) is not None:
        site, at = weakest
        support = _without(support, site, at)
        one = _restricted(held, whole, support)
        errors = balances_on_folds(held, one) / 100.0
        if choose(np.array([least, errors]), [1, 0], min_gain=MARGIN, paired=True) == 0:
            break
        order, least = one, min(least, errors, key=np.mean)
        rows.append((f"{whole.layout.labels(site)[at]} of {site}", order, errors))
    steps = [
        (name, one.layout.n_terms, 100 * e.mean(), 100 * standard_error(e))
        for name, one, e in rows
    ]
    table = pd.DataFrame(
        steps, columns=["left_out", "terms", "error", "standard_error"]
    )
    found = held.fit(order, None)[0].coefficients
    kept = {
        site: dict(zip(order.layout.labels(site), found[site]))
        for site in whole.layout.acting
    }
    coefficients = {
        s: {label: own.get(label, 0.0) for label in whole.layout.labels(s)}
        for s, own in kept.items()
    }
    return SparsitySelection(table, order, coefficients, estimator)


def _without(
    support: Mapping[Site, np.ndarray], site: Site, at: int
) -> dict[Site, np.ndarray]:
    return {**support, site: support[site] & (np.arange(len(support[site])) != at)}


def _restricted(
    held: FoldMoments, whole: Order, support: Mapping[Site, np.ndarray]
) -> Order:
    """A candidate with the terms of a support alone; given laws are kept whole."""
    columns = {site: whole.columns[site][kept] for site, kept in support.items()}
    few = {
        site: (Monomials(held.union[site].exponents[i] for i in at),)
        for site, at in columns.items()
    }
    return Order(
        LawLayout(held.chain, {**few, **held.laws}), {**whole.columns, **columns}
    )


def _weakest(
    held: FoldMoments, whole: Order, support: Mapping[Site, np.ndarray]
) -> tuple[Site, int] | None:
    """The power whose absence raises the balance error on all data least; a storey
    keeps one at least.
    """
    rises = {}
    for site in (site for site, kept in support.items() if kept.sum() > 1):
        for at in np.flatnonzero(support[site]).tolist():
            try:
                solution, _, grams = held.fit(
                    _restricted(held, whole, _without(support, site, at)), None
                )
            except NRFError:
                continue
            rises[site, at] = pooled_error(
                solution.masses, solution.coefficients, grams
            )
    return min(rises, key=rises.__getitem__) if rises else None
