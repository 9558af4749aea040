"""Beyond one threshold for all storeys: terms of the chosen model that no held-out error misses are dropped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.errors import pooled_error
from .fold_moments import FoldMoments, Order
from .one_se_rule import choose
from .supports import MARGIN, restricted


@dataclass(frozen=True)
class Pruned:
    """A setting of an optimizer without some of the terms it keeps, refitted by least squares.

    Parameters
    ----------
    optimizer : PySINDy optimizer or BlockEnsemble
    without : tuple of (str, str)
        Site and label of each term left out, in that order.

    Examples
    --------
    >>> import pysindy as ps
    >>> from pysindy_nrf.selection.pruning import Pruned
    >>> Pruned(ps.STLSQ(threshold=0.01), (("storey 4", "v^2 s"),)).without
    (('storey 4', 'v^2 s'),)
    """

    optimizer: Any
    without: tuple[tuple[str, str], ...]


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
                solution, _, moments = held.fit(one, None)
            except NRFError:
                continue
            rises[site, int(at)] = pooled_error(solution.masses, solution.coefficients, moments)
    return min(rises, key=rises.__getitem__) if rises else None


def heldout_errors(held: FoldMoments, order: Order) -> np.ndarray:
    """Held-out balance errors on the folds, as shares; infinity where a fold cannot be fitted."""
    out = np.full(held.n_folds, np.inf)
    for fold in range(held.n_folds):
        try:
            solution, walk, _ = held.fit(order, fold)
            test = held.cut(held.total(fold, "test")[0], order, order.groups(walk))
            out[fold] = pooled_error(solution.masses, solution.coefficients, test) / 100.0
        except NRFError:
            break
    return out


__all__ = ["Pruned", "pruned"]
