"""Order selection: all orders, all folds from one pass over the samples."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import clone

from ..chain.sites import Site
from ..drawing.figure import Figure
from ..drawing.matplotlib_renderer import Drawing
from ..equations.measured_motion import require_moving
from ..exceptions import ChainError, ChannelError, NRFError
from ..identification.problem import LEAST_SQUARES, law_list
from ..identification.regressor import NRFRegressor
from ..laws.power_series import exponents_of
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from ..report.figures.motion import order_figure
from .held_out import SCORES, errors_on_folds, scores_on_folds
from .one_se_rule import Degree, choose, complexity_of, errors_of, standard_error
from .order_sums import OrderSums
from .splitters import BlockedTimeSplit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RULES = ("one_standard_error", "best")
# Passes over the storeys until each has its own order.
MAX_PASSES = 3

# Rows that train and that test of one fold.
FoldRows = tuple[np.ndarray, np.ndarray]


class Splitter(Protocol):
    """A splitter of scikit-learn, or one like it."""

    def split(self, X: np.ndarray, y: object, groups: np.ndarray) -> Iterator[FoldRows]:
        """Rows of each fold."""


# Number of blocks in time, a splitter, or the rows of each fold.
CrossValidation = int | Splitter | Iterable[FoldRows]


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
        One row for each order: ``terms`` (of the entire chain), ``score`` and
        ``standard_error`` over the folds, ``balance_error`` (held out, percent NRMSE),
        ``acceleration_r2``, ``free_run_error`` (if asked for) and ``chosen``.
    fold_scores : DataFrame
        Scores, orders by folds; equal to those of ``GridSearchCV``.
    """

    def __init__(
        self,
        sums: OrderSums,
        labels: Sequence[Degree],
        scoring: str,
        rule: str,
        estimator: NRFRegressor,
        free_run: bool,
    ) -> None:
        self.scoring = scoring
        self.rule = rule
        self._sums = sums
        self._labels = labels
        self._estimator = estimator
        self._free_run = free_run
        self._scores = self._scored([scoring])[scoring]
        if rule == "one_standard_error":
            ranks = [complexity_of({"degree": label}) for label in labels]
            self._chosen = choose(errors_of(self._scores), ranks)
        else:
            self._chosen = int(np.nanargmax(self._scores.mean(axis=1)))
        self.best_order = labels[self._chosen]

    def _scored(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Scores of all orders on all folds, (n_orders, n_folds), by name."""
        rows = []
        for label in self._labels:
            order = self._sums.uniform_order(label)
            rows.append(scores_on_folds(self._sums, order, names))
        return {name: np.array([row[name] for row in rows]) for name in names}

    @cached_property
    def fold_scores(self) -> pd.DataFrame:
        index = pd.Index(list(map(str, self._labels)), name="order")
        folds = [f"fold {i + 1}" for i in range(self._scores.shape[1])]
        return pd.DataFrame(self._scores, index, folds)

    @cached_property
    def table(self) -> pd.DataFrame:
        names = {"balance", "acceleration"}
        if self._free_run:
            names.add("free_run")
        scores = self._scored(sorted(names - {self.scoring}))
        scores[self.scoring] = self._scores

        terms = []
        for label in self._labels:
            terms.append(self._sums.uniform_order(label).layout.n_terms)
        table = pd.DataFrame({"terms": terms}, self.fold_scores.index)
        table["score"] = self._scores.mean(axis=1)
        table["standard_error"] = [standard_error(row) for row in self._scores]
        table["balance_error"] = -scores["balance"].mean(axis=1)
        table["acceleration_r2"] = scores["acceleration"].mean(axis=1)
        if "free_run" in scores:
            table["free_run_error"] = -scores["free_run"].mean(axis=1)
        table["chosen"] = np.arange(len(table)) == self._chosen
        return table

    @cached_property
    def orders_(self) -> dict[str, Degree]:
        return _orders_by_storey(self._sums, self._labels, self.best_order)

    def regressor(self, by_storey: bool = False) -> NRFRegressor:
        """An estimator, not yet fitted, with the order found.

        Parameters
        ----------
        by_storey : bool
            Whether each storey has its own order.
        """
        new = clone(self._estimator)
        if not by_storey:
            return new.set_params(degree=self.best_order)
        return new.set_params(orders={**self.orders_, **dict(new.orders or {})})

    def plot(self, ax: Axes | None = None) -> Drawing:
        """Draw held-out error over the order.

        Parameters
        ----------
        ax : matplotlib axes, optional
            New ones if None.
        """
        return Drawing([self.figure()]).plot(ax)

    def figure(self) -> Figure:
        """Held-out error over the order, apart from how it is drawn."""
        orders = [str(label) for label in self._labels]
        return order_figure(self.table, errors_of(self._scores), orders, self.scoring)

    def __repr__(self) -> str:
        n_orders, n_folds = self._scores.shape
        return (
            f"OrderSelection(best_order={self.best_order!r}, {n_orders} orders,"
            f" {n_folds} folds)"
        )

    def __str__(self) -> str:
        best = self.table.loc[self.table["chosen"]].iloc[0]
        kind = "box (k, q)" if isinstance(self.best_order, tuple) else "degree"
        rule = self.rule.replace("_", " ")
        return (
            f"{kind} {self.best_order}: held-out balance error"
            f" {best['balance_error']:.3g} %, {int(best['terms'])} terms ({rule},"
            f" {self.scoring})\n{self.table.to_string()}"
        )


def select_order(
    X: object,
    F: ArrayLike | None = None,
    *,
    degrees: Iterable[int] | None = range(1, 8),
    boxes: Iterable[tuple[int, int]] | None = None,
    cv: CrossValidation = 5,
    rule: str = "one_standard_error",
    scoring: str = "balance",
    free_run: bool = False,
    record: ArrayLike | None = None,
    time: ArrayLike | None = None,
    base_acceleration: ArrayLike | None = None,
    covariates: Mapping[str, ArrayLike] | None = None,
    **regressor_params: Any,
) -> OrderSelection:
    """Choose the order of the power series by held-out error.

    The samples are read once, into Gram matrices of the pieces that the folds cut. The
    scores are those of ``GridSearchCV(NRFRegressor(), {"degree": ...}, cv=cv,
    scoring=...)`` to 1e-9, or to the root of the machine precision where the balances
    close. With ``band`` or with laws that have memory the scores differ: here records
    are filtered and followed from end to end, there from the edge of each fold.

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
    if scoring not in SCORES:
        cure = f"Choose {', '.join(SCORES)}, or use GridSearchCV with your own scorer."
        raise NRFError(f"scoring={scoring!r} is unknown here", cure)
    if rule not in RULES:
        raise NRFError(f"rule={rule!r} is unknown", f"Choose {' or '.join(RULES)}.")
    if "degree" in regressor_params:
        cure = "Give degrees=..., or orders= for storeys whose order is known."
        raise ChainError("degree is what is selected", cure)

    estimator = NRFRegressor(**regressor_params)
    data = data_of(
        estimator,
        X,
        F,
        record=record,
        time=time,
        base_acceleration=base_acceleration,
        covariates=covariates,
    )
    sums = order_sums_of(estimator, labels, data, cv)
    clockless = any(segment.dt is None for segment in data.segments)
    if clockless and (free_run or scoring == "free_run"):
        what = "The free run needs the time of the samples"
        raise ChannelError(what, "Pass dt= (s), time=, or X with a time index.")
    return OrderSelection(sums, labels, scoring, rule, estimator, free_run)


def _labels(
    degrees: Iterable[Degree] | None, boxes: Iterable[tuple[int, int]] | None
) -> list[Degree]:
    """All orders, each once."""
    labels: list[Degree] = []
    for degree in () if degrees is None else degrees:
        if isinstance(degree, (int, np.integer)) and not isinstance(degree, bool):
            degree = int(degree)
        labels.append(degree)
    for box in boxes or ():
        labels.append(cast(Degree, tuple(box)))
    if not labels:
        what = "There is no order to choose from"
        raise NRFError(what, "Give degrees=range(1, 8), or boxes=[(1, 3), ...].")
    for label in labels:
        if not exponents_of(label):
            raise NRFError(f"Order {label!r} has no terms", "Start at degree 1.")
    return list(dict.fromkeys(labels))


def data_of(
    estimator: NRFRegressor, X: object, F: ArrayLike | None, **options: object
) -> Dataset:
    """The data that an estimator would be fitted to.

    Refuses an estimator that sums of products cannot serve.
    """
    cure = "Use GridSearchCV over NRFRegressor."
    if estimator.constraints is not None:
        raise ChainError("constraints need the samples, not sums of them", cure)
    if estimator.estimation not in LEAST_SQUARES:
        what = (
            f"estimation={estimator.estimation!r} needs the samples, not sums of them"
        )
        raise ChainError(what, cure)
    has_memory = False
    for law in law_list(estimator.laws):
        has_memory = has_memory or law.has_memory
        if law.free_shape:
            what = f"{law!r} has shape parameters to be estimated"
            cure = "Give their values, or use GridSearchCV over NRFRegressor."
            raise ChainError(what, cure)
    return from_arrays(
        X,
        F,
        coordinates=estimator.coordinates,
        dt=estimator.dt,
        has_memory=has_memory,
        **options,
    )


def order_sums_of(
    estimator: NRFRegressor,
    labels: Sequence[Degree],
    data: Dataset,
    cv: CrossValidation,
) -> OrderSums:
    """Sums for all folds and several orders at the sites that have none."""
    problem = estimator.problem(data.n_dof)
    named = [*(estimator.laws or ()), *(estimator.orders or ())]
    fixed = {}
    for text in named:
        site = problem.chain.site(text)
        fixed[site] = problem.laws[site]
    if all(site in fixed for site in problem.chain.sites):
        what = "Every site has a law or an order already"
        raise ChainError(what, "Leave a storey out of laws= and orders=.")

    sums = OrderSums(problem, fixed, labels, data, _folds(cv, data))
    require_moving(data, sums.layout)
    return sums


def _folds(cv: CrossValidation, data: Dataset) -> list[FoldRows]:
    """Rows that train and that test of each fold."""
    splitter = BlockedTimeSplit(int(cv)) if isinstance(cv, (int, np.integer)) else cv
    if not hasattr(splitter, "split"):
        return list(splitter)

    # numbers, because two records may have one name; rows that were left out go with
    # those before
    starts = [segment.rows.start for segment in data.segments[1:]]
    sizes = np.diff([0, *starts, data.n_samples])
    records = np.repeat(np.arange(len(sizes)), sizes)
    return list(splitter.split(np.empty((data.n_samples, 1)), None, records))


def _orders_by_storey(
    sums: OrderSums, labels: Sequence[Degree], best: Degree
) -> dict[str, Degree]:
    """Each storey's simplest order, the others being what they are.

    From the top down, until nothing changes.
    """
    chosen: dict[Site, Degree] = dict.fromkeys(sums.union, best)
    ranks = [complexity_of({"degree": label}) for label in labels]
    from_top = sorted(chosen, key=lambda site: (-site.p, -site.q))
    for _ in range(MAX_PASSES):
        before = dict(chosen)
        for site in from_top:
            errors = _errors_of_orders(sums, labels, chosen, site)
            chosen[site] = labels[choose(errors, ranks, paired=True)]
        if chosen == before:
            break
    return {str(site): order for site, order in chosen.items()}


def _errors_of_orders(
    sums: OrderSums, labels: Sequence[Degree], chosen: Mapping[Site, Degree], site: Site
) -> np.ndarray:
    """Held-out errors of the equations that a site stands in, for all its orders."""
    dofs = [dof for dof in (site.p, site.q) if dof > 0]
    errors = []
    for label in labels:
        order = sums.order({**chosen, site: label})
        errors.append(errors_on_folds(sums, order, dofs))
    return np.array(errors)
