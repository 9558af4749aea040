"""scikit-learn's own checks on every public estimator; copies, names, tables and
pickles.
"""

import chains
import numpy as np
import padded
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.base import clone
from sklearn.utils.estimator_checks import check_estimator, parametrize_with_checks

import pysindy_nrf
from pysindy_nrf import InterstoryPolynomialLibrary, KinematicSmoother, NRFRegressor
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import fusion as signals

pytestmark = pytest.mark.filterwarnings("ignore")
CASES = padded.cases()
REASONS = {type(estimator).__name__: failures for estimator, failures in CASES}


@parametrize_with_checks(
    [e for e, _ in CASES], expected_failed_checks=lambda e: REASONS[type(e).__name__]
)
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.mark.parametrize("estimator", padded.direct(), ids=str)
def test_without_padding_only_the_number_of_columns_is_refused(estimator):
    results = check_estimator(estimator, on_fail=None, on_skip=None)
    other = {
        r["check_name"]
        for r in results
        if r["status"] == "failed" and not padded.own_column_error(r)
    }
    # three columns are one DOF where no chain is given: ten rows with NaN in the first
    # are a masked edge, as in EDGES
    one_dof = isinstance(estimator, NRFRegressor) and estimator.chain is None
    assert other <= ({"check_estimators_nan_inf"} if one_dof else set()).union(
        padded.SPARSE
    )
    assert sum(r["status"] == "passed" for r in results) >= 20


def test_every_public_estimator_is_among_the_checked():
    from sklearn.base import BaseEstimator

    everything = {n: getattr(pysindy_nrf, n, None) for n in dir(pysindy_nrf)} | {
        n: getattr(signals, n) for n in signals.__all__
    }
    public = {
        n
        for n, c in everything.items()
        if isinstance(c, type) and issubclass(c, BaseEstimator)
    }
    checked = {type(e).__name__ for e, _ in CASES} | {
        c.__name__ for e, _ in CASES for c in type(e).__mro__
    }
    assert public <= checked


def test_tables_keep_their_names():
    case = chains.duffing(2, [1, 2], seed=3, n_samples=600)
    t = pd.Index(np.arange(600) * case.dt, name="t")
    table = pd.DataFrame(case.X, columns=["a1", "a2", "v1", "v2", "s1", "s2"], index=t)
    library = InterstoryPolynomialLibrary(2)
    with config_context(transform_output="pandas"):
        out = library.fit(table).transform(table)
    assert (
        list(out.columns)
        == library.get_feature_names()
        == list(library.get_feature_names_out())
    )
    assert np.allclose(out["v2 s2"], table["v2"] * table["s2"]) and out.index.equals(t)
    as_table = (
        clone(library).set_output(transform="pandas").fit(case.X).transform(case.X)
    )
    assert np.array_equal(as_table.to_numpy(), out.to_numpy())


def test_an_array_of_named_channels_is_fused_like_the_table():
    case = chains.duffing(2, [1, 2], seed=3, n_samples=600, substeps=4)
    rng = np.random.default_rng(0)
    x = case.s.cumsum(axis=1) * (1 + 0.0) + 1e-5 * rng.standard_normal((600, 2))
    channels = np.hstack([case.a, x])
    names = ["a1", "a2", "x1", "x2"]
    smoother = KinematicSmoother(fs=1000.0, channels=names)
    out = smoother.fit_transform(channels)
    table = KinematicSmoother(fs=1000.0).fit_transform(
        pd.DataFrame(channels, columns=names)
    )
    assert np.array_equal(out, table.to_numpy()) and list(
        smoother.get_feature_names_out()
    ) == list(table.columns)
    assert np.allclose(
        clone(smoother).fit(channels).transform(channels), out, rtol=1e-6, atol=1e-9
    )
    with pytest.raises(ChannelError, match="3 channels are named, X has 4"):
        KinematicSmoother(fs=1000.0, channels=names[:3]).fit(channels)


def test_records_are_smoothed_each_by_itself():
    """The end of one record must not bend the start of the next, nor a gap of the clock
    be smoothed over.
    """
    t = np.arange(1500) / 500
    one, two = np.sin(30 * t), 2 + np.cos(17 * t)
    ids = np.repeat(["one", "two"], 1500)
    both = pd.DataFrame({"x1": np.concatenate([one, two])})
    velocity = np.concatenate([30 * np.cos(30 * t), -17 * np.sin(17 * t)])
    fused = KinematicSmoother(fs=500.0).fit_transform(both, record=ids)
    assert np.abs(fused["v1"].to_numpy() - velocity).max() < 0.3
