"""The linear twin of an identification: k + q = 1 in eq. (2)."""

from __future__ import annotations

from typing import Any

from sklearn.base import clone

from ..laws import PowerSeries
from ..regression.chain_model import ChainModel, as_model


def linear_twin(estimator: Any) -> Any:
    """The same regressor with linear storeys, ``R = c v + k s`` (paper eq. 19).

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
