"""Named scorers: what they mean, on estimators and pipelines."""

import chains
import numpy as np
import pytest
from sklearn import config_context
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from pysindy_nrf import NRFRegressor, scorers
from pysindy_nrf.exceptions import ChannelError, NRFError

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture(scope="module")
def case():
    return chains.duffing(2, [2], seed=6, n_samples=2000, substeps=4)


@pytest.fixture(scope="module")
def model(case):
    return NRFRegressor(degree=1, dt=case.dt).fit(case.X, case.F)


def mean_squares(signals):
    return np.mean(signals**2, axis=0)


def test_balance_is_the_pooled_error_by_hand(case, model):
    """Over F where forced, m a elsewhere, each over the storey force."""
    residual = model.predict(case.X) - case.F
    storey = mean_squares(model.restoring_force(case.X))
    inertia = model.masses_[0] * case.a[:, 0]
    reference = np.column_stack([inertia, case.F[:, 1]])
    missed = np.sum(mean_squares(residual) / storey)
    total = np.sum(mean_squares(reference) / storey)
    expected = -100 * np.sqrt(missed / total)
    score = scorers.balance(model, case.X, case.F)
    assert score == pytest.approx(expected, rel=1e-9)


def test_acceleration_is_the_estimators_own_score(case, model):
    score = scorers.acceleration(model, case.X, case.F)
    assert score == model.score(case.X, case.F)
    gap = (case.F - model.predict(case.X)) / model.masses_
    variation = np.sum((case.a - case.a.mean(axis=0)) ** 2)
    assert score == pytest.approx(1 - np.sum(gap**2) / variation, abs=1e-12)


def test_weights_take_samples_out_of_the_score(case, model):
    weights = 1.0 * (np.arange(2000) < 700)
    score = model.score(case.X, case.F, sample_weight=weights)
    expected = model.score(case.X[:700], case.F[:700])
    assert score == pytest.approx(expected, abs=1e-12)
    with pytest.raises(ChannelError, match="not valid weights"):
        model.score(case.X, case.F, sample_weight=-weights)


def test_the_free_run_is_the_simulation_from_the_first_state(case):
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    x, v = case.s.cumsum(axis=1), case.v.cumsum(axis=1)
    run = model.simulate(case.F, x0=x[0], v0=v[0])
    shares = mean_squares(run.displacement - x) / mean_squares(x)
    expected = -100 * np.sqrt(np.mean(shares))
    score = scorers.free_run(model, case.X, case.F)
    assert score == pytest.approx(expected, rel=1e-6)
    assert -1.0 < score < 0.0


def test_the_free_run_needs_a_clock(case):
    model = NRFRegressor(degree=3).fit(case.X, case.F)
    with pytest.raises(ChannelError, match="time of the samples"):
        scorers.free_run(model, case.X, case.F)


def test_what_is_no_chain_is_refused():
    with pytest.raises(NRFError, match="not a chain regressor"):
        scorers.balance(LinearRegression(), np.zeros((3, 3)), np.zeros(3))


MILLIMETRES = np.array([1.0, 1.0, 1e3, 1e3, 1e3, 1e3])


def to_metres(X):
    return X / MILLIMETRES


@pytest.mark.parametrize(
    "scorer", [scorers.balance, scorers.acceleration, scorers.free_run], ids=str
)
def test_in_a_pipeline_the_steps_before_are_run(case, model, scorer):
    X = case.X * MILLIMETRES
    linear = NRFRegressor(degree=1, dt=case.dt)
    pipe = make_pipeline(FunctionTransformer(to_metres), linear).fit(X, case.F)
    expected = scorer(model, case.X, case.F)
    assert scorer(pipe, X, case.F) == pytest.approx(expected, rel=1e-7)


@pytest.fixture(scope="module")
def two_records():
    """Features, forces and record ids of two tests of one chain."""
    parameters = chains.parameters(2, np.random.default_rng(4))
    cases = []
    for seed in (1, 2):
        cases.append(
            chains.duffing(
                2,
                [2],
                seed=seed,
                n_samples=900,
                parameters_of_chain=parameters,
                substeps=2,
            )
        )
    X = np.vstack([case.X for case in cases])
    F = np.vstack([case.F for case in cases])
    return X, F, np.repeat(["a", "b"], 900)


def test_cross_validation_without_routing(two_records):
    X, F, ids = two_records
    scores = cross_val_score(
        NRFRegressor(degree=3),
        X,
        F,
        groups=ids,
        cv=LeaveOneGroupOut(),
        scoring=scorers.balance,
    )
    # round-off, not the square root of it
    assert len(scores) == 2
    assert (scores > -1e-8).all()


def test_the_clock_of_a_free_run_is_routed(two_records):
    X, F, ids = two_records
    metadata = {"record": ids, "time": np.tile(np.arange(900) * 1e-3, 2)}
    with config_context(enable_metadata_routing=True):
        model = NRFRegressor(degree=3).set_fit_request(record=True, time=True)
        scores = cross_validate(
            model,
            X,
            F,
            cv=LeaveOneGroupOut().set_split_request(groups="record"),
            scoring=scorers.free_run,
            params=metadata,
            error_score="raise",
        )
    assert (-scores["test_score"] < 2.0).all()
