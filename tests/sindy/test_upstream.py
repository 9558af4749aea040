"""A quirk of PySINDy and scikit-learn that the package works round.

If the test fails, its work-round can go.
"""

import numpy as np
import pysindy as ps
import pytest
import sklearn

VERSION = tuple(int(number) for number in sklearn.__version__.split(".")[:2])


@pytest.mark.skipif(VERSION < (1, 7), reason="scikit-learn 1.7 brought the cut-off")
def test_unbiasing_on_raw_si_columns_loses_the_cubic():
    """Without it all four coefficients of a Duffing storey are exact."""
    rng = np.random.default_rng(0)
    units = np.array([10.0, 0.1, 1e-3])[:, None, None]
    a, v, s = rng.normal(size=(3, 2000, 1)) * units
    columns, true = np.hstack([a, v, s, s**3]), [10.0, 30.0, 1e5, 1e9]
    target = columns @ true
    exact = ps.STLSQ(threshold=0, alpha=0, unbias=False).fit(columns, target)
    unbiased = ps.STLSQ(threshold=0, alpha=0, unbias=True).fit(columns, target)
    assert exact.coef_[0] == pytest.approx(true, rel=1e-6)
    assert abs(unbiased.coef_[0, 3]) < 0.1 * true[3]
