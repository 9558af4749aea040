"""Forces of nonlinear devices and the energy that storeys dissipate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChannelError
from ..regression.chain_model import as_model, as_segments, frame, storey_names
from .linear_model import linear_part


def damper_force(model: Any, linear: Any, X: Any, **options: Any) -> pd.DataFrame:
    r"""Identified force of every storey less that of the bare structure (paper eq. 21).

    .. math:: F_{non} = R^{non}(v, s) - R^{lin}(v, s)

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor
        Of the structure with its devices.
    linear : ChainModel or fitted NRFRegressor
        Of the structure without them: see :func:`linear_twin`.
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
    >>> from pysindy_nrf.estimation import damper_force
    >>> bare = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])})
    >>> damped = ChainModel([10.0], {1: [laws.PowerSeries(1, [150.0, 1e5]), laws.CubicStiffness(1e9)]})
    >>> X = np.array([[0.0, 0.1, 0.001]])  # a, v, s
    >>> damper_force(damped, bare, X)["storey 1"].round(6).tolist()  # 50 v + 1e9 s^3
    [6.0]
    """
    whole, bare = as_model(model), as_model(linear)
    data = as_segments(model, X, **options)
    forces = whole.restoring_force(data) - bare.restoring_force(data)
    return frame(data, [forces[seg.rows][seg.valid] for seg in data.segments], storey_names(whole))


def horizontal_component(force: Any, rise: float, run: float) -> np.ndarray:
    """Horizontal component of the force in a diagonal device.

    The force identified in a storey is horizontal, a load cell in a diagonal damper is not.

    Parameters
    ----------
    force : array-like of shape (n_samples,)
        Measured along the device, N.
    rise, run : float
        Vertical and horizontal distance of its ends, m (any one unit).

    Returns
    -------
    ndarray of shape (n_samples,)
        N.

    Raises
    ------
    ChannelError
        If the device has no horizontal extent.

    Examples
    --------
    >>> from pysindy_nrf.estimation import horizontal_component
    >>> horizontal_component([50.0], rise=0.3, run=0.4).round(9).tolist()
    [40.0]
    """
    length = np.hypot(rise, run)
    if not np.isfinite(length) or run <= 0 or rise < 0:
        raise ChannelError(
            f"A device with rise={rise!r} and run={run!r} has no horizontal component",
            "Give the distances of its ends; run must be positive.",
        )
    return np.asarray(force, dtype=float) * (run / length)


def path_energy(force: Any, drift: Any) -> np.ndarray:
    r"""Work of a force along its path, :math:`\int R \, ds`: the area of its loops.

    Parameters
    ----------
    force : array-like of shape (n_samples,) or (n_samples, p)
        N.
    drift : array-like of the same shape
        m.

    Returns
    -------
    ndarray of the same shape
        J, zero at the first sample.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.estimation import path_energy
    >>> phase = np.linspace(0, 2 * np.pi, 2001)
    >>> drift, rate = 0.01 * np.sin(phase), 0.01 * np.cos(phase)
    >>> energy = path_energy(1e5 * drift + 100.0 * rate, drift)  # one cycle of a spring and a dashpot
    >>> bool(np.isclose(energy[-1], np.pi * 100.0 * 0.01**2, rtol=1e-5))
    True
    """
    R, s = np.asarray(force, dtype=float), np.asarray(drift, dtype=float)
    return np.concatenate([np.zeros((1, *R.shape[1:])), np.cumsum(0.5 * (R[1:] + R[:-1]) * np.diff(s, axis=0), axis=0)])


def power_energy(force: Any, rate: Any, time: Any) -> np.ndarray:
    r"""Work of a force over time, :math:`\int R \, v \, dt`.

    On an even clock this is more exact than the area of the sampled loops: the product of two
    signals below a quarter of the sampling rate is summed without error but at its ends.

    Parameters
    ----------
    force, rate : array-like of shape (n_samples,) or (n_samples, p)
        N and m/s.
    time : array-like of shape (n_samples,)
        s.

    Returns
    -------
    ndarray of the same shape as force
        J, zero at the first sample.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.estimation import power_energy
    >>> t = np.linspace(0, 4 * np.pi, 4001)
    >>> work = power_energy(30.0 * np.cos(t), np.cos(t), t)  # a dashpot of 30 N s/m, two cycles
    >>> float(work[-1].round(3)), round(30.0 * 2 * np.pi, 3)
    (188.496, 188.496)
    """
    power = np.asarray(force, dtype=float) * np.asarray(rate, dtype=float)
    dt = np.diff(np.asarray(time, dtype=float)).reshape(-1, *[1] * (power.ndim - 1))
    return np.concatenate([np.zeros((1, *power.shape[1:])), np.cumsum(0.5 * (power[1:] + power[:-1]) * dt, axis=0)])


def dissipated_energy(model: Any, X: Any, without: Any = None, **options: Any) -> pd.DataFrame:
    """Energy dissipated in every storey over time.

    Parameters
    ----------
    model : ChainModel or fitted NRFRegressor
    X, **options
        The motion, as for :meth:`ChainModel.predict`.
    without : ChainModel or fitted NRFRegressor, optional
        Model of the bare structure, whose force is subtracted first: what the devices dissipate
        (paper eq. 21 and Figs. 13, 16). None: what the storeys dissipate, the energy stored in
        their linear stiffness left out.

    Returns
    -------
    DataFrame of shape (n_samples, n_dof)
        ``storey 1``.., J; zero at the start of each record.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.estimation import dissipated_energy
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [30.0, 4e4])})
    >>> t = np.linspace(0, 4 * np.pi, 4001)
    >>> X = np.column_stack([-np.sin(t), np.cos(t), np.sin(t)])  # a, v, s
    >>> energy = dissipated_energy(model, X, time=t)
    >>> float(energy["storey 1"].iloc[-1].round(1))  # c times the integral of v^2: 30 times 2 pi
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
        stiffness = np.array([linear[i].linear_part()["k"] if i in linear else 0.0 for i in range(1, whole.n_dof + 1)])
    parts = []
    for seg in data.segments:
        s = seg.s[seg.valid].astype(float)
        stored = 0.5 * stiffness * (s**2 - s[0] ** 2)
        R = forces[seg.rows][seg.valid]
        work = path_energy(R, s) if seg.t is None else power_energy(R, seg.v[seg.valid], seg.t[seg.valid])
        parts.append(work - stored)
    return frame(data, parts, storey_names(whole))


def energy_shares(model: Any, X: Any, **options: Any) -> pd.DataFrame:
    """What share of the dissipated energy each storey took: a damage index from energy.

    For a linear structure the shares depend on where and how it is excited, not on how hard.
    Friction, yielding or a damper in a storey raises its share; a change of the shares between
    two tests with the same excitation points to the storey that changed.

    Parameters
    ----------
    model, X, **options
        As for :func:`dissipated_energy`.

    Returns
    -------
    DataFrame
        One row for each storey: ``energy`` (J, at the end of the records), ``share`` (percent).

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.estimation import energy_shares
    >>> X, F = datasets.load_demo().to_features()
    >>> shares = energy_shares(datasets.demo_truth(), X)
    >>> float(shares["share"].sum().round(6)), shares["share"].idxmax()
    (100.0, 'storey 3')
    """
    model_, data = as_model(model), as_segments(model, X, **options)
    energy = dissipated_energy(model_, data).to_numpy()
    last = np.sum([energy[seg.rows][seg.valid][-1] for seg in data.segments], axis=0)
    return pd.DataFrame({"energy": last, "share": 100.0 * last / last.sum()}, index=storey_names(model_))
