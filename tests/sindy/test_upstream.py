"""A quirk of PySINDy and scikit-learn that the package works round; if the test fails,
its work-round can go.
"""

import numpy as np
import pysindy as ps
import pytest
import sklearn

sklearn_version = tuple(int(part) for part in sklearn.__version__.split(".")[:2])


@pytest.mark.skipif(
    sklearn_version < (1, 7), reason="scikit-learn 1.7 brought the cut-off"
)
def test_unbiasing_on_raw_si_columns_loses_the_cubic():
    """The same through PySINDy: without unbiasing all four coefficients of a Duffing
    storey are exact, with it not.
    """
    rng = np.random.default_rng(0)
    a, v, s = rng.normal(size=(3, 2000, 1)) * np.array([10.0, 0.1, 1e-3])[:, None, None]
    columns, true = np.hstack([a, v, s, s**3]), [10.0, 30.0, 1e5, 1e9]
    exact, lost = (
        ps.STLSQ(threshold=0, alpha=0, unbias=on).fit(columns, columns @ true).coef_[0]
        for on in (False, True)
    )
    assert exact == pytest.approx(true, rel=1e-6) and abs(lost[3]) < 0.1 * true[3]
