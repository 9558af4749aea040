"""The state of a law with memory along a sampled motion."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from pysindy_nrf import laws
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.laws import ForceLaw, Motion, Shape, Term


def two_tones(t):
    return Motion(
        s=1e-3 * np.sin(60 * t) + 4e-4 * np.sin(171 * t + 1),
        v=0.06 * np.cos(60 * t) + 0.0684 * np.cos(171 * t + 1),
        a=-3.6 * np.sin(60 * t) - 11.6964 * np.sin(171 * t + 1),
        t=t,
    )


def test_blocks_that_share_a_sample_are_the_whole_to_the_last_bit():
    t = np.arange(2001) / 1000
    law = laws.Dahl(sigma=5e3)
    features = law.features(two_tones(t))
    state = np.zeros(1)
    for start in range(0, 2000, 250):
        rows = slice(start, start + 251)
        block = law.features(two_tones(t[rows]), state)
        assert state[0] == block[-1, 0]
        np.testing.assert_array_equal(block[1:], features[rows][1:])


# -- the path between two samples ----------------------------------------------


class Path(NamedTuple):
    """What a law reads along the parts of a path, one value a part."""

    s0: np.ndarray
    v0: np.ndarray
    s1: np.ndarray
    v1: np.ndarray
    dt: np.ndarray
    level: np.ndarray

    @property
    def drifts(self):
        """Drifts at the ends of all parts."""
        np.testing.assert_array_equal(self.s0[1:], self.s1[:-1])
        return np.append(self.s0[:1], self.s1)


N_PARTS = 8


class Diary(ForceLaw):
    """Its state notes the parts of the path along which it is moved, the last eight.

    The state is their number, and then the numbers of each part.
    """

    columns = (Term("c", "count", "N"),)
    shapes = (Shape("pace", "1", 1.0, 2.0),)  # not read
    n_states = 1 + 6 * N_PARTS
    covariates = ("level",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        row = 1 + 6 * (int(z[0]) % N_PARTS)
        z[row] = s0
        z[row + 1] = v0
        z[row + 2] = s1
        z[row + 3] = v1
        z[row + 4] = dt
        z[row + 5] = u[0]
        z[0] += 1.0


DIARY = Diary(pace=1.5)


def path_of(motion):
    """The path that a law is moved along."""
    state = np.zeros(Diary.n_states)
    columns = DIARY.features(motion, state)
    count = int(state[0])
    assert columns[-1, 0] == count
    rows = state[1:].reshape(N_PARTS, 6)[:count]
    return Path(*rows.T)


def sampled(drift, times, with_a=True, with_t=True):
    """A motion that is a polynomial of the time, known at a few times."""
    t = np.asarray(times, dtype=float)
    return Motion(
        drift(t),
        drift.deriv()(t),
        drift.deriv(2)(t) if with_a else None,
        t if with_t else None,
        {"level": np.arange(1.0, len(t) + 1.0)},
    )


STEP = 0.02  # s
SIZE = 1e-3  # m


class Turns(NamedTuple):
    """A drift by time within a step, and the shares of the step where it turns."""

    drift: Polynomial
    shares: list[float]

    @property
    def edges(self):
        """Times at which the parts of the path begin and end."""
        return STEP * np.array([0.0] + self.shares + [1.0])


def turns(shares, factor=(1.0,), other_roots=()):
    """A drift that turns at shares of the step; its rate has a further factor."""
    rate = Polynomial(factor)
    for root in shares + list(other_roots):
        rate = rate * Polynomial([-root, 1.0])
    by_share = rate.integ()
    powers = STEP ** np.arange(len(by_share.coef))
    return Turns(Polynomial(SIZE * by_share.coef / powers), shares)


# without accelerations the path is a cubic, with them a quintic
CUBICS = {
    "parabola": turns([0.3]),
    "cubic": turns([0.3], other_roots=[-1.0]),
    "cubic, late": turns([0.8], (-1.0, 0.2)),
}
QUINTICS = {
    "none": turns([], (1.0, 0.5)),
    "parabola, late": turns([0.9]),
    "quintic": turns([0.4], (1.0, 0.3, -0.2, 0.8)),
    "quintic, early": turns([0.15], (-1.0, 0.5, 0.3, -0.4)),
    "dips only": turns([], (0.35, -1.0, 1.0)),
}
TWICE = {
    "twice": turns([0.2, 0.7], (1.0, 0.0, 1.0)),
    "twice, late": turns([0.45, 0.85], (-1.0, 0.1, -0.3)),
    "twice, and once later": turns([0.2, 0.7], (1.6, -1.0)),
}
TURNS = CUBICS | QUINTICS | TWICE


def path_along(case, sign):
    """The drift of a case, the times where it turns, and the path that is found."""
    drift = sign * TURNS[case].drift
    motion = sampled(drift, [0.0, STEP], with_a=case not in CUBICS)
    return drift, TURNS[case].edges, path_of(motion)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("case", TURNS)
def test_the_path_is_cut_where_the_motion_turns(case, sign):
    drift, edges, path = path_along(case, sign)
    assert len(path.dt) == len(edges) - 1
    np.testing.assert_allclose(path.dt, np.diff(edges), atol=1e-9 * STEP)
    rates = drift.deriv()(edges)
    tolerance = 1e-12 * SIZE / STEP
    np.testing.assert_allclose(path.v0, rates[:-1], atol=tolerance)
    np.testing.assert_allclose(path.v1, rates[1:], atol=tolerance)
    assert (path.level == 1.5).all()  # the mean of both samples


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("case", CUBICS | QUINTICS)
def test_the_path_passes_the_drift_where_the_motion_turns(case, sign):
    drift, edges, path = path_along(case, sign)
    np.testing.assert_allclose(path.drifts, drift(edges), atol=1e-12 * SIZE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_two_turns_in_a_step_are_not_seen_without_accelerations(sign):
    drift = sign * turns([0.2, 0.7]).drift
    path = path_of(sampled(drift, [0.0, STEP], with_a=False))
    assert path.dt == pytest.approx([STEP])
    assert path.v0 == pytest.approx([drift.deriv()(0.0)])
    assert path.v1 == pytest.approx([drift.deriv()(STEP)])


@pytest.mark.parametrize("with_a", [True, False])
def test_without_time_every_path_is_straight(with_a):
    drift = TURNS["parabola"].drift
    motion = sampled(drift, [0.0, STEP], with_a, with_t=False)
    columns = laws.Jenkins(uy=10.0 * SIZE).features(motion)
    straight = (drift(STEP) - drift(0.0)) / (10.0 * SIZE)
    assert columns[1, 0] == pytest.approx(straight, rel=1e-12)


@pytest.mark.parametrize(
    ("s", "v", "a", "drifts"),
    [
        # the accelerations contradict the rates: the quintic turns on the wrong side,
        # the cubic is taken
        ([0.0, 0.0], [1.0, -1.0], [-900.0, -900.0], [0.0, 0.25, 0.0]),
        ([0.0, 0.0], [-1.0, 1.0], [900.0, 900.0], [0.0, -0.25, 0.0]),
        ([0.0, 0.0], [1.0, -1.0], [-2.0, -2.0], [0.0, 0.25, 0.0]),  # a true parabola
        # the rates contradict the drift: the straight path
        ([0.0, 3.0], [1.0, -1.0], [0.0, 0.0], [0.0, 3.0]),
        ([0.0, -3.0], [1.0, -1.0], None, [0.0, -3.0]),
        ([0.0, 3.0], [-1.0, 1.0], None, [0.0, 3.0]),
        ([0.0, -3.0], [-1.0, 1.0], None, [0.0, -3.0]),
        # a rate of zero does not turn
        ([0.0, 0.4], [1.0, 0.0], [0.0, 0.0], [0.0, 0.4]),
        ([0.0, 0.4], [0.0, 1.0], None, [0.0, 0.4]),
    ],
)
def test_noise_does_not_bend_the_path(s, v, a, drifts):
    motion = Motion(
        np.array(s),
        np.array(v),
        None if a is None else np.array(a),
        t=np.array([0.0, 1.0]),
        covariates={"level": np.ones(2)},
    )
    assert path_of(motion).drifts == pytest.approx(drifts, abs=1e-9)


# -- short records and errors --------------------------------------------------


def test_a_record_of_one_sample_keeps_its_state():
    sample = Motion(s=np.ones(1), v=np.zeros(1), a=np.zeros(1), t=np.zeros(1))
    law = laws.Dahl(sigma=1e3)
    state = np.array([0.4])
    assert law.features(sample).tolist() == [[0.0]]
    assert law.features(sample, state).tolist() == [[0.4]]
    assert state.tolist() == [0.4]


def test_a_record_without_samples_has_no_features():
    nothing = Motion(np.empty(0), np.empty(0))
    assert laws.Dahl(sigma=1e3).features(nothing).shape == (0, 1)


def test_a_state_that_cannot_be_moved_is_named():
    s = np.array([0.0, 1.0])
    level = {"level": np.ones(2)}
    with pytest.raises(LawError, match="needs the time"):
        DIARY.features(Motion(s, s, covariates=level))
    with pytest.raises(LawError, match=r"diverges .*\(pace = 1.5\)"):
        DIARY.features(Motion(s, s, t=np.array([0.0, np.nan]), covariates=level))


@pytest.mark.parametrize(
    ("s", "v"), [([0.0, np.nan], [0.0, 1.0]), ([0.0, 1.0], [np.inf, 0.0])]
)
def test_a_motion_that_is_not_finite_is_refused(s, v):
    with pytest.raises(ChannelError, match="motion .* is not finite"):
        laws.Dahl(sigma=1.0).features(Motion(np.array(s), np.array(v)))
