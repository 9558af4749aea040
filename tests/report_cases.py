"""Records and reports for the tests of the page and of its evidence; reports come from
the whole loop on few laws.
"""

from functools import cache

import numpy as np
from chains import band_limited, integrate

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.simulation.noise import add_noise

NASTY = "</script><img src=x onerror=alert(1)>"
CATALOGUE = (
    laws.CoulombFriction(),
    laws.CubicStiffness(),
    laws.QuadraticDamping(),
    laws.Dahl(),
)
M, C, K = (
    np.array([12.0, 10.0, 8.0]),
    np.array([40.0, 30.0, 25.0]),
    np.array([4.0e4, 3.5e4, 3.0e4]),
)
K3, FC = 1.2e9, 9.0
DT = 1e-3
TWO_STOREYS = ChainModel(
    [8.0, 6.0],
    {1: laws.PowerSeries(1, [30.0, 4e4]), 2: laws.PowerSeries(1, [20.0, 3e4])},
)


def _on_storey_2(force):
    def extra(x, v):
        R = force(x[1] - x[0], v[1] - v[0])
        return np.array([R, -R, 0.0])

    return extra


friction = _on_storey_2(lambda s, v: FC * np.tanh(v / 1e-3))
cubic = _on_storey_2(lambda s, v: K3 * s**3)


@cache
def record(effect=None, seed=1, n_samples=5000, noise=0.0, name="test"):
    """A three-storey chain, forced on every floor, with an effect on storey 2."""
    rng = np.random.default_rng(seed)
    F = np.column_stack(
        [band_limited(n_samples, DT, rng, 60.0, (0.5, 25.0)) for _ in M]
    )
    a, v, s = integrate(M, C, K, 0.0 * K, F, DT, extra=effect)
    x, xdot = np.cumsum(s, axis=1), np.cumsum(v, axis=1)
    rec = Record(
        force=F, acceleration=a, velocity=xdot, displacement=x, fs=1 / DT, name=name
    )
    return add_noise(rec, noise, random_state=seed + 1) if noise else rec


@cache
def loop_report(effect=friction, noise=0.01):
    """A closed loop on such a chain."""
    rec = record(effect, seed=3, noise=noise, name="shaker <b>1</b>")
    return close_loop(rec, catalogue=list(CATALOGUE), max_steps=2)


@cache
def nasty_report():
    """A closed loop on a record whose name and covariate are markup."""
    rec = record(cubic)
    rec = rec.replace(
        name=NASTY, covariates={NASTY: np.sin(np.arange(rec.n_samples) / 50)}
    )
    return close_loop(rec, catalogue=list(CATALOGUE[:2]), max_steps=1)


@cache
def regressor():
    """A regressor fitted to a record, and the record."""
    rec = record(cubic)
    return NRFRegressor(degree=3).fit(*rec.to_features(smooth=False)), rec


def two_storeys(seed=0, n=4000, fs=500.0, ag=None, name="r"):
    """Free run of a linear frame of 8 and 6 kg, forced on both floors or shaken at its
    base.
    """
    force = excitation.band_limited_random(
        2, n / fs, fs, excited=[1, 2], rms=60.0, band=(1, 40), random_state=seed
    )
    return simulate(
        TWO_STOREYS,
        force if ag is None else 0.0 * force,
        1 / fs,
        base_acceleration=ag,
        name=name,
    )
