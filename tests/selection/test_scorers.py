"""Named scorers: what they mean, on estimators and pipelines, with and without metadata
routing.
"""

import chains
import numpy as np
import pytest
from sklearn import config_context
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import ChannelError, NRFError
from pysindy_nrf.selection import scorers

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")


@pytest.fixture(scope="module")
def fitted():
    case = chains.duffing(2, [2], seed=6, n_samples=2000, substeps=4)
    return case, NRFRegressor(degree=1, dt=case.dt).fit(case.X, case.F)


def test_balance_is_the_pooled_error_by_hand(fitted):
    """Each balance divided by the rms of its storey force; reference F where forced, m
    a elsewhere.
    """
    case, model = fitted
    residual = model.predict(case.X) - case.F
    storey = np.sqrt(np.mean(model.restoring_force(case.X) ** 2, axis=0))
    reference = np.column_stack([model.masses_[0] * case.a[:, 0], case.F[:, 1]])
    top, bottom = (
        np.sum(np.mean(y**2, axis=0) / storey**2) for y in (residual, reference)
    )
    assert scorers.balance(model, case.X, case.F) == pytest.approx(
        -100 * np.sqrt(top / bottom), rel=1e-9
    )


def test_acceleration_is_the_estimators_own_score_and_not_r2_of_forces(fitted):
    case, model = fitted
    found = scorers.acceleration(model, case.X, case.F)
    assert found == model.score(case.X, case.F)
    gap = (case.F - model.predict(case.X)) / model.masses_
    assert found == pytest.approx(
        1 - np.sum(gap**2) / np.sum((case.a - case.a.mean(axis=0)) ** 2), abs=1e-12
    )


def test_weights_take_samples_out_of_the_score(fitted):
    case, model = fitted
    rows = np.arange(2000) < 700
    assert model.score(case.X, case.F, sample_weight=1.0 * rows) == pytest.approx(
        model.score(case.X[rows], case.F[rows]), abs=1e-12
    )
    with pytest.raises(ChannelError, match="not valid weights"):
        model.score(case.X, case.F, sample_weight=-1.0 * rows)


def test_the_free_run_is_the_simulation_from_the_first_state(fitted):
    case, _ = fitted
    model = NRFRegressor(degree=3, dt=case.dt).fit(case.X, case.F)
    x = case.s.cumsum(axis=1)
    run = model.simulate(case.F, x0=x[0], v0=case.v[0].cumsum())
    error = np.sqrt(
        np.mean(np.mean((run.displacement - x) ** 2, axis=0) / np.mean(x**2, axis=0))
    )
    assert scorers.free_run(model, case.X, case.F) == pytest.approx(
        -100 * error, rel=1e-6
    )
    assert 100 * error < 1.0
    with pytest.raises(ChannelError, match="time of the samples"):
        scorers.free_run(NRFRegressor(degree=3).fit(case.X, case.F), case.X, case.F)


def test_what_is_no_chain_is_refused():
    with pytest.raises(NRFError, match="not a chain regressor"):
        scorers.balance(LinearRegression(), np.zeros((3, 3)), np.zeros(3))


def test_in_a_pipeline_the_steps_before_are_run(fitted):
    case, model = fitted
    millimetres = case.X * np.array([1.0, 1.0, 1e3, 1e3, 1e3, 1e3])
    pipe = make_pipeline(
        FunctionTransformer(lambda X: X / np.array([1.0, 1.0, 1e3, 1e3, 1e3, 1e3])),
        NRFRegressor(degree=1, dt=case.dt),
    )
    pipe.fit(millimetres, case.F)
    for scorer in (scorers.balance, scorers.acceleration, scorers.free_run):
        assert scorer(pipe, millimetres, case.F) == pytest.approx(
            scorer(model, case.X, case.F), rel=1e-7
        )


def test_cross_validation_with_and_without_routing():
    given = chains.parameters(2, np.random.default_rng(4))
    cases = [
        chains.duffing(2, [2], seed=s, n_samples=900, given=given, substeps=2)
        for s in (1, 2)
    ]
    X, F = np.vstack([c.X for c in cases]), np.vstack([c.F for c in cases])
    ids, time = np.repeat(["a", "b"], 900), np.tile(np.arange(900) * cases[0].dt, 2)
    plain = cross_val_score(
        NRFRegressor(degree=3),
        X,
        F,
        groups=ids,
        cv=LeaveOneGroupOut(),
        scoring=scorers.balance,
    )
    assert (plain > -1e-8).all() and len(
        plain
    ) == 2  # round-off, not the square root of it
    with config_context(enable_metadata_routing=True):
        model = NRFRegressor(degree=3).set_fit_request(record=True, time=True)
        params = {"record": ids, "time": time}
        found = cross_validate(
            model,
            X,
            F,
            cv=LeaveOneGroupOut().set_split_request(groups="record"),
            scoring={"f": scorers.free_run},
            params=params,
            error_score="raise",
        )
        assert (
            -found["test_f"] < 2.0
        ).all()  # the sampling step came with the metadata
