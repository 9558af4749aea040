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
    whole = law.features(two_tones(t))
    state = np.zeros(1)
    for start in range(0, 2000, 250):
        rows = slice(start, start + 251)
        block = law.features(two_tones(t[rows]), state)
        assert state[0] == block[-1, 0]
        np.testing.assert_array_equal(block[1:], whole[rows][1:])


# -- the path between two samples ----------------------------------------------


class Part(NamedTuple):
    """What a law reads of one part of the path."""

    s0: float
    v0: float
    s1: float
    v1: float
    dt: float
    level: float


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


def parts_of(motion):
    """The parts of the path that a law is moved along."""
    state = np.zeros(Diary.n_states)
    columns = DIARY.features(motion, state)
    count = int(state[0])
    assert columns[-1, 0] == count
    return [Part(*row) for row in state[1:].reshape(N_PARTS, 6)[:count]]


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
    """A drift by time within a step, and where it turns, in shares of the step."""

    drift: Polynomial
    shares: list[float]
    with_a: bool


def drift_that_turns(*shares, factor=(1.0,)):
    """Drift whose rate is zero at shares of the step, times a polynomial of the share."""
    rate = Polynomial(factor)
    for share in shares:
        rate = rate * Polynomial([-share, 1.0])
    by_share = rate.integ()
    powers = STEP ** np.arange(len(by_share.coef))
    return Polynomial(SIZE * by_share.coef / powers)


TURNS = {
    "none": Turns(drift_that_turns(factor=(1.0, 0.5)), [], True),
    "parabola": Turns(drift_that_turns(0.3), [0.3], False),
    "parabola, late": Turns(drift_that_turns(0.9), [0.9], True),
    "cubic": Turns(drift_that_turns(0.3, -1.0), [0.3], False),
    "cubic, late": Turns(drift_that_turns(0.8, factor=(-1.0, 0.2)), [0.8], False),
    "quintic": Turns(drift_that_turns(0.4, factor=(1.0, 0.3, -0.2, 0.8)), [0.4], True),
    "quintic, early": Turns(
        drift_that_turns(0.15, factor=(-1.0, 0.5, 0.3, -0.4)), [0.15], True
    ),
    "twice": Turns(
        drift_that_turns(0.2, 0.7, factor=(1.0, 0.0, 1.0)), [0.2, 0.7], True
    ),
    "twice, late": Turns(
        drift_that_turns(0.45, 0.85, factor=(-1.0, 0.1, -0.3)), [0.45, 0.85], True
    ),
    "twice, and once later": Turns(
        drift_that_turns(0.2, 0.7, factor=(1.6, -1.0)), [0.2, 0.7], True
    ),
    "dips only": Turns(drift_that_turns(factor=(0.35, -1.0, 1.0)), [], True),
    "twice, not seen": Turns(drift_that_turns(0.2, 0.7), [], False),
}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("case", TURNS)
def test_the_path_is_cut_where_the_motion_turns(case, sign):
    drift = sign * TURNS[case].drift
    turns = [STEP * share for share in TURNS[case].shares]
    edges = np.array([0.0, *turns, STEP])
    parts = parts_of(sampled(drift, [0.0, STEP], TURNS[case].with_a))

    assert len(parts) == len(turns) + 1
    rates = [0.0] * len(turns)
    expected_rates = np.array([drift.deriv()(0.0), *rates, drift.deriv()(STEP)])
    tolerance = 1e-12 * SIZE / STEP
    rates0 = [part.v0 for part in parts]
    rates1 = [part.v1 for part in parts]
    np.testing.assert_allclose(rates0, expected_rates[:-1], atol=tolerance)
    np.testing.assert_allclose(rates1, expected_rates[1:], atol=tolerance)
    durations = [part.dt for part in parts]
    np.testing.assert_allclose(durations, np.diff(edges), atol=1e-9 * STEP)
    assert {part.level for part in parts} == {1.5}  # the mean of both samples


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("case", [name for name in TURNS if "twice" not in name])
def test_the_path_passes_the_drift_where_the_motion_turns(case, sign):
    drift = sign * TURNS[case].drift
    edges = [0.0, *(STEP * share for share in TURNS[case].shares), STEP]
    parts = parts_of(sampled(drift, [0.0, STEP], TURNS[case].with_a))
    drifts = [parts[0].s0, *(part.s1 for part in parts)]
    np.testing.assert_allclose(drifts, drift(np.array(edges)), atol=1e-12 * SIZE)
    assert [part.s0 for part in parts[1:]] == [part.s1 for part in parts[:-1]]


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
    parts = parts_of(motion)
    found = [parts[0].s0, *(part.s1 for part in parts)]
    assert found == pytest.approx(drifts, abs=1e-9)


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
