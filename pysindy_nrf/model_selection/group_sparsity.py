"""Groups of terms that come or go together: a storey is linear or not, a law is in or out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from sklearn.base import clone

from ..errors import pooled_error
from ..exceptions import NRFError
from ..layout import numbered
from ..sites import Site
from .fold_moments import FoldMoments, Order
from .judged import CLEAN
from .rule import choose
from .selection import fold_moments_of
from .supports import MARGIN, restricted

if TYPE_CHECKING:
    from ..regressor import NRFRegressor

NONLINEAR = "nonlinear terms"


class GroupSelection:
    """What :func:`select_groups` found.

    Attributes
    ----------
    kept : list of (site, group)
        Groups that the data need: ``"nonlinear terms"`` of a storey, or the name of a law
        (with its number where a site holds several of that name).
    dropped : list of (site, group)
        In the order in which they went.
    linear : list of str
        Storeys for which a linear law will do.
    table : DataFrame
        One row for each step of the elimination: what was left out with all before it, number of ``terms``, held-out
        balance ``error`` (percent NRMSE, mean over the folds), ``chosen``.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.model_selection import select_groups
    >>> found = select_groups(datasets.load_demo())  # a cubic spring in storey 1
    >>> found.linear
    ['storey 3', 'storey 2']
    """

    def __init__(
        self,
        held: FoldMoments,
        order: Order,
        path: Sequence[tuple[Any, Order]],
        errors: np.ndarray,
        chosen: int,
        estimator: Any,
    ) -> None:
        gone = [group for group, _ in path[1 : chosen + 1]]
        every = groups_in(held, order)
        self.dropped = [(str(site), name) for site, name in gone]
        self.kept = [(str(site), name) for site, name in every if (site, name) not in gone]
        self.linear = [site for site, name in self.dropped if name == NONLINEAR]
        index = pd.Index(["nothing left out", *(f"{name} of {site}" for (site, name), _ in path[1:])], name="left out")
        self.table = pd.DataFrame(
            {"terms": [one.n_terms for _, one in path], "error": 100.0 * errors.mean(axis=1)}, index=index
        )
        self.table["chosen"] = np.arange(len(path)) == chosen
        self._order, self._estimator = path[chosen][1], estimator

    def regressor(self) -> NRFRegressor:
        """An estimator, not yet fitted, without the groups that were dropped.

        Returns
        -------
        NRFRegressor
        """
        layout = self._order.layout
        laws = {str(s): list(held) for s, held in layout.laws.items()}  # an empty list: nothing is left there
        return clone(self._estimator).set_params(laws=laws, orders=None)

    def __repr__(self) -> str:
        words = [f"{name} of {site}" for site, name in self.kept] or ["none"]
        return f"GroupSelection(kept: {', '.join(words)})"


def groups_in(held: FoldMoments, order: Order) -> dict[tuple[Site, str], np.ndarray]:
    """Groups of a candidate: which terms of its site each holds.

    Parameters
    ----------
    held : FoldMoments
    order : Order

    Returns
    -------
    dict of (Site, str) to ndarray of bool
    """
    out = {}
    for site in order.layout.acting:
        count = order.layout.counts[site]
        if site in held.union:
            degrees = np.array([sum(held.union[site].exponents[i]) for i in order.columns[site]])
            if (degrees > 1).any():
                out[site, NONLINEAR] = degrees > 1
            continue
        at = 0
        laws = order.layout.laws[site]
        for law, name in zip(laws, numbered([law.name for law in laws])):
            mask = np.zeros(count, dtype=bool)
            mask[at : (at := at + len(law.terms()))] = True
            out[site, name] = mask
    return out


def select_groups(
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
) -> GroupSelection:
    """Say which storeys are nonlinear and which of the given laws are needed, by backward elimination.

    Step by step the group is left out whose absence raises the held-out balance error least; the smallest model is
    taken whose error the folds cannot tell from the least (one standard error of the difference). Every model
    is fitted again, from moments of one pass.

    Parameters
    ----------
    X, F, record, time, base_acceleration, covariates
        As for :meth:`NRFRegressor.fit`; records are fused.
    degree : int or (int, int)
        Of the power series in storeys without given laws.
    cv : int, splitter or iterable of (train, test)
    **regressor_params
        Of :class:`NRFRegressor`; each law in ``laws`` is a group.

    Returns
    -------
    GroupSelection

    Raises
    ------
    NRFError
        If there is no group to choose from, or the full model cannot be fitted.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, excitation, laws, simulate
    >>> from pysindy_nrf.model_selection import select_groups
    >>> linear = laws.LinearViscous(100.0), laws.LinearElastic(1e5)
    >>> cubic = laws.LinearViscous(100.0), laws.Duffing(1e5, 4e8)
    >>> truth = ChainModel([10.0, 12.0], {"storey 1": linear, "storey 2": cubic})
    >>> F = excitation.band_limited_random(2, 4.0, 1000.0, dofs=[2], rms=100.0, band=(1, 60), random_state=0)
    >>> select_groups(simulate(truth, F, 1e-3)).linear
    ['storey 1']
    """
    from ..regressor import NRFRegressor

    estimator = NRFRegressor(degree=degree, **regressor_params)
    given = dict(record=record, time=time, base_acceleration=base_acceleration, covariates=covariates)
    held = fold_moments_of(estimator, [degree], X, F, cv, given, searching=False)
    order = held.order(dict.fromkeys(held.union, degree))
    path, errors = _eliminated(held, order)
    if held.kind == "gram" and errors.min() < CLEAN:
        held.sharpen()
        path, errors = _eliminated(held, order)
    chosen = choose(errors, [one.n_terms for _, one in path], min_gain=MARGIN, paired=True)
    return GroupSelection(held, order, path, errors, chosen, estimator)


def _eliminated(held: FoldMoments, order: Order) -> tuple[list[tuple[Any, Order]], np.ndarray]:
    groups = groups_in(held, order)
    if not groups:
        raise NRFError("There is no group to choose from", "Give a degree above 1, or laws=.")
    support = {s: np.ones(order.layout.counts[s], dtype=bool) for s in order.layout.acting}
    path: list[tuple[Any, Order]] = [(None, order)]
    errors = [heldout_errors(held, order)]
    if not np.isfinite(errors[0]).all():
        raise NRFError("The full model cannot be fitted on every fold", "Use fewer folds or a lower degree.")
    while groups:
        trials = {}
        for key, mask in groups.items():
            smaller = {**support, key[0]: support[key[0]] & ~mask}
            one = restricted(held, order, smaller)
            trials[key] = heldout_errors(held, one), one, smaller
        key = min(trials, key=lambda k: trials[k][0].mean())
        found, one, support = trials[key]
        if not np.isfinite(found).all():
            break
        groups.pop(key)
        path.append((key, one))
        errors.append(found)
    return path, np.array(errors)


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


__all__ = ["GroupSelection", "groups_in", "select_groups"]
