"""Comparison of models of one structure: linear models, differences of parameters and forces, total mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone

from ..exceptions import ChainError
from ..laws import PowerSeries
from ..regression.chain_model import ChainModel, as_model, as_segments, storey_names
from ..regression.errors import nrmse


def linear_twin(estimator: Any) -> Any:
    """The regressor with linear storeys, ``R = c v + k s`` (paper eq. 19).

    Fit it to a test of the structure without its nonlinear devices; the difference of the two
    models is the devices' force (:func:`damper_force`).

    Parameters
    ----------
    estimator : NRFRegressor

    Returns
    -------
    NRFRegressor
        Not fitted.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor
    >>> from pysindy_nrf.estimation import linear_twin
    >>> linear_twin(NRFRegressor(degree=3, band=(1, 60)))
    NRFRegressor(band=(1, 60), degree=1)
    """
    return clone(estimator).set_params(degree=1, orders=None, laws=None)


def linear_part(model: Any) -> ChainModel:
    """A model with only the terms v and s of every site.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor

    Returns
    -------
    ChainModel

    Notes
    -----
    The linear terms of a cubic series are the tangent at rest, not the best line through a loop;
    for the latter fit a :func:`linear_twin`.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.estimation import linear_part
    >>> model = ChainModel([10.0], {1: laws.Duffing(k=4e4, k3=1e9)})
    >>> print(linear_part(model))
    m1 = 10 kg
    R1 = 0 v1 + 4e+04 s1
    """
    model = as_model(model)
    held = {
        site: (PowerSeries(1, force.linear_part().to_numpy()),)
        for site, force in model.restoring_forces.items()
        if force.laws
    }
    return ChainModel(model.masses, held, model.chain, model.visited)


def total_mass(models: Mapping[str, Any], weighed: float | None = None) -> pd.DataFrame:
    """Masses of several models, their total, and its difference from the weighed mass.

    Parameters
    ----------
    models : mapping of str to ChainModel or fitted NRFRegressor
    weighed : float, optional
        Mass of the structure on the scales, kg.

    Returns
    -------
    DataFrame
        One row for each model: ``m1``.. and ``total`` in kg, ``gap`` in percent of ``weighed``.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.estimation import total_mass
    >>> table = total_mass({"frame": datasets.demo_truth()}, weighed=31.0)
    >>> table.round(2).loc["frame", ["total", "gap"]].tolist()  # kg, %
    [30.0, -3.23]
    """
    rows = {name: as_model(model).masses for name, model in models.items()}
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.columns = [f"m{j + 1}" for j in table.columns]
    table["total"] = table.sum(axis=1)
    if weighed is not None:
        table["gap"] = 100.0 * (table["total"] / weighed - 1.0)
    return table


def model_agreement(first: Any, second: Any, X: Any, **options: Any) -> pd.DataFrame:
    """Compare two models of one structure, e.g. found under complete and incomplete excitation.

    Parameters
    ----------
    first, second : ChainModel or fitted NRFRegressor
    X, **options
        A motion on which the forces are compared, as for :meth:`ChainModel.predict`.

    Returns
    -------
    DataFrame
        One row for each storey: ``mass`` (difference of the mass above it, percent of the
        first), ``k`` and ``c`` (differences of the linear terms, percent), ``force`` (rms difference of
        the forces along X, percent of their rms). ``k`` and ``c`` are NaN for a storey that the chain lacks.

    Raises
    ------
    ChainError
        If one of them is not a model, or their numbers of DOFs differ.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, datasets, laws
    >>> from pysindy_nrf.estimation import model_agreement
    >>> X, F = datasets.load_demo().to_features()
    >>> truth = datasets.demo_truth()
    >>> softer = ChainModel(truth.masses, {**truth.laws, "storey 2": [laws.PowerSeries(1, [25.0, 0.9 * 35e3])]})
    >>> model_agreement(truth, softer, X).loc["storey 2", ["mass", "k"]].astype(float).round(1).tolist()
    [0.0, -10.0]
    """
    one, two = as_model(first), as_model(second)
    if one.n_dof != two.n_dof:
        raise ChainError(f"The models have {one.n_dof} and {two.n_dof} DOFs", "Compare models of one structure.")
    data = as_segments(first, X, **options)
    R1, R2 = one.restoring_force(data), two.restoring_force(data)
    linear = [linear_part(m).restoring_forces for m in (one, two)]
    rows = {}
    for i, name in enumerate(storey_names(one)):
        a, b = (f[name].linear_part() if name in f else {"k": np.nan, "c": np.nan} for f in linear)
        rows[name] = {
            "mass": 100.0 * (two.masses[i] / one.masses[i] - 1.0),
            "k": 100.0 * (b["k"] / a["k"] - 1.0),
            "c": 100.0 * (b["c"] / a["c"] - 1.0),
            "force": nrmse(R1[:, i], R2[:, i]),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def found_twice(estimator: Any, X: Any, F: Any, **options: Any) -> dict[str, pd.DataFrame]:
    """Both estimates of every storey that enters two balances (paper eqs. 10a and 10b).

    Under complete excitation R_i is in balance i and, with opposite sign, in balance i-1.

    Parameters
    ----------
    estimator : fitted NRFRegressor
        Of complete strategy.
    X, F, **options
        As for its ``fit``.

    Returns
    -------
    dict of str to DataFrame
        By storey: coefficients by term from the ``"balance i"`` (the one returned by the
        regressor) and from ``"balance i-1"``.

    Raises
    ------
    ChainError
        If the strategy was not complete.

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
    >>> from pysindy_nrf.estimation import found_twice
    >>> storey = laws.PowerSeries(1, [30.0, 4e4])
    >>> truth = ChainModel([10.0, 10.0], {1: storey, 2: storey})
    >>> F = excitation.band_limited_random(2, 4.0, 500.0, dofs=[1, 2], rms=50.0, band=(1, 60), random_state=0)
    >>> X, F = simulate(truth, F, 0.002).to_features(smooth=False)
    >>> found_twice(NRFRegressor(degree=1).fit(X, F), X, F)["storey 2"].round(3)
       balance 2  balance 1
    v       30.0       30.0
    s    40000.0    40000.0
    """
    strategy = estimator.solve_order_.strategy
    if strategy != "complete":
        raise ChainError(f"The {strategy} strategy estimates no storey twice", "Force every DOF.")
    data = as_segments(estimator, X, F, **options)
    problem = replace(estimator.problem_, optimizer=None)
    layout, solution = problem.layout, problem.solve(data).solution
    return {
        str(site): pd.DataFrame(
            {f"balance {site.p}": solution.coefficients[site], f"balance {site.q}": twin}, index=layout.labels(site)
        )
        for site, twin in sorted(solution.twins.items())
    }
