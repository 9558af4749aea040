"""The state of a law with memory along a sampled motion."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import laws
from pysindy_nrf.laws.base import ForceLaw, Motion, Term
from pysindy_nrf.laws.memory import state_path, state_paths

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


@pytest.mark.parametrize(
    "law, shapes",
    [
        (laws.Dahl(), [{"sigma": x} for x in (1e2, 5e3, 4e4)]),
        (laws.Jenkins(), [{"uy": x} for x in (1e-4, 7e-4, 5e-3)]),
        (laws.Iwan(), [{"uy": 1e-4, "ratio": 2.0}, {"uy": 4e-4, "ratio": 5.0}]),
        (laws.BoucWen(), [{"beta": 900.0, "rho": r, "n": n} for r in (-1.4, 0.5) for n in (1.0, 1.7)]),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_many_shapes_in_one_pass_are_the_single_passes_to_the_last_bit(law, shapes):
    t = np.arange(2000) / 1000
    s, v, a = two_tones(t)
    motions = [Motion(s, v, a, t), Motion(-0.3 * s[:700], -0.3 * v[:700], t=t[:700]), Motion(2 * s[:50], 2 * v[:50])]
    candidates = [law.with_values(shape=shape) for shape in shapes]
    found = state_paths(law, motions, np.array([c.theta for c in candidates]))
    for motion, z in zip(motions, found, strict=True):
        none = np.empty((0, motion.n_samples))
        assert z.shape == (len(shapes), law.n_states, motion.n_samples)
        for one, candidate in zip(z, candidates, strict=True):
            assert np.array_equal(one, state_path(candidate, motion, none, candidate.theta))


def test_many_shapes_of_a_law_with_a_covariate_and_one_that_diverges():
    class Pull(ForceLaw):
        """A state that grows at a rate set by a channel."""

        name = "test_pull"
        n_states = 1
        covariates = ("gain",)

        def terms(self):
            return (Term("c", "Z", "N"),)

        @staticmethod
        def kernel(s, v, a, t, u, z, theta, out):
            out[0] = z[0]

        @staticmethod
        def advance(z, s0, v0, s1, v1, dt, u, theta):
            z[0] = z[0] * theta[0] + u[0]

    s = np.linspace(0, 1, 2000)
    motion = Motion(s, np.ones(2000), covariates={"gain": np.ones(2000)})
    (z,) = state_paths(Pull(), [motion], np.array([[0.5], [2.0]]))
    assert z[0, 0, -1] == pytest.approx(2.0) and not np.isfinite(z[1, 0, -1])  # 1 / (1 - 0.5); 2^k overflows
    with pytest.raises(ValueError, match="needs the covariate 'gain'"):
        state_paths(Pull(), [Motion(s, s)], np.array([[0.5]]))
    with pytest.raises(ValueError, match="not finite"):
        state_paths(laws.Dahl(), [Motion(np.full(9, np.nan), np.ones(9))], np.array([[10.0]]))
