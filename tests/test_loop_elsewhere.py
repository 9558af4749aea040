"""Two effects of which a third law, or a wrong gain of a force, imitates a part while both are missing."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.integrate import solve_ivp

from pysindy_nrf import NRFRegressor, Record, close_loop, laws
from pysindy_nrf.noise import add_noise

FS, M, K, C = 250.0, np.array([6.0, 5.0, 4.0]), np.array([5e4, 4e4, 3e4]), np.array([60.0, 45.0, 36.0])


def swept(in_storeys, unmeasured=(0.0, 0.0, 0.0), at=11.0, size=40.0, duration=20.0, band=(1.0, 30.0), phases=(0.0, 1.0, 2.2)):
    """Three floors by DOP853 under sweeps on all of them, with a force of drift and rate more in the storeys and
    harmonic forces (N, of one frequency in Hz) that no channel tells of."""
    unmeasured = np.asarray(unmeasured)

    def F(t):
        turn = 2 * np.pi * (band[0] * t + (band[1] - band[0]) / (2 * duration) * t**2)
        return size * np.cos(np.add.outer(turn, np.asarray(phases)))

    def a_of(t, x, v):
        s, r = np.diff(x, prepend=0.0), np.diff(v, prepend=0.0)
        R = K * s + C * r + in_storeys(s, r)
        return (F(t) + unmeasured * np.sin(2 * np.pi * at * t) - R + np.append(R[1:], 0.0)) / M

    t = np.arange(int(duration * FS)) / FS
    run = solve_ivp(
        lambda t, y: np.concatenate([y[3:], a_of(t, y[:3], y[3:])]),
        (0, t[-1]), np.zeros(6), "DOP853", t, rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    x, v = run.y[:3].T, run.y[3:].T
    a = np.array([a_of(*row) for row in zip(t, x, v)])
    return Record(force=F(t), acceleration=a, velocity=v, displacement=x, fs=FS)


def quiet_loop(record, catalogue=None, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return close_loop(record, NRFRegressor(degree=1), catalogue=catalogue, **options)
