"""Quirks of PySINDy and scikit-learn that the package works round; if a test fails, its work-round can go."""

from __future__ import annotations

import warnings

import chains
import numpy as np
import pysindy as ps
import pytest
import sklearn
from sklearn.linear_model import LinearRegression

sklearn_version = tuple(int(part) for part in sklearn.__version__.split(".")[:2])


def test_set_params_of_pysindy_optimizers_returns_none():
    """Why ChainOptimizer does not inherit from pysindy.optimizers.BaseOptimizer (GridSearchCV needs self)."""
    assert ps.STLSQ().set_params(threshold=0.2) is None


@pytest.mark.skipif(sklearn_version < (1, 7), reason="scikit-learn 1.7 brought the cut-off")
def test_linear_regression_cuts_what_it_calls_rank():
    """Why columns are scaled before any PySINDy optimizer: its unbiasing step loses columns ten orders apart."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(1000, 2)) * [1.0, 1e-9]
    found = LinearRegression(fit_intercept=False).fit(A, A @ [1.0, 1e9]).coef_
    assert abs(found[1] / 1e9 - 1) > 0.5


@pytest.mark.skipif(sklearn_version < (1, 7), reason="scikit-learn 1.7 brought the cut-off")
def test_unbiasing_on_raw_si_columns_loses_the_cubic():
    """The same through PySINDy: without unbiasing all four coefficients of a Duffing storey are exact, with it not."""
    rng = np.random.default_rng(0)
    a, v, s = rng.normal(size=(3, 2000, 1)) * np.array([10.0, 0.1, 1e-3])[:, None, None]
    columns, true = np.hstack([a, v, s, s**3]), [10.0, 30.0, 1e5, 1e9]
    exact, lost = (ps.STLSQ(threshold=0, alpha=0, unbias=on).fit(columns, columns @ true).coef_[0] for on in (False, True))
    assert exact == pytest.approx(true, rel=1e-6)
    assert abs(lost[3]) < 0.1 * true[3]


def test_default_stlsq_deletes_the_force_from_a_model_in_si_units():
    """Why a threshold is a share of the force: 1/m = 0.05 is below the default 0.1."""
    case = chains.duffing(1, [1], n_samples=2000, given=(np.array([20.0]), np.array([40.0]), np.array([1e5]), np.zeros(1)))
    x, v = case.s, case.v
    model = ps.SINDy(feature_library=ps.PolynomialLibrary(1, include_bias=False))
    model.fit(np.hstack([x, v]), t=case.dt, x_dot=np.hstack([v, case.a]), u=case.F)
    row = dict(zip(model.get_feature_names(), model.coefficients()[1], strict=True))
    assert row["u0"] == 0.0 and row["x0"] != 0.0


def _problem():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(200, 5))
    return A, A @ [5.0, 4.0, 3.0, 2.0, 1.0] + 0.01 * rng.normal(size=200)


def test_ssr_never_returns_the_full_model():
    """A limit of SSR that ChainOptimizer's documentation names."""
    A, y = _problem()
    assert np.count_nonzero(ps.SSR(kappa=0.0).fit(A, y[:, None]).coef_) < 5


def test_frols_leaves_one_term_out():
    """A limit of FROLS that ChainOptimizer's documentation names."""
    A, y = _problem()
    assert np.count_nonzero(ps.FROLS(max_iter=10, alpha=1e-10).fit(A, y[:, None]).coef_) <= 4


def test_coef_list_of_ensembles_grows_with_each_fit():
    """Why the inner optimizer is cloned before every fit."""
    A, y = _problem()
    optimizer = ps.EnsembleOptimizer(ps.STLSQ(threshold=0.1), library_ensemble=True, n_models=3)
    optimizer.fit(A, y[:, None])
    optimizer.fit(A, y[:, None])
    assert len(optimizer.coef_list) == 6


def test_ensembles_draw_from_the_global_state_of_numpy():
    """Why block ensembles are drawn here (``BlockEnsemble``): randomness has to come through random_state."""
    A, y = _problem()
    y = y + np.random.default_rng(1).normal(size=y.shape)
    coefs = []
    for seed in (0, 0, 1):
        np.random.seed(seed)
        coefs.append(ps.EnsembleOptimizer(ps.STLSQ(threshold=0.1), bagging=True, n_models=3).fit(A, y[:, None]).coef_)
    assert np.array_equal(coefs[0], coefs[1]) and not np.array_equal(coefs[0], coefs[2])
    assert "random_state" not in ps.EnsembleOptimizer(ps.STLSQ(), bagging=True).get_params(deep=False)


def test_ensembles_read_two_attributes_that_the_contract_does_not_name():
    """Why the chain optimizers carry max_iter and copy_X, which say nothing there."""

    class Bare:
        pass

    with pytest.raises(AttributeError, match="max_iter"):
        ps.EnsembleOptimizer(Bare(), bagging=True)


def test_sindy_cannot_be_fitted_under_metadata_routing():
    """Why pipelines with routed records are built around NRFRegressor: a helper of SINDy.fit is half an estimator."""
    x = np.random.default_rng(0).normal(size=(50, 2))
    model = ps.SINDy(feature_library=ps.PolynomialLibrary(1))
    with sklearn.config_context(enable_metadata_routing=True):
        with pytest.raises(AttributeError, match="get_metadata_routing"):
            model.fit(x, t=0.1, x_dot=x)


def test_optimizers_drop_nan_rows_silently():
    """Why ChainOptimizer checks for NaN itself: an unknown force would empty the record without a word."""
    A, y = _problem()
    y = y.copy()
    y[::2] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coef = ps.STLSQ(threshold=0.1).fit(A, y[:, None]).coef_
    assert np.isfinite(coef).all()


def test_the_pinned_version():
    assert ps.__version__.startswith("2.1."), "the quirks above were read in PySINDy 2.1"
