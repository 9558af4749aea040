"""The door: any input becomes one data set; what has no part in a fit is refused."""

import warnings

import numpy as np
import pandas as pd
import pysindy as ps
import pytest

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import ChainError, DataQualityWarning, NRFError
from pysindy_nrf.identification import choose_method, form_of
from pysindy_nrf.records import FrequencyResponse

FS = 250.0
STOREY = [laws.LinearElastic(1.4e5), laws.LinearViscous(30.0)]
TRUTH = ChainModel([12.4] * 4, {i: STOREY for i in (1, 2, 3, 4)})


@pytest.fixture(scope="module")
def every_floor():
    force = excitation.band_limited_random(
        4, 6.0, FS, excited=[4], rms=100.0, band=(0.5, 50), random_state=0
    )
    return simulate(TRUTH, force, 1 / FS)


@pytest.fixture(scope="module")
def two_floors(every_floor):
    """Accelerations of floors 2 and 4 alone."""
    acceleration = every_floor.acceleration.copy()
    acceleration[:, [0, 2]] = np.nan
    return Record(force=every_floor.force, acceleration=acceleration, fs=FS)


@pytest.fixture(scope="module")
def responses():
    """Accelerances of the floors, under a force on the top floor."""
    f = np.arange(0.25, 60, 0.25)
    iw = 2j * np.pi * f
    M, C, K = TRUTH.matrices()
    force = np.array([0.0, 0.0, 0.0, 1.0])
    dynamic = M * iw[:, None, None] ** 2 + C * iw[:, None, None] + K
    displacement = np.linalg.solve(dynamic, force[:, None])[:, :, 0]
    return FrequencyResponse(f, displacement * iw[:, None] ** 2, excited=4)


@pytest.fixture(scope="module")
def model(every_floor):
    return NRFRegressor(degree=1).fit(every_floor)


@pytest.fixture(scope="module")
def model_of_two_floors(two_floors):
    with warnings.catch_warnings(action="ignore"):
        return NRFRegressor(degree=1).fit(two_floors)


# -- what has no part in a fit is refused by name ------------------------------------

BESIDE = {
    "y": np.zeros((1500, 4)),
    "record": np.arange(1500) // 100,
    "time": np.arange(1500) / FS,
    "base_acceleration": np.ones(1500),
    "covariates": {"u": np.ones(1500)},
    "state": "somewhere",
}
NAMES_IN_MESSAGES = {"y": "F"}  # the forces, in messages
OPTIMIZER = ps.STLSQ(threshold=1e9)


@pytest.mark.parametrize("name", BESIDE)
def test_records_hold_their_own(every_floor, name):
    with pytest.raises(
        NRFError, match=f"^{NAMES_IN_MESSAGES.get(name, name)} was given in addition to"
    ):
        NRFRegressor(degree=1).fit(every_floor, **{name: BESIDE[name]})


@pytest.mark.parametrize("setting", [{"dt": 5.0}, {"coordinates": "absolute"}])
def test_records_have_a_clock_and_coordinates(every_floor, setting):
    (name,) = setting
    with pytest.raises(NRFError, match=f"^{name} was given in addition to records"):
        NRFRegressor(degree=1, **setting).fit(every_floor)
    with pytest.raises(NRFError, match=f"^{name} was given in addition to records"):
        NRFRegressor(degree=1, **setting).partial_fit(every_floor)


@pytest.mark.parametrize("name", [*BESIDE, "sample_weight"])
def test_records_with_gaps_take_nothing_beside_them(two_floors, name):
    arguments = {name: BESIDE.get(name, np.ones(1500))}
    with pytest.raises(NRFError, match=f"^{NAMES_IN_MESSAGES.get(name, name)} "):
        NRFRegressor(degree=1).fit(two_floors, **arguments)


@pytest.mark.parametrize(
    "setting",
    [
        {"optimizer": OPTIMIZER},
        {"strategy": "complete"},
        {"dt": 5.0},
        {"coordinates": "absolute"},
        {"estimation": "ls"},
        {"estimation": "iv"},
    ],
)
def test_records_with_gaps_refuse_what_the_free_run_does_not_use(two_floors, setting):
    (name,) = setting
    with pytest.raises(NRFError, match=f"^{name}"):
        NRFRegressor(degree=1, **setting).fit(two_floors)


@pytest.mark.parametrize("name", [*BESIDE, "sample_weight"])
def test_frequency_responses_take_nothing_beside_them(responses, name):
    arguments = {name: BESIDE.get(name, np.ones(3))}
    with pytest.raises(
        NRFError, match=f"^{NAMES_IN_MESSAGES.get(name, name)} was given in addition to"
    ):
        NRFRegressor(degree=1).fit(responses, **arguments)


@pytest.mark.parametrize("estimation", ["ls", "simulation"])
def test_frequency_responses_have_a_method_of_their_own(responses, estimation):
    with pytest.raises(ChainError, match="Choose one of auto, iv"):
        NRFRegressor(degree=1, estimation=estimation).fit(responses)


def test_arrays_have_no_state(every_floor):
    X, F = every_floor.to_features(smooth=False)
    with pytest.raises(NRFError, match="^state was given in addition to"):
        NRFRegressor(degree=1).fit(X, F, state="somewhere")


def test_instruments_have_no_weights(every_floor):
    weights = np.ones(every_floor.n_samples)
    with pytest.raises(ChainError, match="^sample_weight has no part"):
        NRFRegressor(degree=1, estimation="iv").fit(every_floor, sample_weight=weights)


def test_the_loop_refuses_calibration_where_it_has_no_part(two_floors):
    with pytest.raises(ChainError, match="^calibration has no part"):
        close_loop(two_floors, catalogue=[], calibration={"gain": 0.01})


# -- one method for every form -------------------------------------------------------


@pytest.mark.parametrize(
    ("X", "estimation", "name"),
    [
        (np.zeros((9, 6)), "auto", "LeastSquares"),
        (np.zeros((9, 6)), "iv", "InstrumentalVariables"),
        (np.zeros((9, 6)), "simulation", "OutputError"),
        ("test.parquet", "auto", "LeastSquares"),
        (["one.npy", "two.npy"], "ls", "LeastSquares"),
        (iter([]), "auto", "LeastSquares"),
    ],
)
def test_the_form_of_the_data_and_the_setting_give_the_method(X, estimation, name):
    assert type(choose_method(estimation, form_of(X))).__name__ == name


def test_weights_choose_least_squares_of_records(every_floor):
    form = form_of(every_floor)
    plain, weighted = (
        choose_method("auto", form, names) for names in ([], ["sample_weight"])
    )
    assert type(plain).__name__ == "LeastSquaresOrInstruments"
    assert type(weighted).__name__ == "LeastSquares"


def test_an_unknown_setting_is_refused():
    with pytest.raises(ChainError, match="'magic' is unknown"):
        choose_method("magic", form_of(np.zeros((9, 6))))


# -- the same attributes after every kind of fit -------------------------------------


def public(fitted):
    return {name for name in vars(fitted) if name.endswith("_")}


def test_every_fit_sets_the_same_attributes(
    model, model_of_two_floors, responses, every_floor
):
    X, F = every_floor.to_features(smooth=False)
    others = [
        NRFRegressor(degree=1).fit(responses),
        NRFRegressor(degree=1).fit(X.to_numpy(), F.to_numpy()),
        NRFRegressor(degree=1).fit(iter([(X.to_numpy(), F.to_numpy())])),
        NRFRegressor(degree=1).partial_fit(every_floor),
        model_of_two_floors,
    ]
    for other in others:
        assert public(other) == public(model)
        assert other.n_features_in_ == 12
        assert set(other.data_warnings_) == set(model.data_warnings_)


def test_a_fit_leaves_nothing_of_the_one_before(
    every_floor, two_floors, model, model_of_two_floors
):
    refitted = NRFRegressor(degree=1)
    table, forces = every_floor.to_features(smooth=False)
    refitted.fit(table, forces)
    assert list(refitted.feature_names_in_) == list(table.columns)

    with warnings.catch_warnings(action="ignore"):
        refitted.fit(two_floors)
    assert len(refitted.motions_) == 1
    assert not hasattr(refitted, "feature_names_in_")
    np.testing.assert_array_equal(refitted.masses_, model_of_two_floors.masses_)

    refitted.fit(every_floor)
    assert refitted.motions_ == []
    np.testing.assert_array_equal(refitted.masses_, model.masses_)


# -- names of columns, and lines of warnings -----------------------------------------


def test_forces_are_taken_by_name(every_floor, model):
    X, F = every_floor.to_features(smooth=False)
    turned = F[["F4", "F1", "F3", "F2"]]
    assert model.score(X, turned) == model.score(X, F)
    run = model.simulate(turned, dt=1 / FS).displacement
    np.testing.assert_array_equal(run, model.simulate(F, dt=1 / FS).displacement)


def test_a_warning_points_at_the_line_of_the_user(every_floor):
    X, F = every_floor.to_features(smooth=False)
    time = X.index.to_numpy() + 2.0 * (np.arange(len(X)) >= 20)
    table = X.set_axis(pd.Index(time, name="t"))
    with warnings.catch_warnings(record=True, action="always") as caught:
        NRFRegressor(degree=1).fit(table, F.set_axis(table.index))
    (alone,) = [w for w in caught if w.category is DataQualityWarning]
    assert "stand alone between gaps" in str(alone.message)
    assert alone.filename == __file__
