"""Laws of time read the clock of the record, of which a part has its own stretch."""

import numpy as np
import pandas as pd
import pytest
from chains import driven
from sklearn.model_selection import GridSearchCV, cross_val_score

from pysindy_nrf import (
    BlockedTimeSplit,
    ChainModel,
    NRFRegressor,
    close_loop,
    laws,
    select_order,
)
from pysindy_nrf.selection import scorers

FS = 200.0
DRIFT = -500.0  # N/m/s
DECLARED = {1: [laws.PowerSeries(1), laws.StiffnessDrift()]}


# -- a stiffness that drifts ---------------------------------------------------------


@pytest.fixture(scope="module")
def record():
    linear = laws.PowerSeries(1, [40.0, 4e4])
    softening = {1: [linear, laws.StiffnessDrift(kt=DRIFT)], 2: linear}
    truth = ChainModel([10.0, 8.0], softening)
    return driven(truth, 2, 40.0, FS, 100.0, (1, 30), hold="cubic")


@pytest.fixture(scope="module")
def data(record):
    return record.to_features(smooth=False)


@pytest.fixture(scope="module")
def drifting(data):
    return NRFRegressor(degree=1, laws=DECLARED).fit(*data)


def test_a_later_part_is_predicted_as_in_the_whole(data, drifting):
    X, F = data
    later = slice(4000, None)
    forces = drifting.predict(X)[later]
    plain = X.to_numpy()[later]
    time = X.index[later]

    assert np.allclose(drifting.predict(X.iloc[later]), forces, atol=1e-9)
    assert np.allclose(drifting.predict(plain, time=time), forces, atol=1e-9)
    assert np.allclose(drifting.model_.predict(X.iloc[later]), forces, atol=1e-9)
    score = drifting.score(X.iloc[later], F.iloc[later])
    assert score == pytest.approx(1.0, abs=1e-9)


def test_a_window_of_a_record_keeps_its_clock(record):
    """Its error would be 35 % if its clock began anew."""
    model = NRFRegressor(degree=1, laws=DECLARED).fit(record)
    error_of_record = model.balance_errors(record).loc["pooled", "error"]
    error_of_window = model.balance_errors(record.window(20, 40)).loc["pooled", "error"]
    assert error_of_window < 1.5 * error_of_record + 0.5
    drift = model.restoring_forces_[1].coefficients["s t"]
    assert drift == pytest.approx(DRIFT, rel=0.03)


def test_held_out_blocks_of_a_law_of_time_are_predicted(data):
    model = NRFRegressor(degree=1, laws=DECLARED)
    scores = cross_val_score(
        model, *data, cv=BlockedTimeSplit(4), scoring=scorers.balance
    )
    assert np.abs(scores).max() < 1e-6


def test_every_search_agrees_on_a_law_of_time(data):
    folds = BlockedTimeSplit(4)
    grid = GridSearchCV(
        NRFRegressor(laws=DECLARED),
        {"degree": [1, 2]},
        cv=folds,
        scoring=scorers.balance,
    ).fit(*data)
    selection = select_order(*data, degrees=[1, 2], cv=folds, laws=DECLARED)
    for i, scores in enumerate(selection.fold_scores.to_numpy().T):
        expected = grid.cv_results_[f"split{i}_test_score"]
        np.testing.assert_allclose(scores, expected, atol=1e-5)


def test_pieces_that_come_one_after_another_are_on_one_clock(data):
    X, F = data
    model = NRFRegressor(degree=1, laws=DECLARED)
    for rows in (slice(0, 3000), slice(3000, 5000), slice(5000, None)):
        model.partial_fit(X.iloc[rows], F.iloc[rows])
    coefficients = model.restoring_forces_[1].coefficients
    assert coefficients["s t"] == pytest.approx(DRIFT, rel=1e-6)
    assert coefficients["s"] == pytest.approx(4e4, rel=1e-6)


def test_dates_count_from_the_first_row(data):
    X, F = data
    seconds = pd.to_timedelta(X.index.to_numpy(), unit="s")
    dated = X.set_axis(pd.Timestamp("2026-11-22 10:00") + seconds)
    model = NRFRegressor(degree=1, laws=DECLARED).fit(dated, F)
    drift = model.restoring_forces_[1].coefficients["s t"]
    assert drift == pytest.approx(DRIFT, rel=1e-6)


# -- a stiffness that falls at an instant --------------------------------------------

LOSS = -6e3  # N/m


def stepping(step=13.0):
    """20 s of one floor, whose storey loses stiffness at an instant."""
    storey = [laws.PowerSeries(1, [40.0, 4e4]), laws.StiffnessStep(t0=step, dk=LOSS)]
    truth = ChainModel([10.0], {1: storey})
    return driven(truth, 1, 20.0, FS, 100.0, (1, 30), seed=1, hold="cubic")


@pytest.fixture(scope="module")
def late():
    """The same on a clock that begins at 100 s."""
    record = stepping()
    record.t0 = 100.0
    return record


def test_the_instant_of_a_step_is_found_on_the_clock_of_the_record(late):
    free = {1: [laws.PowerSeries(1), laws.StiffnessStep()]}
    fitted_laws = NRFRegressor(laws=free).fit(late).model_.laws["storey 1"]
    assert fitted_laws[1].shape["t0"] == pytest.approx(113.0, abs=0.05)


def test_the_instant_of_a_step_is_declared_on_the_clock_of_the_record(late):
    declared = {1: [laws.PowerSeries(1), laws.StiffnessStep(t0=113.0)]}
    model = NRFRegressor(laws=declared).fit(late)
    loss = model.restoring_forces_[1].coefficients["s [t > t0]"]
    assert loss == pytest.approx(LOSS, rel=0.03)

    run = model.simulate(late.force, dt=1 / FS, t0=100.0).displacement
    tolerance = 0.05 * late.displacement.std()
    assert run == pytest.approx(late.displacement, abs=tolerance)


@pytest.mark.slow
def test_the_loop_finds_a_step_on_the_clock_of_a_window():
    window = stepping().window(5, 20)
    catalogue = [laws.StiffnessStep(), laws.CubicStiffness()]
    step = close_loop(window, NRFRegressor(degree=1), catalogue=catalogue).steps[0]
    assert step.law == "stiffness_step"
    low, high = step.intervals["t0"]  # a held-out piece hides when
    assert low < 13.0 < high < low + 2.5
    low, high = step.intervals["dk"]
    assert low < step.parameters["dk"] < high
