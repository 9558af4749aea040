"""The jackknife's variance against what textbooks say of estimates whose variance is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pysindy_nrf.common.jackknife import variance

COLUMNS = arrays.array_shapes(min_dims=1, max_dims=2, min_side=2, max_side=12)
DATA = arrays.arrays(float, COLUMNS, elements=st.floats(-1e3, 1e3))


@given(DATA)
def test_of_a_mean_it_is_the_textbook_variance_of_the_mean(x):
    n = len(x)
    without = (x.sum(axis=0) - x) / (n - 1)
    assert variance(without) == pytest.approx(x.var(axis=0, ddof=1) / n, rel=1e-9, abs=1e-9)


@given(DATA, st.floats(-5, 5), st.floats(-1e3, 1e3))
def test_it_goes_with_the_square_of_the_unit_and_not_with_the_origin(values, factor, origin):
    assert variance(factor * values + origin) == pytest.approx(factor**2 * variance(values), rel=1e-6, abs=1e-6)


def test_a_slope_is_told_as_well_as_its_scatter_over_many_records_says():
    rng = np.random.default_rng(3)
    t = np.linspace(-1.0, 1.0, 40)
    found, told = [], []
    for _ in range(2000):
        y = 3.0 * t + 0.2 * rng.standard_normal(len(t))
        found.append(t @ y / (t @ t))
        told.append(variance((t @ y - t * y) / (t @ t - t * t)))
    assert np.mean(told) == pytest.approx(0.2**2 / (t @ t), rel=0.05) and np.var(found) == pytest.approx(
        np.mean(told), rel=0.1
    )


def test_what_one_part_cannot_tell_is_not_told():
    assert np.isnan(variance([[1.0, np.nan], [2.0, 1.0], [4.0, 1.0]])).tolist() == [False, True]
