"""Supports: terms that are kept, their refits and inclusion in bootstraps, and terms that no held-out error needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, clone

from ..exceptions import NRFError
from ..laws import ForceLaw
from ..mechanics.sites import Site
from ..regression.errors import pooled_error
from ..regression.grams import BlockGrams
from ..regression.layout import LawLayout
from .fold_moments import FoldMoments, Monomials, Order
from .one_se_rule import choose


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
            raise NRFError(
                f"{type(self.optimizer).__name__} keeps no history_ of its models", "Use SSR, FROLS or STLSQ."
            )
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
    drawn = rng.choice(chosen, size=len(chosen))
    return held.sum_of(drawn)


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
        (str(site), label): float(value)
        for site in order.layout.acting
        for label, value in zip(order.layout.labels(site), values[site])
    }


@dataclass(frozen=True)
class Pruned:
    """A setting of an optimizer without some of the terms it keeps, refitted by least squares."""

    optimizer: Any
    without: tuple[tuple[str, str], ...]  # site and label of each term left out, in that order


def pruned(
    held: FoldMoments, order: Order, support: Mapping[Site, np.ndarray], least: np.ndarray
) -> list[tuple[tuple[tuple[str, str], ...], dict[Site, np.ndarray], np.ndarray]]:
    """Terms left out one by one from the chosen setting while the held-out rule allows: names, support, errors."""
    gone: tuple[tuple[str, str], ...] = ()
    out: list[tuple[tuple[tuple[str, str], ...], dict[Site, np.ndarray], np.ndarray]] = []
    while (weakest := _weakest(held, order, support)) is not None:
        site, at = weakest
        support = {**support, site: support[site] & (np.arange(len(support[site])) != at)}
        one = restricted(held, order, support)
        errors = heldout_errors(held, one)
        if choose(np.array([least, errors]), [1, 0], min_gain=MARGIN, paired=True) == 0:
            break
        gone = (*gone, (str(site), order.layout.labels(site)[at]))
        out.append((gone, support, errors))
    return out


def _weakest(held: FoldMoments, order: Order, support: Mapping[Site, np.ndarray]) -> tuple[Site, int] | None:
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


def heldout_errors(held: FoldMoments, order: Order) -> np.ndarray:
    """Held-out balance errors on the folds, as shares; infinity where a fold cannot be fitted."""
    out = np.full(held.n_folds, np.inf)
    for fold in range(held.n_folds):
        try:
            solution, solve_order, _ = held.fit(order, fold)
            test = held.cut(held.total(fold, "test")[0], order, order.groups(solve_order))
            out[fold] = pooled_error(solution.masses, solution.coefficients, test) / 100.0
        except NRFError:
            break
    return out
