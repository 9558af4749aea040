"""The jackknife's variance against what textbooks say of estimates whose variance is
known.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pysindy_nrf.equations.normal_equations import variance

COLUMNS = arrays.array_shapes(min_dims=1, max_dims=2, min_side=2, max_side=12)
DATA = arrays.arrays(float, COLUMNS, elements=st.floats(-1e3, 1e3))


@given(DATA)
def test_of_a_mean_it_is_the_textbook_variance_of_the_mean(x):
    n = len(x)
    without = (x.sum(axis=0) - x) / (n - 1)
    assert variance(without) == pytest.approx(
        x.var(axis=0, ddof=1) / n, rel=1e-9, abs=1e-9
    )


def test_what_one_part_cannot_tell_is_not_told():
    assert np.isnan(variance([[1.0, np.nan], [2.0, 1.0], [4.0, 1.0]])).tolist() == [
        False,
        True,
    ]
