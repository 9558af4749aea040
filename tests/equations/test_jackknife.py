"""The jackknife and cross-validated ridge regression against textbooks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pysindy_nrf.equations.jackknife import leave_one_out, share_of, variance
from pysindy_nrf.equations.ridge_regression import Regression, in_blocks

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


@pytest.fixture(scope="module")
def regression():
    """y = 2 x + noise of a tenth, beside a column z that has no part in it."""
    rng = np.random.default_rng(0)
    x, z, e = rng.normal(size=(3, 5000))
    y = 2.0 * x + 0.2 * e
    columns = {"x": x, "z": z, "y": y}
    return Regression.of({name: [c[:2000], c[2000:]] for name, c in columns.items()})


def test_a_regression_finds_the_share_that_a_column_explains(regression):
    share, error = regression.share("y", ["x"])
    assert share == pytest.approx(4.0 / 4.04, abs=0.01)
    assert 0.0 < error < 0.01


def test_a_column_that_has_no_part_explains_nothing_of_held_out_blocks(regression):
    share, error = regression.share("y", ["z"], beside=["x"])
    assert abs(share) < 3 * error + 1e-3
    assert regression.coefficients("y", ["x", "z"])["x"] == pytest.approx(
        [2.0], abs=0.01
    )


def test_blocks_are_contiguous_and_about_equal():
    records = [np.arange(100), np.arange(100, 160)]
    blocks = in_blocks(records, 8)
    assert np.concatenate(blocks).tolist() == list(range(160))
    assert {len(block) for block in blocks} == {20}
