"""The jackknife against textbooks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pysindy_nrf.equations import leave_one_out, share_of, variance

SHAPES = arrays.array_shapes(min_dims=1, max_dims=2, min_side=2, max_side=12)
DATA = arrays.arrays(float, SHAPES, elements=st.floats(-1e3, 1e3))


@given(DATA)
def test_of_a_mean_it_is_the_textbook_variance_of_the_mean(x):
    n = len(x)
    without = (x.sum(axis=0) - x) / (n - 1)
    expected = x.var(axis=0, ddof=1) / n
    assert variance(without) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_what_one_part_does_not_determine_has_no_variance():
    values = [[1.0, np.nan], [2.0, 1.0], [4.0, 1.0]]
    assert np.isnan(variance(values)).tolist() == [False, True]


@given(DATA)
def test_sums_without_each_entry(x):
    expected = x.sum(axis=0) - x
    assert leave_one_out(x) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_the_share_that_is_left_and_its_error():
    """Half is left everywhere: no scatter; of nothing, nothing."""
    before = np.array([4.0, 2.0, 6.0, 1.0])
    assert share_of(before, 0.5 * before) == (0.5, 0.0)
    assert share_of(0 * before, 0 * before) == (0.0, 0.0)


def test_the_error_of_a_share_is_that_of_a_mean():
    after = np.array([0.3, 0.9, 0.4, 0.1, 0.7])
    share, error = share_of(np.ones(5), after)
    assert share == pytest.approx(1 - after.mean())
    assert error == pytest.approx(after.std(ddof=1) / np.sqrt(5))


def test_two_blocks_give_no_error_of_a_share():
    assert np.isnan(share_of(np.ones(2), np.array([0.3, 0.9]))[1])


def test_blocks_of_zeros_leave_the_share_to_the_others():
    share = share_of(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    assert share[1] == pytest.approx(np.sqrt(2 * np.var([1.0, 0.5, 0.5])))
