"""Nonlinear devices: their forces and energy, and the linear part of a model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

from ..chain.model import (
    ChainModel,
    DataOptions,
    as_model,
    as_segments,
    frame,
    storey_names,
)
from ..laws import PowerSeries
from ..records.dataset import Segment

if TYPE_CHECKING:
    from .regressor import NRFRegressor


def linear_part(model: ChainModel | NRFRegressor) -> ChainModel:
    """A model with only the terms v and s of every site.

    That is the tangent at rest, not the best line through a loop.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, identification, laws
    >>> duffing = ChainModel([10.0], {1: laws.Duffing(k=4e4, k3=1e9)})
    >>> print(identification.linear_part(duffing))
    m1 = 10 kg  (R in N, s in m, v in m/s)
    R1 = 0 v1 + 4e+04 s1
    """
    model = as_model(model)
    linear = {}
    for site, force in model.restoring_forces.items():
        if force.laws:
            linear[site] = (PowerSeries(1, force.linear_part().to_numpy()),)
    return ChainModel(model.masses, linear, model.chain, model.visited)


def damper_force(
    model: ChainModel | NRFRegressor,
    linear: ChainModel | NRFRegressor,
    X: object,
    **options: Unpack[DataOptions],
) -> pd.DataFrame:
    r"""Force of every storey less that of the bare structure.

    :math:`R^{non} - R^{lin}`, equation 21 of the paper.

    Parameters
    ----------
    model, linear : ChainModel or fitted NRFRegressor
        Of the structure with its devices, and without them (``NRFRegressor(degree=1)``,
        paper eq. 19).
    X, **options
        The motion, as for :meth:`ChainModel.predict`.

    Returns
    -------
    DataFrame of shape (n_samples, n_dof)
        ``storey 1``.., N, indexed by time where it is known.

    Examples
    --------
    The device adds 50 v + 1e9 s^3:

    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.identification import damper_force
    >>> bare = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> damped = ChainModel(
    ...     [10.0],
    ...     {1: [laws.PowerSeries(1, [150.0, 1e5]), laws.CubicStiffness(1e9)]},
    ... )
    >>> force = damper_force(damped, bare, np.array([[0.0, 0.1, 0.001]]))
    >>> force["storey 1"].round(6).tolist()
    [6.0]
    """
    with_devices = as_model(model)
    data = as_segments(model, X, **options)
    forces = with_devices.restoring_force(data) - as_model(linear).restoring_force(data)
    parts = [_in_record(forces, segment) for segment in data.segments]
    return frame(data, parts, storey_names(with_devices))


def dissipated_energy(
    model: ChainModel | NRFRegressor,
    X: object,
    without: ChainModel | NRFRegressor | None = None,
    **options: Unpack[DataOptions],
) -> pd.DataFrame:
    """Energy dissipated in every storey over time.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor
    X, **options
        The motion, as for :meth:`ChainModel.predict`.
    without : ChainModel or fitted NRFRegressor, optional
        Model of the bare structure, whose force is subtracted: the result is the energy
        dissipated by the devices (paper eq. 21 and Figs. 13, 16). None: the energy
        dissipated by the storeys, without the energy stored in their linear stiffness.

    Returns
    -------
    DataFrame of shape (n_samples, n_dof)
        ``storey 1``.., J; zero at the start of each record.

    Examples
    --------
    A dashpot dissipates c times the integral of v^2, here 30 times 2 pi:

    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.identification import dissipated_energy
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [30.0, 4e4])})
    >>> t = np.linspace(0, 4 * np.pi, 4001)
    >>> motion = np.column_stack([-np.sin(t), np.cos(t), np.sin(t)])
    >>> energy = dissipated_energy(model, motion, time=t)
    >>> float(energy["storey 1"].iloc[-1].round(1))
    188.5
    """
    storeys = as_model(model)
    data = as_segments(model, X, **options)
    forces = storeys.restoring_force(data)
    if without is None:
        stiffness = _linear_stiffness(storeys)
    else:
        forces = forces - as_model(without).restoring_force(data)
        stiffness = np.zeros(storeys.n_dof)

    parts = []
    for segment in data.segments:
        drift = segment.s[segment.valid].astype(float)
        stored = 0.5 * stiffness * (drift**2 - drift[0] ** 2)
        work = _work(_in_record(forces, segment), segment)
        parts.append(work - stored)
    return frame(data, parts, storey_names(storeys))


def _in_record(forces: np.ndarray, segment: Segment) -> np.ndarray:
    """Storey forces in the valid rows of one record."""
    return forces[segment.rows][segment.valid]


def _linear_stiffness(model: ChainModel) -> np.ndarray:
    """Tangent stiffness at rest of every storey, N/m."""
    stiffness = np.zeros(model.n_dof)
    forces = linear_part(model).restoring_forces
    for storey in range(1, model.n_dof + 1):
        if f"storey {storey}" in forces:
            stiffness[storey - 1] = forces[storey].linear_part()["k"]
    return stiffness


def _work(forces: np.ndarray, segment: Segment) -> np.ndarray:
    """Work of storey forces since the start of a record, J."""
    if segment.t is None:
        drift = segment.s[segment.valid].astype(float)
        return cumulative_trapezoid(forces, drift, axis=0, initial=0.0)
    # more exact than the area of the sampled loops
    power = forces * segment.v[segment.valid]
    return cumulative_trapezoid(power, segment.t[segment.valid], axis=0, initial=0.0)
