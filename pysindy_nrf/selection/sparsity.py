"""Which terms: thresholds and paths of sparse optimizers, judged on data they were not fitted to."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, clone

from ..common.random_state import generator
from ..estimation.regressor import NRFRegressor
from ..exceptions import NRFError, NRFWarning
from ..laws import ForceLaw
from ..mechanics.sites import Site
from ..regression.chain_solve import Solution
from ..regression.errors import pooled_error
from ..regression.grams import BlockGrams
from ..regression.layout import LawLayout
from .fold_moments import FoldMoments, Monomials, Order
from .one_se_rule import balances_on_folds, choose, standard_error
from .selection import fold_moments_of


class AlongPath(BaseEstimator):
    r"""The sparsest model on the path of SSR, FROLS or STLSQ with :math:`|r|^2 \le |r_{full}|^2 + \tau^2 |y|^2`,
    refitted.

    Greedy optimizers choose among the models of their path by rules that mean another thing for every balance and
    number of samples; here tau is the share of the right-hand side that may be left out.
    """

    def __init__(self, optimizer: Any = None, tolerance: float = 0.01) -> None:
        self.optimizer = optimizer
        self.tolerance = tolerance

    def fit(self, x: Any, y: Any) -> Self:
        """Follow the path and choose."""
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float).reshape(len(x), -1)
        if y.shape[1] != 1:
            raise NRFError(f"AlongPath got {y.shape[1]} targets", "It stands inside ChainOptimizer: one at a time.")
        self.path_ = self._path(x, y)
        limit = self._left(x, y, tuple(range(x.shape[1]))) + self.tolerance**2 * float(np.sum(y**2))
        kept = next(columns for columns in self.path_ if self._left(x, y, columns) <= limit)
        self.coef_ = np.zeros((1, x.shape[1]))
        if kept:
            self.coef_[0, kept] = np.linalg.lstsq(x[:, kept], y[:, 0], rcond=None)[0]
        self.ind_ = self.coef_ != 0
        return self

    def _path(self, x: np.ndarray, y: np.ndarray) -> list[tuple[int, ...]]:
        everything = tuple(range(x.shape[1]))
        if x.shape[1] < 2:  # greedy optimizers need two columns
            return [(), everything]
        fitted = clone(self.optimizer).fit(x, y)
        history = getattr(fitted, "history_", None)
        if history is None:
            cure = "Use SSR, FROLS or STLSQ."
            raise NRFError(f"{type(self.optimizer).__name__} keeps no history_ of its models", cure)
        seen = {tuple(np.flatnonzero(np.ravel(coef)).tolist()) for coef in history}
        return sorted({(), everything} | seen, key=lambda columns: (len(columns), self._left(x, y, columns)))

    @staticmethod
    def _left(x: np.ndarray, y: np.ndarray, columns: tuple[int, ...]) -> float:
        """Squared length of what some columns leave unexplained."""
        if not columns:
            return float(np.sum(y**2))
        part = x[:, columns]
        return float(np.sum((y - part @ np.linalg.lstsq(part, y, rcond=None)[0]) ** 2))


Support = Mapping[Site, np.ndarray]

# Rise of the held-out error, as a share, that the absence of a term may cost at most.
MARGIN = 0.02


def support_of(coefficients: Mapping[Site, np.ndarray]) -> dict[Site, np.ndarray]:
    """Terms whose coefficient is not zero, by site."""
    return {site: np.asarray(values) != 0 for site, values in coefficients.items()}


def restricted(held: FoldMoments, order: Order, support: Support) -> Order:
    """A candidate with the terms of a support alone; a given law is kept whole if any of its terms is."""
    laws: dict[Site, list[ForceLaw]] = {site: [] for site in order.layout.sites}
    columns: dict[Site, np.ndarray] = {}
    for site in order.layout.sites:
        if site not in held.union:
            blocks, at = [], 0
            for law in order.layout.laws.get(site, ()):
                block = np.arange(at, at := at + len(law.terms()))
                if site not in support or support[site][block].any():
                    laws[site].append(law)
                    blocks.append(block)
            if blocks:
                columns[site] = order.columns[site][np.concatenate(blocks)]
            continue
        kept = order.columns[site][support[site]]
        if len(kept):
            few = Monomials(held.union[site].exponents[i] for i in kept)
            laws[site].append(few)
            place = {pair: i for i, pair in enumerate(held.union[site].exponents)}
            columns[site] = np.array([place[pair] for pair in few.exponents], dtype=int)
    return Order(LawLayout(order.layout.chain, laws), columns)


def resampled(held: FoldMoments, fold: int | None, rng: np.random.Generator) -> BlockGrams:
    """Roots of as many pieces of the training side as there are, drawn with replacement (block bootstrap)."""
    chosen = [i for i, code in enumerate(held.piece_class) if fold is None or held.membership[code, fold] == 1]
    return held.sum_of(rng.choice(chosen, size=len(chosen)))


def inclusion(
    held: FoldMoments, order: Order, optimizer: Any, n_models: int, rng: np.random.Generator, fold: int | None = None
) -> dict[Site, np.ndarray]:
    """Share of block bootstraps in which an optimizer keeps each term."""
    counts: dict[Site, np.ndarray] = {}
    solved = 0
    for _ in range(n_models):
        try:
            solution, *_ = held.fit(order, fold, optimizer, resampled(held, fold, rng))
        except NRFError:
            continue
        solved += 1
        for site, kept in support_of(solution.coefficients).items():
            counts[site] = counts.get(site, np.zeros(len(kept))) + kept
    if not solved:
        raise NRFError("No bootstrap could be solved", "Give longer records, or lower the optimizer's threshold.")
    return {site: count / solved for site, count in counts.items()}


def labels_of(order: Order, values: Mapping[Site, Sequence[float]]) -> dict[tuple[str, str], float]:
    """Values of the terms by (site, label)."""
    return {
        (str(site), label): float(value) for site in order.layout.acting
        for label, value in zip(order.layout.labels(site), values[site])
    }  # fmt: skip


@dataclass(frozen=True)
class Pruned:
    """A setting of an optimizer without some of the terms it keeps, refitted by least squares."""

    optimizer: Any
    without: tuple[tuple[str, str], ...]  # site and label of each term left out, in that order


def pruned(
    held: FoldMoments, order: Order, support: Support, least: np.ndarray
) -> Iterator[tuple[tuple[tuple[str, str], ...], Order, np.ndarray]]:
    """Terms left out one by one from the chosen setting while the held-out rule allows: names, what is left, errors."""
    gone: tuple[tuple[str, str], ...] = ()
    while (weakest := _weakest(held, order, support)) is not None:
        site, at = weakest
        support = {**support, site: support[site] & (np.arange(len(support[site])) != at)}
        one = restricted(held, order, support)
        errors = balances_on_folds(held, one) / 100.0
        if choose(np.array([least, errors]), [1, 0], min_gain=MARGIN, paired=True) == 0:
            break
        gone = (*gone, (str(site), order.layout.labels(site)[at]))
        yield gone, one, errors


def _weakest(held: FoldMoments, order: Order, support: Support) -> tuple[Site, int] | None:
    """The power whose absence raises the balance error on all data least; a storey keeps one at least."""
    rises = {}
    for site in held.union:
        for at in np.flatnonzero(support.get(site, ())) if np.sum(support.get(site, ())) > 1 else ():
            one = restricted(held, order, {**support, site: support[site] & (np.arange(len(support[site])) != at)})
            try:
                solution, _, grams = held.fit(one, None)
            except NRFError:
                continue
            rises[site, int(at)] = pooled_error(solution.masses, solution.coefficients, grams)
    return min(rises, key=rises.__getitem__) if rises else None


# Shares of the force that a term must carry to be kept.
SHARES = tuple(np.geomspace(0.002, 0.2, 13).round(5))


@dataclass(frozen=True)
class BlockEnsemble:
    """Terms that an optimizer keeps in most bootstraps over blocks of time, refitted by least squares."""

    optimizer: Any
    n_models: int = 15  # bootstraps
    min_inclusion: float = 0.6  # share of them in which a term must be kept


class SparsitySelection:
    """What :func:`select_sparsity` found.

    Attributes
    ----------
    table : DataFrame
        One row for each (optimizer, setting): ``terms`` kept (masses not counted), ``error`` and ``standard_error``
        of the held-out balance over the folds (percent NRMSE) and ``chosen``, by the rule within each optimizer.
    fold_errors : DataFrame
        Held-out balance errors, settings by folds, percent NRMSE.
    terms, inclusion : DataFrame
        Of the chosen setting of each optimizer by site and term: coefficients (N, SI; 0 where left out), and the share
        of block bootstraps that keep the term, for ensembles.
    best : str
        The optimizer with the fewest terms among those whose error the folds cannot tell from the least.
    """

    def __init__(
        self, table: pd.DataFrame, fold_errors: pd.DataFrame, terms: pd.DataFrame, inclusion: pd.DataFrame,
        supports: Mapping[Any, list[tuple[str, str]]], candidates: Mapping[Any, Any], estimator: Any, order: Order,
        held: FoldMoments,
    ) -> None:  # fmt: skip
        self.table, self.fold_errors, self.terms, self.inclusion = table, fold_errors, terms, inclusion
        self._candidates, self._estimator, self._order, self._held = candidates, estimator, order, held
        self._supports = supports
        chosen = table[table["chosen"]]
        errors = fold_errors.loc[chosen.index].to_numpy() / 100.0
        self.best = chosen.index[choose(errors, chosen["terms"].tolist(), min_gain=MARGIN, paired=True)][0]

    def support(self, name: str, setting: str) -> list[tuple[str, str]]:
        """Terms (site, label) that one setting keeps on all data."""
        return self._supports.get((name, setting), [])

    def regressor(self, name: str | None = None) -> NRFRegressor:
        """An estimator, not yet fitted, with the chosen setting of an optimizer."""
        name = self.best if name is None else name
        index = self.table.index[(self.table.index.get_level_values(0) == name) & self.table["chosen"]]
        if not len(index):
            raise NRFError(f"There is no optimizer {name!r}", f"Choose {', '.join(self.terms)}.")
        candidate = self._candidates[index[0]]
        if not isinstance(candidate, BlockEnsemble | Pruned):
            return clone(self._estimator).set_params(optimizer=candidate)
        kept = self.terms[name] != 0
        support = {s: kept.loc[str(s)].to_numpy() for s in self._order.layout.acting}
        laws = restricted(self._held, self._order, support).layout.laws
        given = {str(s): list(v) for s, v in laws.items()}
        return clone(self._estimator).set_params(optimizer=None, laws=given, orders=None)

    def __repr__(self) -> str:
        rows = self.table[self.table["chosen"]]
        found = ", ".join(f"{name} {setting}: {row.terms} terms" for (name, setting), row in rows.iterrows())
        return f"SparsitySelection(best={self.best!r}; {found})"


def default_paths() -> dict[str, list[Any]]:
    """Settings tried by :func:`select_sparsity`: what carries less than a share of the balance's force goes."""
    import pysindy as ps

    return {
        "STLSQ": [ps.STLSQ(threshold=t) for t in SHARES],
        "ensemble": [BlockEnsemble(ps.STLSQ(threshold=t)) for t in SHARES],
        "SR3": [ps.SR3(reg_weight_lam=t**2 / 2) for t in SHARES],
        "SSR": [AlongPath(ps.SSR(max_iter=200), t) for t in SHARES],
        "FROLS": [AlongPath(ps.FROLS(max_iter=200), t) for t in SHARES],
    }


def select_sparsity(
    X: Any, F: Any = None, *, paths: Mapping[str, Sequence[Any]] | Iterable[str] | None = None, degree: Any = 3,
    cv: Any = 6, prune: bool = True, random_state: Any = 0, record: Any = None, time: Any = None,
    base_acceleration: Any = None, covariates: Any = None, **regressor_params: Any,
) -> SparsitySelection:  # fmt: skip
    """Choose the threshold of every sparse optimizer by held-out balance error, from one pass over the samples.

    For each setting the terms are chosen and fitted on the training side of every fold and judged on its
    other side; within each optimizer the sparsest setting is taken whose error the folds cannot tell from the
    least (one standard error of the difference). One threshold serves all storeys alike; so the path then goes on
    from there term by term, as long as the same rule misses none of them (``prune``).

    Parameters
    ----------
    X, F, record, time, base_acceleration, covariates, cv
        As for :func:`~pysindy_nrf.selection.select_order`.
    paths : mapping of str to sequence of PySINDy optimizers, or names of the default ones, optional
        Settings by name; STLSQ, ensemble (of block bootstraps), SR3, SSR and FROLS if None.
    degree : int or (int, int)
        Of the power series that is thinned out.
    prune : bool
        Go on beyond the chosen setting; each step is one more setting, named ``"... without v^2 s of storey 4"``.
    random_state : int, Generator or None
        For the bootstraps of the ensembles.
    **regressor_params
        Of :class:`NRFRegressor`: ``strategy``, ``known_masses``, ``laws`` (kept whole), ``band``, ...

    Returns
    -------
    SparsitySelection
        ``table`` (one row for each setting), ``terms`` (coefficients of the chosen ones), ``best`` (optimizer);
        ``regressor()`` gives an estimator with the chosen setting.

    Raises
    ------
    NRFError
        If nothing could be fitted on every fold.

    Examples
    --------
    >>> import pysindy as ps
    >>> from pysindy_nrf import datasets, selection
    >>> settings = [ps.STLSQ(threshold=share) for share in (0.002, 0.02)]
    >>> found = selection.select_sparsity(datasets.load_demo(), paths={"STLSQ": settings})
    >>> found.best, found.table["chosen"].tolist()
    ('STLSQ', [False, True])
    """
    estimator = NRFRegressor(degree=degree, **regressor_params)
    given: Mapping[str, Sequence[Any]] = default_paths()
    if paths is not None:
        unknown = [] if isinstance(paths, Mapping) else [name for name in paths if name not in given]
        if unknown:
            raise NRFError(f"There is no default path {unknown[0]!r}", f"Choose from {', '.join(given)}.")
        given = dict(paths) if isinstance(paths, Mapping) else {name: given[name] for name in paths}
    candidates = {(name, setting_of(one)): one for name, path in given.items() for one in path}
    if not candidates:
        raise NRFError("There is no optimizer to choose from", "Leave paths out, or name some.")
    held = fold_moments_of(estimator, [degree], X, F, cv, dict(
        record=record, time=time, base_acceleration=base_acceleration, covariates=covariates
    ))  # fmt: skip
    order = held.order(dict.fromkeys(held.union, degree))
    rng = generator(random_state)
    seeds = {name: int(rng.integers(2**31)) for name in candidates}
    found = _judged(held, order, candidates, seeds)
    if prune:
        _pruned(held, order, candidates, found)
    return _selection(found, candidates, estimator, order, held)


def setting_of(candidate: Any) -> str:
    """The parameters in which a candidate differs from the default, in words."""
    inner = getattr(candidate, "optimizer", None)
    if isinstance(candidate, Pruned):
        gone = ", ".join(f"{label} of {site}" for site, label in candidate.without)
        return f"{setting_of(candidate.optimizer)} without {gone}"
    if isinstance(candidate, AlongPath):
        return f"tolerance={candidate.tolerance:g}"
    text = setting_of(inner) if inner is not None else ""
    if isinstance(candidate, BlockEnsemble) or inner is not None:
        return text
    default = type(candidate)().get_params()
    own = {k: v for k, v in candidate.get_params().items() if k in default and default[k] is not v and default[k] != v}
    return ", ".join(f"{k}={v:g}" if isinstance(v, float) else f"{k}={v}" for k, v in own.items()) or "default"


def _judged(held: FoldMoments, order: Order, candidates: Mapping[Any, Any], seeds: Mapping[Any, int]) -> dict:
    """Held-out errors on the folds, the fit to everything and the inclusion, for each candidate."""
    out = {}
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        for name, candidate in candidates.items():
            fit = _fitter(held, order, candidate, seeds[name])
            errors = np.array([_heldout_error(held, fit, fold) for fold in range(held.n_folds)])
            try:
                solution, kept, shares = fit(None)
            except NRFError:
                solution, kept, shares, errors = None, order, None, np.full(held.n_folds, np.inf)
            out[name] = errors, solution and _whole(order, kept, solution), shares
    return out


def _pruned(held: FoldMoments, order: Order, candidates: dict, found: dict) -> None:
    """Lengthen the path of each optimizer beyond its chosen setting."""
    for name in dict.fromkeys(name for name, _ in candidates):
        path = [key for key in candidates if key[0] == name and found[key][1]]
        if not path:
            continue
        errors = np.array([found[key][0] for key in path]) / 100.0
        chosen = path[choose(errors, [_terms(found[key][1]) for key in path], min_gain=MARGIN, paired=True)]
        least = errors[np.argmin(errors.mean(axis=1))]
        for gone, kept, own in list(pruned(held, order, support_of(found[chosen][1]), least)):
            candidate = Pruned(candidates[chosen], gone)
            key = name, setting_of(candidate)
            candidates[key] = candidate
            found[key] = 100.0 * own, _whole(order, kept, held.fit(kept, None)[0]), found[chosen][2]


def _terms(whole: Mapping[Any, np.ndarray]) -> int:
    return sum(int(kept.sum()) for kept in support_of(whole).values())


def _fitter(held: FoldMoments, order: Order, candidate: Any, seed: int) -> Callable[[int | None], tuple]:
    """From a fold to its solution, the terms it has, and the inclusion of an ensemble."""

    def plain(fold: int | None) -> tuple[Solution, Order, None]:
        return held.fit(order, fold, candidate)[0], order, None

    def ensemble(fold: int | None) -> tuple[Solution, Order, Any]:
        rng = np.random.default_rng([seed, 0 if fold is None else fold + 1])
        shares = inclusion(held, order, candidate.optimizer, candidate.n_models, rng, fold)
        kept = restricted(held, order, {s: p >= candidate.min_inclusion for s, p in shares.items()})
        return held.fit(kept, fold)[0], kept, shares

    return ensemble if isinstance(candidate, BlockEnsemble) else plain


def _heldout_error(held: FoldMoments, fit: Callable, fold: int) -> float:
    try:
        solution, kept, _ = fit(fold)
        test, *_ = held.total(fold, "test")
        solve_order = held.solve_order(held.total(fold)[0], kept)
        return pooled_error(solution.masses, solution.coefficients, held.cut(test, kept, kept.groups(solve_order)))
    except NRFError:
        return np.inf


def _whole(order: Order, kept: Order, solution: Solution) -> dict[Any, np.ndarray]:
    """Coefficients of all terms of the order, zero where a term was left out."""
    out = {}
    for site in order.layout.acting:
        values = np.zeros(order.layout.counts[site])
        if site in kept.columns:
            values[np.searchsorted(order.columns[site], kept.columns[site])] = solution.coefficients[site]
        out[site] = values
    return out


def _selection(found: dict, candidates: dict, estimator: Any, order: Order, held: FoldMoments) -> SparsitySelection:
    index = pd.MultiIndex.from_tuples(candidates, names=["optimizer", "setting"])
    errors = np.array([found[name][0] for name in candidates])
    counts = [_terms(found[name][1]) if found[name][1] else order.n_terms + 1 for name in candidates]
    table = pd.DataFrame({"terms": counts, "error": errors.mean(axis=1)}, index=index)
    table["standard_error"] = [standard_error(row) if np.isfinite(row).all() else np.inf for row in errors]
    table["chosen"] = False
    terms, shares = {}, {}
    for name in dict.fromkeys(index.get_level_values(0)):
        rows = np.flatnonzero(index.get_level_values(0) == name)
        best = rows[choose(errors[rows] / 100.0, [counts[i] for i in rows], min_gain=MARGIN, paired=True)]
        table.iloc[best, table.columns.get_loc("chosen")] = True
        _, whole, included = found[tuple(index[best])]
        terms[name] = labels_of(order, whole)
        if included is not None:
            shares[name] = labels_of(order, included)
    fold_errors = pd.DataFrame(errors, index=index, columns=[f"fold {i + 1}" for i in range(held.n_folds)])
    axes = ["site", "term"]
    kept, included = (pd.DataFrame(x).rename_axis(axes) if x else pd.DataFrame() for x in (terms, shares))
    labelled = {name: labels_of(order, whole) for name, (_, whole, _) in found.items() if whole}
    supports = {name: [key for key, value in whole.items() if value] for name, whole in labelled.items()}
    return SparsitySelection(table, fold_errors, kept, included, supports, candidates, estimator, order, held)
