"""Which terms: those of the power series that held-out data miss when left out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import clone

from ..chain.layout import LawLayout
from ..chain.sites import Site
from ..drawing.tables import table
from ..equations.errors import pooled_error
from ..exceptions import NRFError
from ..identification.regressor import NRFRegressor
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from ..report.content import Chapter
from ..report.page import content_of, write_content
from .held_out import errors_on_folds
from .inclusion import Draws, inclusion_table
from .one_se_rule import Degree, choose, standard_error
from .order_sums import Monomials, Order, OrderSums
from .selection import CrossValidation, data_of, order_sums_of

# Rise of the held-out error, as a share, that the absence of a term may cost at most.
MARGIN = 0.02

# Draws of each kind: a share of one half is known to 0.07.
N_DRAWS = 50

# By site: mask of the monomials that the model has.
Support = Mapping[Site, np.ndarray]
Laws = Mapping[Site, Sequence[ForceLaw]]


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
        terms: pd.Series,
        laws: Laws,
        estimator: NRFRegressor,
        data: Dataset,
    ) -> None:
        self.table = table
        self.terms = terms
        self._laws = laws
        self._estimator = estimator
        self._data = data

    def regressor(self) -> NRFRegressor:
        """An estimator, not yet fitted, with the terms that are left."""
        laws = {str(site): list(group) for site, group in self._laws.items()}
        return clone(self._estimator).set_params(laws=laws, orders=None)

    def inclusion(
        self, n_draws: int = N_DRAWS, random_state: int | None = None
    ) -> pd.DataFrame:
        """How often each term, and each storey's law, is found on parts of the data.

        PySINDy's STLSQ runs on draws of 64 consecutive pieces of the data, at the
        threshold whose terms on all data are nearest to those chosen. ``bagging``: as
        many pieces as there are, with replacement (Fasel et al. 2022). ``stability``:
        half of the pieces (Meinshausen and Buehlmann 2010); a term below 0.6 there is
        a matter of chance.

        Parameters
        ----------
        n_draws : int
            Of each kind.
        random_state : int, optional

        Returns
        -------
        DataFrame
            By site and term: ``coefficient``, and shares of the draws, ``bagging`` and
            ``stability``. The term ``"all"``, without a coefficient, is the storey:
            how often it has exactly the terms chosen.
        """
        estimator = clone(self._estimator)
        problem = estimator.problem(self._data.n_dof)
        chosen: dict[Site, np.ndarray] = {}
        for site in problem.layout.acting:
            if str(site) in self.terms.index.get_level_values("site"):
                values = self.terms[str(site)]
                chosen[site] = values[problem.layout.labels(site)].to_numpy() != 0
        draws = Draws.of(problem, self._data)
        shares = inclusion_table(draws, chosen, n_draws, random_state)
        shares.insert(0, "coefficient", self.terms.reindex(shares.index))
        return shares

    def to_html(
        self, path: str | PathLike[str], random_state: int | None = None
    ) -> None:
        """Write the page of the model with the terms left, and their probabilities.

        Parameters
        ----------
        path : path-like
        random_state : int, optional
            Of :meth:`inclusion`.
        """
        model = self.regressor().fit(self._data)
        content = content_of(model)
        shares = self.inclusion(random_state=random_state).reset_index()
        chapter = Chapter(
            "How sure the terms are",
            [],
            [table("Shares of draws of the data in which a term is found", shares)],
        )
        chapters = [*content.chapters, chapter]
        write_content(path, replace(content, chapters=chapters))

    def __repr__(self) -> str:
        n_terms = int(self.table["terms"].iloc[-1])
        return f"SparsitySelection({n_terms} of {len(self.terms)} terms)"


def select_sparsity(
    X: object,
    F: ArrayLike | None = None,
    *,
    degree: Degree = 3,
    cv: CrossValidation = 6,
    record: ArrayLike | None = None,
    time: ArrayLike | None = None,
    base_acceleration: ArrayLike | None = None,
    covariates: Mapping[str, ArrayLike] | None = None,
    **regressor_params: Any,
) -> SparsitySelection:
    """Leave out the terms of the power series that held-out data do not miss.

    The samples are read once. Each step removes the term whose absence raises the
    balance error least. The steps end where the error exceeds the least so far by more
    than one standard error of the difference, over the folds, and by more than 2 %.
    Each storey keeps one term at least. No threshold is needed, and none would fit all
    storeys.

    Parameters
    ----------
    X, F, record, time, base_acceleration, covariates, cv
        As for :func:`~pysindy_nrf.selection.select_order`.
    degree : int or (int, int)
        Of the power series that is thinned out.
    **regressor_params
        Of :class:`NRFRegressor`: ``strategy``, ``known_masses``, ``laws`` and
        ``orders`` (kept in full), ``band``, ...

    Returns
    -------
    SparsitySelection
        ``table`` (one row for each step), ``terms`` (coefficients); ``regressor()``: an
        estimator with the terms left; ``inclusion()``: how sure each term is;
        ``to_html(path)``: a page with both.

    Raises
    ------
    NRFError
        If the entire series cannot be fitted on every fold.

    Examples
    --------
    >>> from pysindy_nrf import datasets, selection
    >>> found = selection.select_sparsity(datasets.load_demo())
    >>> kept = found.terms[found.terms != 0]
    >>> kept["storey 1"].index.tolist(), kept["storey 2"].index.tolist()
    (['v', 's', 's^3'], ['v', 's'])
    """
    estimator = NRFRegressor(degree=degree, **regressor_params)
    data = data_of(
        estimator,
        X,
        F,
        record=record,
        time=time,
        base_acceleration=base_acceleration,
        covariates=covariates,
    )
    elimination = _Elimination(order_sums_of(estimator, [degree], data, cv), degree)
    elimination.eliminate()
    return SparsitySelection(
        elimination.table(),
        elimination.terms(),
        elimination.order.layout.laws,
        estimator,
        data,
    )


class _Elimination:
    """Terms go one by one, until the error of the folds rises."""

    def __init__(self, sums: OrderSums, degree: Degree) -> None:
        self.sums = sums
        self.full = sums.uniform_order(degree)
        self.order = self.full
        errors = errors_on_folds(sums, self.full)
        n_terms = sum(self.full.layout.counts.values())
        # fewer equations than terms have many solutions, and rounding chooses one
        if sums.fewest_equations < n_terms or not np.isfinite(errors).all():
            what = "The whole series cannot be fitted on every fold"
            raise NRFError(what, "Use fewer folds or a lower degree.")
        # what was left out, the candidate, its held-out errors
        self._steps: list[tuple[str, Order, np.ndarray]] = [("", self.full, errors)]

    def eliminate(self) -> None:
        """Leave out the weakest term, as long as the held-out error allows it."""
        least = self._steps[0][2]
        counts = self.full.layout.counts
        support: Support = {
            site: np.ones(counts[site], dtype=bool) for site in self.sums.union
        }
        weakest = self._weakest(support)
        while weakest is not None:
            site, term = weakest
            support = _without(support, site, term)
            order = self._restricted(support)
            errors = errors_on_folds(self.sums, order)
            pair = np.array([least, errors])
            if choose(pair, [1, 0], min_gain=MARGIN, paired=True) == 0:
                break
            self.order = order
            if np.mean(errors) < np.mean(least):
                least = errors
            label = self.full.layout.labels(site)[term]
            self._steps.append((f"{label} of {site}", order, errors))
            weakest = self._weakest(support)

    def _weakest(self, support: Support) -> tuple[Site, int] | None:
        """The term whose absence raises the error on all data least.

        A storey keeps one at least.
        """
        rises: dict[tuple[Site, int], float] = {}
        for site, terms in support.items():
            if terms.sum() < 2:
                continue
            for term in np.flatnonzero(terms).tolist():
                order = self._restricted(_without(support, site, term))
                try:
                    solution, _, grams = self.sums.fit(order, None)
                except NRFError:
                    continue
                error = pooled_error(solution.masses, solution.coefficients, grams)
                rises[site, term] = error
        return min(rises, key=rises.__getitem__) if rises else None

    def _restricted(self, support: Support) -> Order:
        """A candidate with the terms of a support alone; given laws are kept whole."""
        columns = dict(self.full.columns)
        laws: dict[Site, tuple[ForceLaw, ...]] = dict(self.sums.laws)
        for site, terms in support.items():
            columns[site] = self.full.columns[site][terms]
            exponents = self.sums.union[site].exponents
            laws[site] = (Monomials(exponents[i] for i in columns[site]),)
        in_order = {site: laws[site] for site in [*support, *self.sums.laws]}
        return Order(LawLayout(self.sums.chain, in_order), columns)

    def table(self) -> pd.DataFrame:
        """One row for each step."""
        rows = []
        for name, order, errors in self._steps:
            error, spread = 100 * errors.mean(), 100 * standard_error(errors)
            rows.append((name, order.layout.n_terms, error, spread))
        columns = ["left_out", "terms", "error", "standard_error"]
        return pd.DataFrame(rows, columns=columns)

    def terms(self) -> pd.Series:
        """Coefficients of all terms by site, 0 where left out."""
        coefficients = self.sums.fit(self.order, None)[0].coefficients
        values = {}
        for site in self.full.layout.acting:
            for label in self.full.layout.labels(site):
                values[str(site), label] = 0.0
            labels = self.order.layout.labels(site)
            for label, value in zip(labels, coefficients[site]):
                values[str(site), label] = float(value)
        terms = pd.Series(values, name="coefficient")
        return terms.rename_axis(["site", "term"])


def _without(support: Support, site: Site, term: int) -> Support:
    """A support without one term."""
    terms = support[site].copy()
    terms[term] = False
    return {**support, site: terms}
