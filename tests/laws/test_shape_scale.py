"""Shape parameters are searched in the same coordinates everywhere: bounds that go with
the motion, logarithms where a parameter is a scale, frequencies up to half the sampling
rate.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import laws
from pysindy_nrf.laws.shape import ShapeScale

SHAPES = [p for law in laws.registry().values() for p in law.shapes]
SIZES = st.tuples(
    st.floats(1e-6, 1.0), st.floats(1e-5, 10.0), st.floats(0.5, 1e5)
)  # m, m/s, s


@given(SIZES, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
def test_bounds_go_with_the_motion_and_the_record(sizes, larger, longer):
    drift, rate, duration = sizes
    first = ShapeScale(SHAPES, [sizes] * len(SHAPES))
    # a structure that moves so much further and as much slower than before
    other = ShapeScale(
        SHAPES,
        [(larger * drift, larger / longer * rate, longer * duration)] * len(SHAPES),
    )
    power = {"s": larger, "v": larger / longer, "t": longer, "p": larger, "1": 1.0}
    for k, p in enumerate(SHAPES):
        above, _, below = p.scale.partition("/")
        factor = power[above] / power[below or "1"]
        assert other.values(other.high)[k] == pytest.approx(
            factor * first.values(first.high)[k], rel=1e-9
        )
        assert other.values(other.low)[k] == pytest.approx(
            factor * first.values(first.low)[k], rel=1e-9, abs=1e-300
        )


@given(st.floats(1.0, 1e4), SIZES)
def test_a_frequency_alone_goes_up_to_half_the_sampling_rate(fastest, sizes):
    shapes = [*laws.HarmonicForce.shapes, *laws.Dahl.shapes]
    free, capped = (ShapeScale(shapes, [sizes] * 2, f) for f in (np.inf, fastest))
    assert capped.values(capped.high) == pytest.approx(
        [fastest, shapes[1].bounds(*sizes)[1]]
    )
    assert free.values(free.high) == pytest.approx(
        [p.bounds(*sizes)[1] for p in shapes]
    )
    assert capped.low == pytest.approx(free.low)
