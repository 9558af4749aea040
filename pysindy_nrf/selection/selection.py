"""Order selection: all degrees, all boxes (k, q), all folds from one pass over the
samples.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone

from ..chain.sites import Site
from ..equations.chain_solve import require_moving
from ..exceptions import ChainError, ChannelError, NRFError
from ..identification.problem import LEAST_SQUARES, law_list
from ..identification.regressor import NRFRegressor
from ..laws.power_series import exponents_of
from ..records.input_arrays import from_arrays
from ..report.figures.figure import Figure
from ..report.figures.matplotlib_renderer import Drawing
from ..report.figures.motion import order_figure
from . import one_se_rule as rules
from .fold_moments import FoldMoments, Order
from .splitters import BlockedTimeSplit

_RULES = ("one_standard_error", "best")


class OrderSelection:
    """What :func:`select_order` found.

    Attributes
    ----------
    best_order : int or (int, int)
        Total degree, or box (k, q), that the rule chose for every storey.
    orders_ : dict of str to int or (int, int)
        Order of each storey by itself: one that adds nothing to the balances of its
        storey is lowered.
    table : DataFrame
        One row for each order: ``terms`` (of the whole chain), ``score`` and
        ``standard_error`` over the folds, ``balance_error`` (held out, percent NRMSE),
        ``acceleration_r2``, ``free_run_error`` (if asked for) and ``chosen``.
    fold_scores : DataFrame
        Scores, orders by folds; equal to those of ``GridSearchCV``.
    """

    def __init__(
        self,
        labels: list[Any],
        scores: np.ndarray,
        scoring: str,
        rule: str,
        source: Any,
    ) -> None:
        self.scoring, self.rule = scoring, rule
        self._labels, self._scores, self._source = labels, scores, source
        ranks, errors = (
            [rules.complexity_of({"degree": label}) for label in labels],
            rules.errors_of(scores),
        )
        one = rule == "one_standard_error"
        self._chosen = (
            rules.choose(errors, ranks)
            if one
            else int(np.nanargmax(scores.mean(axis=1)))
        )
        self.best_order = labels[self._chosen]

    @cached_property
    def fold_scores(self) -> pd.DataFrame:
        index = pd.Index([str(label) for label in self._labels], name="order")
        return pd.DataFrame(
            self._scores, index, [f"fold {i + 1}" for i in range(self._scores.shape[1])]
        )

    @cached_property
    def table(self) -> pd.DataFrame:
        held, _, free_run = self._source
        wanted = dict.fromkeys(
            ["balance", "acceleration", *(["free_run"] if free_run else [])]
        )
        scores = {self.scoring: self.fold_scores.to_numpy()}
        missing = [name for name in wanted if name not in scores]
        scores |= dict(zip(missing, _every(held, self._labels, missing)))
        table = pd.DataFrame(
            {"terms": [_order(held, x).layout.n_terms for x in self._labels]},
            self.fold_scores.index,
        )
        table["score"] = scores[self.scoring].mean(axis=1)
        table["standard_error"] = [
            rules.standard_error(row) for row in scores[self.scoring]
        ]
        table["balance_error"] = -scores["balance"].mean(axis=1)
        table["acceleration_r2"] = scores["acceleration"].mean(axis=1)
        if "free_run" in scores:
            table["free_run_error"] = -scores["free_run"].mean(axis=1)
        table["chosen"] = np.arange(len(table)) == self._chosen
        return table

    @cached_property
    def orders_(self) -> dict[str, Any]:
        return _orders_by_storey(self._source[0], self._labels, self.best_order)

    def regressor(self, by_storey: bool = False) -> NRFRegressor:
        """An estimator, not yet fitted, with the order found."""
        new = clone(self._source[1])
        if not by_storey:
            return new.set_params(degree=self.best_order)
        return new.set_params(orders={**self.orders_, **dict(new.orders or {})})

    def plot(self, ax: Any = None) -> Any:
        """Draw held-out error over the order (matplotlib); ``ax`` is where, new axes if
        None.
        """
        return Drawing([self.figure()]).plot(ax)

    def figure(self) -> Figure:
        """Held-out error over the order, apart from how it is drawn."""
        errors = rules.errors_of(self._scores)
        orders = [str(label) for label in self._labels]
        return order_figure(self.table, errors, orders, self.scoring)

    def __repr__(self) -> str:
        orders, folds = self._scores.shape
        return (
            f"OrderSelection(best_order={self.best_order!r}, {orders} orders, {folds}"
            " folds)"
        )

    def __str__(self) -> str:
        best = self.table.loc[self.table["chosen"]].iloc[0]
        kind = "box (k, q)" if isinstance(self.best_order, tuple) else "degree"
        return (
            f"{kind} {self.best_order}: held-out balance error"
            f" {best['balance_error']:.3g} %, {int(best['terms'])} terms"
            f" ({self.rule.replace('_', ' ')},"
            f" {self.scoring})\n{self.table.to_string()}"
        )


def select_order(
    X: Any,
    F: Any = None,
    *,
    degrees: Iterable[int] | None = range(1, 8),
    boxes: Iterable[tuple[int, int]] | None = None,
    cv: Any = 5,
    rule: str = "one_standard_error",
    scoring: str = "balance",
    free_run: bool = False,
    record: Any = None,
    time: Any = None,
    base_acceleration: Any = None,
    covariates: Any = None,
    **regressor_params: Any,
) -> OrderSelection:
    """Choose the order of the power series by held-out error, at the cost of about one
    fit.

    The samples are read once, into Gram matrices of the pieces that the folds cut. The
    scores are those of ``GridSearchCV(NRFRegressor(), {"degree": ...}, cv=cv,
    scoring=...)`` to 1e-9, or to the root of the machine precision where the balances
    close (with ``band`` or with laws that remember the path, records are here filtered
    and followed whole, and there from each fold's edge anew).

    Parameters
    ----------
    X, F, record, time, base_acceleration, covariates
        As for :meth:`NRFRegressor.fit`; records are fused.
    degrees : iterable of int, optional
        Total degrees (paper eq. 9).
    boxes : iterable of (int, int), optional
        Boxes (k, q) of the paper's eq. (2): powers of v up to k, of s up to q.
    cv : int, splitter or iterable of (train, test)
        Blocks in time for a number.
    rule : {"one_standard_error", "best"}
    scoring : {"balance", "acceleration", "free_run"}
        See :mod:`pysindy_nrf.selection.scorers`.
    free_run : bool
        Simulate every candidate on every fold too, for the table; needs the time of the
        samples.
    **regressor_params
        Of :class:`NRFRegressor`; storeys named in ``orders`` or ``laws`` keep their
        law.

    Returns
    -------
    OrderSelection
        ``best_order``, ``orders_`` (by storey), ``table``, ``fold_scores``;
        ``regressor()`` gives an estimator with the order found, ``plot()`` draws the
        error over the order.

    Raises
    ------
    NRFError
        If no order was given, or none could be fitted.
    ChainError
        For parameters that Gram matrices cannot serve (``estimation``, ``constraints``,
        free shape parameters).

    Examples
    --------
    >>> from pysindy_nrf import datasets, selection
    >>> found = selection.select_order(datasets.load_demo(), degrees=(1, 3))
    >>> found.best_order, found.orders_["storey 1"]
    (3, 3)
    """
    labels = _labels(degrees, boxes)
    if scoring not in rules.SCORINGS:
        cure = (
            f"Choose {', '.join(rules.SCORINGS)}, or use GridSearchCV with your own"
            " scorer."
        )
        raise NRFError(f"scoring={scoring!r} is unknown here", cure)
    if rule not in _RULES:
        raise NRFError(f"rule={rule!r} is unknown", f"Choose {' or '.join(_RULES)}.")
    if "degree" in regressor_params:
        raise ChainError(
            "degree is what is selected",
            "Give degrees=..., or orders= for storeys whose order is known.",
        )
    estimator = NRFRegressor(**regressor_params)
    beside = dict(
        record=record,
        time=time,
        base_acceleration=base_acceleration,
        covariates=covariates,
    )
    held = fold_moments_of(estimator, labels, X, F, cv, beside)
    if (free_run or scoring == "free_run") and any(
        seg.dt is None for seg in held.data.segments
    ):
        raise ChannelError(
            "The free run needs the time of the samples",
            "Pass dt= (s), time=, or X with a time index.",
        )
    return OrderSelection(
        labels,
        _every(held, labels, [scoring])[0],
        scoring,
        rule,
        (held, estimator, free_run),
    )


def _order(held: FoldMoments, label: Any) -> Order:
    return held.order(dict.fromkeys(held.union, label))


def _every(
    held: FoldMoments, labels: list[Any], scorings: list[str]
) -> list[np.ndarray]:
    """Scores of all orders on all folds, one array for each scoring."""
    found = [rules.on_folds(held, _order(held, label), scorings) for label in labels]
    return [np.array([scores[name] for scores in found]) for name in scorings]


def _labels(degrees: Any, boxes: Any) -> list[Any]:
    labels = [
        *(degrees if degrees is not None else ()),
        *(tuple(box) for box in boxes or ()),
    ]
    labels = [
        int(d) if hasattr(d, "__index__") and not isinstance(d, bool) else d
        for d in labels
    ]
    if not labels:
        raise NRFError(
            "There is no order to choose from",
            "Give degrees=range(1, 8), or boxes=[(1, 3), ...].",
        )
    empty = [label for label in labels if not exponents_of(label)]
    if empty:
        raise NRFError(f"Order {empty[0]!r} has no terms", "Start at degree 1.")
    return list(dict.fromkeys(labels))


def fold_moments_of(
    estimator: Any,
    labels: list[Any],
    X: Any,
    F: Any,
    cv: Any,
    options: Mapping[str, Any],
) -> FoldMoments:
    """Gram matrices for all folds of what an estimator would be fitted to, with several
    orders where none is given.
    """
    if estimator.estimation not in LEAST_SQUARES or estimator.constraints is not None:
        what = (
            "constraints"
            if estimator.constraints is not None
            else f"estimation={estimator.estimation!r}"
        )
        raise ChainError(
            f"{what} cannot be had from Gram matrices alone",
            "Use GridSearchCV over NRFRegressor.",
        )
    given = law_list(estimator.laws)
    free = [law for law in given if law.free_shape]
    if free:
        cure = "Give their values, or use GridSearchCV over NRFRegressor."
        raise ChainError(f"{free[0]!r} has shape parameters to be estimated", cure)
    data = from_arrays(
        X,
        F,
        coordinates=estimator.coordinates,
        dt=estimator.dt,
        **options,
        has_memory=any(law.has_memory for law in given),
    )
    problem = estimator.problem(data.n_dof)
    chain = problem.chain
    fixed = {
        s: problem.laws[s]
        for s in map(chain.site, [*(estimator.laws or ()), *(estimator.orders or ())])
    }
    searched = {s: labels for s in chain.sites if s not in fixed}
    if not searched:
        raise ChainError(
            "Every site has a law or an order already",
            "Leave a storey out of laws= and orders=.",
        )
    starts = [
        0,
        *(seg.rows.start for seg in data.segments[1:]),
        data.n_samples,
    ]  # rows left out go with those before
    ids = np.repeat(
        np.arange(len(data.segments)), np.diff(starts)
    )  # numbers: two records may have one name
    splitter = BlockedTimeSplit(int(cv)) if isinstance(cv, (int, np.integer)) else cv
    folds = list(
        splitter.split(np.empty((data.n_samples, 1)), None, ids)
        if hasattr(splitter, "split")
        else splitter
    )
    held = FoldMoments(
        chain,
        fixed,
        searched,
        data,
        folds,
        problem.filters(data),
        problem.known_masses,
        problem.strategy,
        problem.optimizer,
    )
    require_moving(data, held.layout)
    return held


def _orders_by_storey(
    held: FoldMoments, labels: list[Any], best: Any
) -> dict[str, Any]:
    """Each storey's simplest order, the others being what they are; from the top down
    until nothing changes.
    """
    chosen: dict[Site, Any] = dict.fromkeys(held.union, best)
    ranks = [rules.complexity_of({"degree": label}) for label in labels]
    for _ in range(3):
        before = dict(chosen)
        for site in sorted(chosen, key=lambda s: (-s.p, -s.q)):
            dofs = [j for j in (site.p, site.q) if j > 0]
            errors = np.array(
                [
                    rules.balances_on_folds(
                        held, held.order({**chosen, site: label}), dofs
                    )
                    / 100.0
                    for label in labels
                ]
            )
            chosen[site] = labels[rules.choose(errors, ranks, paired=True)]
        if chosen == before:
            break
    return {str(site): order for site, order in chosen.items()}
