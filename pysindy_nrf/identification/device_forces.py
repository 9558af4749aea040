"""Nonlinear devices: their forces and energy, and the linear part of a model."""

from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid

from ..chain.model import ChainModel, as_model, as_segments, frame, storey_names
from ..laws import PowerSeries


def linear_part(model: Any) -> ChainModel:
    """A model with only the terms v and s of every site: the tangent at rest, not the
    best line through a loop.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor

    Examples
    --------
    >>> from pysindy_nrf import ChainModel, identification, laws
    >>> print(
    ...     identification.linear_part(
    ...         ChainModel([10.0], {1: laws.Duffing(k=4e4, k3=1e9)})
    ...     )
    ... )
    m1 = 10 kg  (R in N, s in m, v in m/s)
    R1 = 0 v1 + 4e+04 s1
    """
    model = as_model(model)
    forces = {
        site: force.linear_part()
        for site, force in model.restoring_forces.items()
        if force.laws
    }
    held = {site: (PowerSeries(1, part.to_numpy()),) for site, part in forces.items()}
    return ChainModel(model.masses, held, model.chain, model.visited)


def damper_force(model: Any, linear: Any, X: Any, **options: Any) -> pd.DataFrame:
    """Identified force of every storey less that of the bare structure (paper eq. 21),
    :math:`R^{non} - R^{lin}`.

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
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.identification import damper_force
    >>> bare = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> damped = ChainModel(
    ...     [10.0],
    ...     {1: [laws.PowerSeries(1, [150.0, 1e5]), laws.CubicStiffness(1e9)]},
    ... )
    >>> damper_force(damped, bare, np.array([[0.0, 0.1, 0.001]]))[
    ...     "storey 1"
    ... ].round(6).tolist()  # 50 v + 1e9 s^3
    [6.0]
    """
    whole, bare = as_model(model), as_model(linear)
    data = as_segments(model, X, **options)
    forces = whole.restoring_force(data) - bare.restoring_force(data)
    return frame(
        data,
        [forces[seg.rows][seg.valid] for seg in data.segments],
        storey_names(whole),
    )


def dissipated_energy(
    model: Any, X: Any, without: Any = None, **options: Any
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
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.identification import dissipated_energy
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [30.0, 4e4])})
    >>> t = np.linspace(0, 4 * np.pi, 4001)
    >>> energy = dissipated_energy(
    ...     model, np.column_stack([-np.sin(t), np.cos(t), np.sin(t)]), time=t
    ... )  # a, v, s
    >>> float(
    ...     energy["storey 1"].iloc[-1].round(1)
    ... )  # c times the integral of v^2: 30 times 2 pi
    188.5
    """
    whole = as_model(model)
    data = as_segments(model, X, **options)
    forces = whole.restoring_force(data)
    if without is not None:
        forces = forces - as_model(without).restoring_force(data)
        stiffness = np.zeros(whole.n_dof)
    else:
        linear = linear_part(whole).restoring_forces
        stiffness = np.array(
            [
                linear[i].linear_part()["k"] if i in linear else 0.0
                for i in range(1, whole.n_dof + 1)
            ]
        )
    parts = []
    for seg in data.segments:
        s = seg.s[seg.valid].astype(float)
        stored = 0.5 * stiffness * (s**2 - s[0] ** 2)
        R = forces[seg.rows][seg.valid]
        if seg.t is None:
            work = cumulative_trapezoid(R, s, axis=0, initial=0.0)
        else:  # more exact than the area of the sampled loops
            work = cumulative_trapezoid(
                R * seg.v[seg.valid], seg.t[seg.valid], axis=0, initial=0.0
            )
        parts.append(work - stored)
    return frame(data, parts, storey_names(whole))
