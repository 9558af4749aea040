"""Records and reports for the tests of the page and of its evidence.

Reports come from the whole loop on few laws.
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
from pysindy_nrf.simulation import add_noise

NASTY = "</script><img src=x onerror=alert(1)>"
CATALOGUE = (
    laws.CoulombFriction(),
    laws.CubicStiffness(),
    laws.QuadraticDamping(),
    laws.Dahl(),
)
# masses, kg, dampings, N s/m, and stiffnesses, N/m, of a three-storey chain
M = np.array([12.0, 10.0, 8.0])
C = np.array([40.0, 30.0, 25.0])
K = np.array([4.0e4, 3.5e4, 3.0e4])
# a cubic spring, N/m^3, and dry friction, N, in its storey 2
K3 = 1.2e9
FC = 9.0
DT = 1e-3
TWO_STOREYS = ChainModel(
    [8.0, 6.0],
    {1: laws.PowerSeries(1, [30.0, 4e4]), 2: laws.PowerSeries(1, [20.0, 3e4])},
)


def on_storey_2(force):
    """A force between floors 1 and 2 of three, by drift and rate."""

    def on_floors(x, v):
        R = force(x[1] - x[0], v[1] - v[0])
        return np.array([R, -R, 0.0])

    return on_floors


def friction_force(s, v):
    return FC * np.tanh(v / 1e-3)


def cubic_force(s, v):
    return K3 * s**3


friction = on_storey_2(friction_force)
cubic = on_storey_2(cubic_force)


@cache
def record(effect=None, seed=1, n_samples=5000, noise=0.0, name="test"):
    """A three-storey chain, forced on every floor, with an effect on storey 2."""
    rng = np.random.default_rng(seed)
    forces = [band_limited(n_samples, DT, rng, 60.0, (0.5, 25.0)) for _ in M]
    F = np.column_stack(forces)
    a, v, s = integrate(M, C, K, 0.0 * K, F, DT, extra=effect)
    exact = Record(
        force=F,
        acceleration=a,
        velocity=np.cumsum(v, axis=1),
        displacement=np.cumsum(s, axis=1),
        fs=1 / DT,
        name=name,
    )
    return add_noise(exact, noise, random_state=seed + 1) if noise else exact


@cache
def loop_report(effect=friction, noise=0.01):
    """A closed loop on such a chain."""
    measured = record(effect, seed=3, noise=noise, name="shaker <b>1</b>")
    return close_loop(measured, catalogue=list(CATALOGUE), max_steps=2)


@cache
def nasty_report():
    """A closed loop on a record whose name and covariate are markup."""
    exact = record(cubic)
    covariate = np.sin(np.arange(exact.n_samples) / 50)
    nasty = exact.replace(name=NASTY, covariates={NASTY: covariate})
    return close_loop(nasty, catalogue=list(CATALOGUE[:2]), max_steps=1)


@cache
def empty_report():
    """A closed loop on a linear chain, whose catalogue holds nothing that it lacks."""
    linear = record(None, seed=3, noise=0.01)
    return close_loop(linear, catalogue=[laws.CubicStiffness()], max_steps=2)


@cache
def regressor():
    """A regressor fitted to a record, and the record."""
    exact = record(cubic)
    return NRFRegressor(degree=3).fit(*exact.to_features(smooth=False)), exact


def two_storeys(seed=0, n=4000, fs=500.0, ag=None, name="r"):
    """Free run of a linear frame of 8 and 6 kg.

    It is forced on both floors, or shaken at its base.
    """
    force = excitation.band_limited_random(
        2, n / fs, fs, excited=[1, 2], rms=60.0, band=(1, 40), random_state=seed
    )
    if ag is not None:
        force = 0.0 * force
    return simulate(TWO_STOREYS, force, 1 / fs, base_acceleration=ag, name=name)
