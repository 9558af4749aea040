"""scikit-learn's own checks on every public estimator; copies, names, tables and
pickles.
"""

import chains
import numpy as np
import padded
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.base import BaseEstimator, clone
from sklearn.utils.estimator_checks import check_estimator, parametrize_with_checks

import pysindy_nrf
from pysindy_nrf import InterstoryPolynomialLibrary, KinematicSmoother, NRFRegressor
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import feature_names, fusion

pytestmark = pytest.mark.filterwarnings("ignore")
CASES = padded.cases()
REASONS = {type(estimator).__name__: failures for estimator, failures in CASES}
ESTIMATORS = [estimator for estimator, _ in CASES]


def expected_failures(estimator):
    """Checks that cannot pass, with the reason of each."""
    return REASONS[type(estimator).__name__]


@parametrize_with_checks(ESTIMATORS, expected_failed_checks=expected_failures)
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.mark.parametrize("estimator", padded.direct(), ids=str)
def test_without_padding_only_the_number_of_columns_is_refused(estimator):
    failed = set()
    n_passed = 0
    for result in check_estimator(estimator, on_fail=None, on_skip=None):
        n_passed += result["status"] == "passed"
        if result["status"] == "failed" and not padded.own_column_error(result):
            failed.add(result["check_name"])

    allowed = set(padded.SPARSE)
    if isinstance(estimator, NRFRegressor) and estimator.chain is None:
        # three columns are one DOF, and ten rows with NaN in the first a masked edge
        allowed.add("check_estimators_nan_inf")
    assert failed <= allowed
    assert n_passed >= 20


def test_every_public_estimator_is_among_the_checked():
    checked = set()
    for estimator, _ in CASES:
        checked.update(base.__name__ for base in type(estimator).__mro__)
    named = {name: getattr(pysindy_nrf, name, None) for name in dir(pysindy_nrf)}
    named |= {name: getattr(fusion, name) for name in fusion.__all__}
    for name, candidate in named.items():
        if isinstance(candidate, type) and issubclass(candidate, BaseEstimator):
            assert name in checked


# -- tables --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table():
    case = chains.duffing(2, [1, 2], seed=3, n_samples=600)
    t = pd.Index(np.arange(600) * case.dt, name="t")
    return pd.DataFrame(case.X, columns=feature_names(2), index=t)


def test_tables_keep_their_names(table):
    library = InterstoryPolynomialLibrary(2)
    with config_context(transform_output="pandas"):
        out = library.fit(table).transform(table)
    assert list(out.columns) == library.get_feature_names()
    assert list(out.columns) == list(library.get_feature_names_out())
    assert np.allclose(out["v2 s2"], table["v2"] * table["s2"])
    assert out.index.equals(table.index)


def test_output_as_a_table_has_the_same_numbers(table):
    plain = InterstoryPolynomialLibrary(2).fit(table).transform(table)
    as_table = InterstoryPolynomialLibrary(2).set_output(transform="pandas")
    values = as_table.fit(table.to_numpy()).transform(table.to_numpy())
    assert np.array_equal(values.to_numpy(), np.asarray(plain))


# -- channels ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def channels():
    """Accelerations and displacements of two floors."""
    case = chains.duffing(2, [1, 2], seed=3, n_samples=600, substeps=4)
    noise = np.random.default_rng(0).standard_normal((600, 2))
    x = case.s.cumsum(axis=1) + 1e-5 * noise
    columns = np.hstack([case.a, x])
    return pd.DataFrame(columns, columns=["a1", "a2", "x1", "x2"])


def test_an_array_of_named_channels_is_fused_like_the_table(channels):
    smoother = KinematicSmoother(fs=1000.0, channels=list(channels))
    out = smoother.fit_transform(channels.to_numpy())
    of_table = KinematicSmoother(fs=1000.0).fit_transform(channels)
    assert np.array_equal(out, of_table.to_numpy())
    assert list(smoother.get_feature_names_out()) == list(of_table.columns)

    again = clone(smoother).fit(channels.to_numpy()).transform(channels.to_numpy())
    assert np.allclose(again, out, rtol=1e-6, atol=1e-9)


def test_every_channel_needs_a_name(channels):
    smoother = KinematicSmoother(fs=1000.0, channels=["a1", "a2", "x1"])
    with pytest.raises(ChannelError, match="3 channels are named, X has 4"):
        smoother.fit(channels.to_numpy())


def test_records_are_smoothed_each_by_itself():
    """The end of one record must not bend the start of the next, nor a gap of the clock
    be smoothed over.
    """
    t = np.arange(1500) / 500
    sine = np.sin(30 * t)
    two = 2 + np.cos(17 * t)
    ids = np.repeat(["one", "two"], 1500)
    both = pd.DataFrame({"x1": np.concatenate([sine, two])})
    velocity = np.concatenate([30 * np.cos(30 * t), -17 * np.sin(17 * t)])
    fused = KinematicSmoother(fs=500.0).fit_transform(both, record=ids)
    assert np.abs(fused["v1"].to_numpy() - velocity).max() < 0.3
