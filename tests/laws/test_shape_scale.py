"""Shape parameters are searched in the same coordinates everywhere: bounds that go with the motion, logarithms where
a parameter is a scale, frequencies up to half the sampling rate."""


import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import laws
from pysindy_nrf.laws.shape import ShapeScale

SHAPES = [p for law in laws.registry().values() for p in law.shapes]
SIZES = st.tuples(st.floats(1e-6, 1.0), st.floats(1e-5, 10.0), st.floats(0.5, 1e5))  # m, m/s, s


@given(SIZES, st.integers(0, 2**32 - 1))
def test_there_and_back_within_the_bounds_of_every_law(sizes, seed):
    scale = ShapeScale(SHAPES, [sizes] * len(SHAPES))
    u = scale.low + np.random.default_rng(seed).random((3, len(SHAPES))) * (scale.high - scale.low)
    assert scale.point(scale.values(u)) == pytest.approx(u, rel=1e-9, abs=1e-9)
    ends = np.array([p.bounds(*sizes) for p in SHAPES]).T
    assert (scale.values(u) >= ends[0] - 1e-9 * abs(ends[0])).all() and (
        scale.values(u) <= ends[1] + 1e-9 * abs(ends[1])
    ).all()
    for k in range(len(SHAPES)):  # many values of one parameter
        assert scale.values(u[:, k], k) == pytest.approx(scale.values(u)[:, k], rel=1e-12)
        assert scale.point(scale.values(u[:, k], k), k) == pytest.approx(u[:, k], rel=1e-9, abs=1e-9)


@given(SIZES, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
def test_bounds_go_with_the_motion_and_the_record(sizes, larger, longer):
    drift, rate, duration = sizes
    first = ShapeScale(SHAPES, [sizes] * len(SHAPES))
    # a structure that moves so much further and as much slower than before
    other = ShapeScale(SHAPES, [(larger * drift, larger / longer * rate, longer * duration)] * len(SHAPES))
    power = {"s": larger, "v": larger / longer, "t": longer, "p": larger, "1": 1.0}
    for k, p in enumerate(SHAPES):
        above, _, below = p.scale.partition("/")
        factor = power[above] / power[below or "1"]
        assert other.values(other.high)[k] == pytest.approx(factor * first.values(first.high)[k], rel=1e-9)
        assert other.values(other.low)[k] == pytest.approx(factor * first.values(first.low)[k], rel=1e-9, abs=1e-300)


def test_half_way_between_a_tenth_and_ten_times_is_once_where_the_scale_is_one():
    scale = ShapeScale([laws.Shape("a", "m", 0.1, 10.0), laws.Shape("b", "m", -1.0, 3.0, log=False)], [(1, 1, 1)] * 2)
    assert scale.values((scale.low + scale.high) / 2) == pytest.approx([1.0, 1.0]) and scale.log.tolist() == [
        True,
        False,
    ]


@given(st.floats(1.0, 1e4), SIZES)
def test_a_frequency_alone_goes_up_to_half_the_sampling_rate(fastest, sizes):
    shapes = [*laws.HarmonicForce.shapes, *laws.Dahl.shapes]
    free, capped = (ShapeScale(shapes, [sizes] * 2, f) for f in (np.inf, fastest))
    assert capped.values(capped.high) == pytest.approx([fastest, shapes[1].bounds(*sizes)[1]])
    assert free.values(free.high) == pytest.approx([p.bounds(*sizes)[1] for p in shapes])
    assert capped.low == pytest.approx(free.low)


