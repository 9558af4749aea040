"""The state of a law with memory along a sampled motion."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from pysindy_nrf import laws
from pysindy_nrf.exceptions import ChannelError, LawError
from pysindy_nrf.laws import ForceLaw, Motion, Shape, Term
from pysindy_nrf.laws.memory import state_path

SIGMA = 5e3


ONE_SAMPLE = Motion(*np.array([[1.0], [0.0], [0.0], [0.0]]))


def two_tones(t):
    s = 1e-3 * np.sin(60 * t) + 4e-4 * np.sin(171 * t + 1)
    v = 0.06 * np.cos(60 * t) + 0.0684 * np.cos(171 * t + 1)
    a = -3.6 * np.sin(60 * t) - 11.6964 * np.sin(171 * t + 1)
    return s, v, a


def test_path_in_blocks_that_share_a_sample_is_the_same_to_the_last_bit():
    t = np.arange(2001) / 1000
    s, v, a = two_tones(t)
    law = laws.Dahl(sigma=SIGMA)
    none = np.empty((0, len(t)))
    whole = state_path(law, Motion(s, v, a, t), none, law.theta)
    state, pieces = np.zeros(1), []
    for start in range(0, 2000, 250):
        rows = slice(start, start + 251)
        piece = state_path(
            law,
            Motion(s[rows], v[rows], a[rows], t[rows]),
            none[:, rows],
            law.theta,
            state,
        )
        assert state[0] == piece[0, -1]
        pieces.append(piece[:, 1:])
    assert np.array_equal(np.hstack([whole[:, :1], *pieces]), whole)


# -- the way between two samples -----------------------------------------------


class Diary(ForceLaw):
    """Notes every stretch of the way that its state is moved along, the last eight of
    them word by word.
    """

    shapes = (Shape("pace", "1", 1.0, 2.0),)  # not read
    n_states = 3 + 6 * 8
    covariates = ("level",)

    def terms(self):
        return (Term("c", "distance", "N/m"), Term("d", "count", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[1]
        out[1] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        row = 3 + 6 * (int(z[0]) % 8)
        z[row] = s0
        z[row + 1] = v0
        z[row + 2] = s1
        z[row + 3] = v1
        z[row + 4] = dt
        z[row + 5] = u[0]
        z[0] += 1.0
        z[1] += abs(s1 - s0)
        z[2] += dt


DIARY = Diary({"pace": 1.5})


def read(motion, state=None):
    """What the diary says at the end: the stretches."""
    state = np.zeros(Diary.n_states) if state is None else state
    columns = DIARY.features(motion, state)
    return state[3:].reshape(8, 6)[: int(state[0])], columns


def moving_by(p, edges, with_a=True, with_t=True):
    """A motion that is a polynomial of the time, known at a few times."""
    t = np.asarray(edges, dtype=float)
    v, a = p.deriv(), p.deriv(2)
    return Motion(
        p(t),
        v(t),
        a(t) if with_a else None,
        t if with_t else None,
        {"level": np.arange(1.0, len(t) + 1.0)},
    )


def stretches(p, way, levels):
    v = p.deriv()
    return [
        (p(b), v(b), p(e), v(e), e - b, x)
        for b, e, x in zip(way[:-1], way[1:], levels, strict=True)
    ]


H, SIZE = 0.02, 1e-3


def _in_time(roots, factor=(1.0,)):
    """Drift of SIZE (m) on a time of H (s) whose rate has these zeros, in shares of
    H.
    """
    rate = Polynomial(factor)
    for root in roots:
        rate = rate * Polynomial([-root, 1.0])
    share = rate.integ()
    return Polynomial([SIZE * c / H**k for k, c in enumerate(share.coef)])


# rate as a polynomial, where it turns inside the step, whether the acceleration is
# given
TURNS = {
    "straight": (_in_time([], (1.0, 0.5)), [], True),
    "parabola": (_in_time([0.3]), [0.3], False),
    "parabola late": (_in_time([0.9]), [0.9], True),
    "cubic": (_in_time([0.3, -1.0]), [0.3], False),
    "cubic late": (_in_time([0.8], (-1.0, 0.2)), [0.8], False),
    "quintic": (_in_time([0.4], (1.0, 0.3, -0.2, 0.8)), [0.4], True),
    "quintic early": (_in_time([0.15], (-1.0, 0.5, 0.3, -0.4)), [0.15], True),
    "twice": (_in_time([0.2, 0.7], (1.0, 0.0, 1.0)), [0.2, 0.7], True),
    "twice, late": (_in_time([0.45, 0.85], (-1.0, 0.1, -0.3)), [0.45, 0.85], True),
    "twice, and once later": (_in_time([0.2, 0.7], (1.6, -1.0)), [0.2, 0.7], True),
    "dips only": (_in_time([], (0.35, -1.0, 1.0)), [], True),
    "twice, not seen": (_in_time([0.2, 0.7]), [], False),
}


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("case", TURNS)
def test_the_way_is_cut_where_the_motion_turns(case, mirror):
    p, turns, with_a = TURNS[case]
    p = p * mirror
    edges = [0.0, H]
    expected = stretches(p, [0.0, *(H * x for x in turns), H], [1.5] * (1 + len(turns)))
    found, columns = read(moving_by(p, edges, with_a))
    assert columns[1, 1] == 1 + len(turns)
    ends = np.array([(e[0], e[2]) for e in expected])
    seen = (
        np.array([[True, True], [True, False], [False, True]])
        if len(turns) == 2
        else np.full(ends.shape, True)
    )
    np.testing.assert_allclose(found[:, [0, 2]][seen], ends[seen], atol=1e-12 * SIZE)
    np.testing.assert_allclose(
        found[:, [1, 3]], [[e[1], e[3]] for e in expected], atol=1e-12 * SIZE / H
    )
    np.testing.assert_allclose(found[:, 4], [e[4] for e in expected], atol=1e-9 * H)
    assert found[:, 5].tolist() == [1.5] * len(expected)  # the mean of both samples
    for k in range(len(turns)):
        assert found[k, 3] == 0.0 == found[k + 1, 1]  # at rest where it turns


def test_without_time_every_way_is_straight():
    p, _, _ = TURNS["parabola"]
    law = laws.Jenkins(uy=10.0 * SIZE)
    direct = (p(H) - p(0.0)) / (10.0 * SIZE)
    for with_a in (True, False):
        assert law.features(moving_by(p, [0.0, H], with_a, with_t=False))[
            1, 0
        ] == pytest.approx(direct, rel=1e-12)


def _two_samples(s, v, a=None, h=1.0):
    return Motion(
        np.array(s),
        np.array(v),
        None if a is None else np.array(a),
        np.array([0.0, h]),
        {"level": np.ones(2)},
    )


@pytest.mark.parametrize(
    ("s", "v", "a", "drifts"),
    [
        # the accelerations contradict the rates: the quintic turns on the wrong side,
        # the cubic is taken
        ([0.0, 0.0], [1.0, -1.0], [-900.0, -900.0], [0.0, 0.25, 0.0]),
        ([0.0, 0.0], [-1.0, 1.0], [900.0, 900.0], [0.0, -0.25, 0.0]),
        ([0.0, 0.0], [1.0, -1.0], [-2.0, -2.0], [0.0, 0.25, 0.0]),  # a true parabola
        # the rates contradict the drift: the straight way
        ([0.0, 3.0], [1.0, -1.0], [0.0, 0.0], [0.0, 3.0]),
        ([0.0, -3.0], [1.0, -1.0], None, [0.0, -3.0]),
        ([0.0, 3.0], [-1.0, 1.0], None, [0.0, 3.0]),
        ([0.0, -3.0], [-1.0, 1.0], None, [0.0, -3.0]),
        # a rate of zero does not turn
        ([0.0, 0.4], [1.0, 0.0], [0.0, 0.0], [0.0, 0.4]),
        ([0.0, 0.4], [0.0, 1.0], None, [0.0, 0.4]),
    ],
)
def test_noise_does_not_bend_the_way(s, v, a, drifts):
    found, _ = read(_two_samples(s, v, a))
    assert [*found[:, 0], found[-1, 2]] == pytest.approx(drifts, abs=1e-9)


def test_records_of_one_sample_and_of_none():
    law = laws.Dahl(sigma=1e3)
    assert law.features(ONE_SAMPLE).tolist() == [[0.0]]
    state = np.array([0.4])
    assert law.features(ONE_SAMPLE, state).tolist() == [[0.4]] and state.tolist() == [
        0.4
    ]
    assert law.features(Motion(np.empty(0), np.empty(0))).shape == (0, 1)


def test_states_that_cannot_be_moved_are_named():
    s, level = np.array([0.0, 1.0]), {"level": np.ones(2)}
    with pytest.raises(LawError, match="Diary needs the time of the samples"):
        DIARY.features(Motion(s, s, covariates=level))
    with pytest.raises(LawError, match=r"The state of Diary diverges .*\(pace = 1.5\)"):
        DIARY.features(Motion(s, s, t=np.array([0.0, np.nan]), covariates=level))
    for bad in (Motion(np.array([0.0, np.nan]), s), Motion(s, np.array([np.inf, 0.0]))):
        with pytest.raises(
            ChannelError, match="The motion of a law with memory is not finite"
        ):
            laws.Dahl(sigma=1.0).features(bad)
