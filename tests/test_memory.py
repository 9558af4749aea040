"""The state of a law with memory along a sampled motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import laws
from pysindy_nrf.laws.base import ForceLaw, Motion, Term
from pysindy_nrf.laws.memory import state_path

SIGMA = 5e3


def two_tones(t):
    s = 1e-3 * np.sin(60 * t) + 4e-4 * np.sin(171 * t + 1)
    v = 0.06 * np.cos(60 * t) + 0.0684 * np.cos(171 * t + 1)
    a = -3.6 * np.sin(60 * t) - 11.6964 * np.sin(171 * t + 1)
    return s, v, a


def reference(t):
    """Dahl's differential equation (paper eq. 7) by an independent integrator."""

    def rate(t, z):
        v = two_tones(t)[1]
        return [SIGMA * (v - z[0] * abs(v))]

    return solve_ivp(rate, (0, t[-1]), [0.0], method="DOP853", rtol=1e-11, atol=1e-13, t_eval=t, max_step=1e-4).y[0]


@pytest.mark.parametrize("with_a, bound", [(True, 2e-6), (False, 2e-3)])
def test_path_solves_the_differential_equation(with_a, bound):
    t = np.arange(401) / 1000
    s, v, a = two_tones(t)
    z = laws.Dahl(sigma=SIGMA).features(Motion(s, v, a if with_a else None, t))[:, 0]
    np.testing.assert_allclose(z, reference(t), atol=bound)


def test_path_in_blocks_that_share_a_sample_is_the_same_to_the_last_bit():
    t = np.arange(2001) / 1000
    s, v, a = two_tones(t)
    law = laws.Dahl(sigma=SIGMA)
    none = np.empty((0, len(t)))
    whole = state_path(law, Motion(s, v, a, t), none, law.theta)
    state, pieces = np.zeros(1), []
    for start in range(0, 2000, 250):
        rows = slice(start, start + 251)
        piece = state_path(law, Motion(s[rows], v[rows], a[rows], t[rows]), none[:, rows], law.theta, state)
        assert state[0] == piece[0, -1]
        pieces.append(piece[:, 1:])
    assert np.array_equal(np.hstack([whole[:, :1], *pieces]), whole)


def test_velocity_that_contradicts_the_drift_takes_the_straight_way():
    t = np.arange(3) / 1000
    s, v = np.array([0.0, 1e-3, 2e-3]), np.array([1.0, -1.0, 1.0])
    z = laws.Dahl(sigma=500.0).features(Motion(s, v, t=t))[:, 0]
    np.testing.assert_allclose(z, 1 - np.exp(-500.0 * s), rtol=1e-14)


def test_law_that_needs_time_says_so_and_a_user_law_is_compiled():
    class Lag(ForceLaw):
        name = "test_lag"
        n_states = 1

        def terms(self):
            return (Term("c", "Z", "N"),)

        @staticmethod
        def kernel(s, v, a, t, u, z, theta, out):
            out[0] = z[0]

        @staticmethod
        def advance(z, s0, v0, s1, v1, dt, u, theta):
            z[0] = z[0] + (0.5 * (s0 + s1) - z[0]) * (1 - np.exp(-dt / 0.1))

    t = np.linspace(0, 1, 1001)
    s = np.ones_like(t)
    np.testing.assert_allclose(Lag().features(Motion(s, 0 * t, t=t))[:, 0], 1 - np.exp(-t / 0.1), atol=1e-12)
    with pytest.raises(ValueError, match="needs the time"):
        Lag().features(Motion(s, 0 * t))
