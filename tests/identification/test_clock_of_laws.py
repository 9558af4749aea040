"""Laws of time read the clock of the record: a part of it says what the whole says."""

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
OPTIONS = {"degree": 1, "laws": {1: [laws.PowerSeries(1), laws.StiffnessDrift()]}}


def drifting(duration=40.0, noise=0.0):
    held = {
        1: [laws.PowerSeries(1, [40.0, 4e4]), laws.StiffnessDrift(kt=-500.0)],
        2: laws.PowerSeries(1, [40.0, 3e4]),
    }
    return driven(
        ChainModel([10.0, 8.0], held), 2, duration, FS, 100.0, (1, 30), hold="cubic"
    )


@pytest.fixture(scope="module")
def data():
    return drifting().to_features(smooth=False)


def test_a_later_part_is_predicted_as_in_the_whole(data):
    X, F = data
    model = NRFRegressor(**OPTIONS).fit(X, F)
    later = slice(4000, None)
    np.testing.assert_allclose(
        model.predict(X.iloc[later]), model.predict(X)[later], atol=1e-9
    )
    np.testing.assert_allclose(
        model.predict(X.to_numpy()[later], time=X.index[later]),
        model.predict(X)[later],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        model.model_.predict(X.iloc[later]), model.predict(X)[later], atol=1e-9
    )
    assert model.score(X.iloc[later], F.iloc[later]) == pytest.approx(1.0, abs=1e-9)


def test_a_window_of_a_record_keeps_its_clock():
    record = drifting()
    model = NRFRegressor(**OPTIONS).fit(record)
    window = record.window(20, 40)
    whole, part = (
        model.balance_errors(r).loc["pooled", "error"] for r in (record, window)
    )
    assert part < 1.5 * whole + 0.5  # 35 % if its clock began anew
    assert model.model_.laws[next(iter(model.model_.laws))][1].values[
        0
    ] == pytest.approx(-500.0, rel=0.03)


def test_held_out_blocks_of_a_law_of_time_are_predicted_and_every_search_agrees(data):
    X, F = data
    cv = BlockedTimeSplit(4)
    assert (
        np.abs(
            cross_val_score(
                NRFRegressor(**OPTIONS), X, F, cv=cv, scoring=scorers.balance
            )
        ).max()
        < 1e-6
    )
    grid = GridSearchCV(
        NRFRegressor(laws=OPTIONS["laws"]),
        {"degree": [1, 2]},
        cv=cv,
        scoring=scorers.balance,
    ).fit(X, F)
    found = select_order(
        X, F, degrees=[1, 2], cv=cv, laws=OPTIONS["laws"]
    ).fold_scores.to_numpy()
    for i in range(4):
        np.testing.assert_allclose(
            found[:, i], grid.cv_results_[f"split{i}_test_score"], atol=1e-5
        )


def test_pieces_that_come_one_after_another_are_on_one_clock(data):
    X, F = data
    model = NRFRegressor(**OPTIONS)
    for rows in (slice(0, 3000), slice(3000, 5000), slice(5000, None)):
        model.partial_fit(X.iloc[rows], F.iloc[rows])
    assert model.restoring_forces_[1].coefficients["s t"] == pytest.approx(
        -500.0, rel=1e-6
    )
    assert model.restoring_forces_[1].coefficients["s"] == pytest.approx(4e4, rel=1e-6)


def test_dates_count_from_the_first_row(data):
    X, F = data
    dated = X.set_axis(
        pd.Timestamp("2026-11-22 10:00") + pd.to_timedelta(X.index.to_numpy(), unit="s")
    )
    model = NRFRegressor(**OPTIONS).fit(dated, F)
    assert model.restoring_forces_[1].coefficients["s t"] == pytest.approx(
        -500.0, rel=1e-6
    )


def stepping(start=0.0, step=13.0):
    held = {1: [laws.PowerSeries(1, [40.0, 4e4]), laws.StiffnessStep(t0=step, dk=-6e3)]}
    record = driven(
        ChainModel([10.0], held), 1, 20.0, FS, 100.0, (1, 30), seed=1, hold="cubic"
    )
    record.t0 = start
    return record


def test_the_instant_of_a_step_is_told_and_found_on_the_clock_of_the_record():
    record = stepping(start=100.0)
    given = {"laws": {1: [laws.PowerSeries(1), laws.StiffnessStep()]}}
    free = NRFRegressor(**given).fit(record).model_.laws
    assert free[next(iter(free))][1].shape["t0"] == pytest.approx(113.0, abs=0.05)
    told = NRFRegressor(
        laws={1: [laws.PowerSeries(1), laws.StiffnessStep(t0=113.0)]}
    ).fit(record)
    assert told.restoring_forces_[1].coefficients["s [t > t0]"] == pytest.approx(
        -6e3, rel=0.03
    )
    assert told.simulate(
        record.force, dt=1 / FS, t0=100.0
    ).displacement == pytest.approx(
        record.displacement, abs=0.05 * record.displacement.std()
    )


@pytest.mark.slow
def test_the_loop_finds_a_step_on_the_clock_of_a_window():
    whole = stepping()
    step = close_loop(
        whole.window(5, 20),
        NRFRegressor(degree=1),
        catalogue=[laws.StiffnessStep(), laws.CubicStiffness()],
    ).steps[0]
    low, high = step.intervals["t0"]  # a held-out piece hides when
    assert step.law == "stiffness_step" and low < 13.0 < high < low + 2.5
    assert step.intervals["dk"][0] < step.parameters["dk"] < step.intervals["dk"][1]
