"""Shape parameters are searched in the same coordinates everywhere.

Bounds go with the motion, a parameter that is a scale goes by its logarithm, and a
frequency reaches half the sampling rate.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import laws

SHAPES = [shape for law in laws.registry().values() for shape in law.shapes]
DRIFTS = st.floats(1e-6, 1.0)  # m
RATES = st.floats(1e-5, 10.0)  # m/s
DURATIONS = st.floats(0.5, 1e5)  # s
FACTORS = st.floats(0.01, 100.0)


def bounds_of(shapes, drift, rate, duration, fastest=np.inf):
    """Lower and upper bounds in SI units, by way of the coordinates of a search."""
    scale = laws.ShapeScale(shapes, [(drift, rate, duration)] * len(shapes), fastest)
    return scale.values(scale.low), scale.values(scale.high)


@given(DRIFTS, RATES, DURATIONS, FACTORS, FACTORS)
def test_bounds_go_with_the_motion_and_the_record(
    drift, rate, duration, larger, longer
):
    """A structure that moves so much further and as much slower than before."""
    faster = larger / longer
    low, high = bounds_of(SHAPES, drift, rate, duration)
    new_low, new_high = bounds_of(
        SHAPES, larger * drift, faster * rate, longer * duration
    )
    factors = {"1": 1.0, "s": larger, "v": faster, "t": longer, "p": larger}
    for k, shape in enumerate(SHAPES):
        numerator, _, denominator = shape.scale.partition("/")
        factor = factors[numerator] / factors[denominator or "1"]
        assert new_high[k] == pytest.approx(factor * high[k], rel=1e-9)
        assert new_low[k] == pytest.approx(factor * low[k], rel=1e-9, abs=1e-300)


@given(st.floats(1.0, 1e4), DRIFTS, RATES, DURATIONS)
def test_a_frequency_alone_goes_up_to_half_the_sampling_rate(
    fastest, drift, rate, duration
):
    (frequency,), (sigma,) = laws.HarmonicForce.shapes, laws.Dahl.shapes
    shapes = [frequency, sigma]
    free_low, free_high = bounds_of(shapes, drift, rate, duration)
    low, high = bounds_of(shapes, drift, rate, duration, fastest)
    sigma_high = sigma.bounds(drift, rate, duration)[1]
    frequency_high = frequency.bounds(drift, rate, duration)[1]
    assert free_high == pytest.approx([frequency_high, sigma_high])
    assert high == pytest.approx([fastest, sigma_high])
    assert low == pytest.approx(free_low)
