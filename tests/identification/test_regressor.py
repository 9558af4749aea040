"""NRFRegressor: what a user passes in and reads out."""

import pickle
import warnings

import chains
import numpy as np
import pandas as pd
import pytest
from chains import worst

from pysindy_nrf import ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    DataQualityWarning,
)
from pysindy_nrf.records import feature_names

COLUMNS = feature_names(4)
FORCES = ["F1", "F2", "F3", "F4"]


@pytest.fixture(scope="module")
def fitted(chain4):
    return NRFRegressor(degree=3).fit(chain4.X, chain4.F)


@pytest.fixture(scope="module")
def noisy(chain4):
    """Motions with 3 % noise."""
    rng = np.random.default_rng(0)
    size = 0.03 * chain4.X.std(axis=0)
    return chain4.X + size * rng.standard_normal(chain4.X.shape)


def assert_same(model, other, tolerance=1e-12):
    assert worst(model.masses_, other.masses_) < tolerance
    for site, force in other.restoring_forces_.items():
        coefficients = model.restoring_forces_[site].coefficients
        assert np.allclose(coefficients, force.coefficients, rtol=1e-6, atol=1e-6)


# -- input in every form -------------------------------------------------------------


def test_tables_are_read_by_name_in_any_order(chain4, fitted):
    X = pd.DataFrame(chain4.X, columns=COLUMNS)
    F = pd.DataFrame(chain4.F, columns=FORCES)
    shuffled = X.sample(frac=1, axis=1, random_state=3)

    model = NRFRegressor(degree=3).fit(shuffled, F[["F3", "F1", "F4", "F2"]])

    assert_same(model, fitted)
    assert list(model.feature_names_in_) == list(shuffled.columns)
    assert model.n_features_in_ == 12
    assert np.allclose(model.predict(X), fitted.predict(chain4.X), atol=1e-6)


DAHL = {1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}


def test_a_time_index_is_the_clock(dahl):
    case, *_ = dahl
    seconds = pd.Index(3.0 + np.arange(len(case.X)) * case.dt, name="t")
    X = pd.DataFrame(case.X, columns=feature_names(2), index=seconds)
    dates = pd.date_range("2024-01-01", periods=len(X), freq="1ms")
    model = NRFRegressor(degree=1, laws=DAHL)

    stepped = NRFRegressor(degree=1, laws=DAHL, dt=case.dt).fit(case.X, case.F)
    for table in (X, X.set_axis(dates), X.reset_index()):
        assert worst(model.fit(table, case.F).masses_, stepped.masses_) < 1e-7
    model.fit(case.X, case.F, time=seconds)
    assert worst(model.masses_, stepped.masses_) < 1e-7


def test_without_a_clock_a_law_with_memory_warns(dahl):
    case, *_ = dahl
    model = NRFRegressor(degree=1, laws=DAHL)
    with pytest.warns(DataQualityWarning, match="Pass dt="):
        model.fit(case.X, case.F)
    assert worst(model.masses_, case.m) > 1e-5, "the price"


def test_single_precision_is_enough_for_six_digits(chain4, fitted):
    X = chain4.X.astype(np.float32)
    F = chain4.F.astype(np.float32)
    model = NRFRegressor(degree=3).fit(X, F)
    assert worst(model.masses_, fitted.masses_) < 1e-5
    assert model.masses_.dtype == np.float64


def as_list(X):
    return X.tolist()


def as_objects(X):
    return X.astype(object)


def strided(X):
    return np.repeat(X, 2, axis=0)[::2]


def read_only(X):
    X = X.copy()
    X.flags.writeable = False
    return X


def as_nullable_table(X):
    return pd.DataFrame(X, columns=COLUMNS).convert_dtypes()


CONTAINERS = [
    as_list,
    np.asfortranarray,
    as_objects,
    np.ma.masked_invalid,
    strided,
    read_only,
    as_nullable_table,
]


@pytest.mark.parametrize("container", CONTAINERS)
def test_any_container_of_the_same_numbers(chain4, fitted, container):
    model = NRFRegressor(degree=3).fit(container(chain4.X), chain4.F)
    assert_same(model, fitted)


def test_the_input_is_never_changed(chain4):
    X = chain4.X.copy()
    F = chain4.F.copy()
    X[:10] = np.nan
    F[-5:, 0] = np.nan
    before = X.tobytes(), F.tobytes()
    model = NRFRegressor(degree=3, dt=chain4.dt, band=(0.5, 100.0)).fit(X, F)
    model.predict(X)
    model.score(X, F)
    model.balance_errors(X, F)
    model.restoring_force(X)
    assert (X.tobytes(), F.tobytes()) == before


def test_absolute_motion(chain4, fitted):
    model = NRFRegressor(degree=3, coordinates="absolute")
    assert_same(model.fit(chain4.absolute, chain4.F), fitted, 1e-10)


@pytest.fixture(scope="module")
def shaken():
    """Three floors on a base whose acceleration is 2 m/s^2 rms."""
    rng = np.random.default_rng(5)
    ag = chains.band_limited(3000, 1e-3, rng, rms=2.0)
    return chains.duffing(3, [3], seed=7, ag=ag), ag


def test_absolute_motion_on_a_moving_base(shaken):
    """Whatever the motion of the base was, it drops out of the drifts."""
    case, ag = shaken
    t = np.arange(3000) / 1e3
    xg = 0.01 * np.sin(3 * t)
    vg = 0.2 * np.cos(5 * t)
    columns = case.absolute.copy()
    columns[:, 3:6] += vg[:, None]
    columns[:, 6:] += xg[:, None]
    X = pd.DataFrame(columns, columns=feature_names(3, "absolute"))
    X = X.assign(x0=xg, xdot0=vg)

    model = NRFRegressor(degree=3, coordinates="absolute")
    model.fit(X, case.F, base_acceleration=ag)

    assert worst(model.masses_, case.m) < 1e-8
    assert np.allclose(model.predict(X), case.F, atol=1e-5)


def test_half_a_base_is_refused(chain2):
    X = pd.DataFrame(chain2.X, columns=feature_names(2, "absolute")).assign(x0=0.0)
    with pytest.raises(ChannelError, match="only one of the columns xdot0 and x0"):
        NRFRegressor(coordinates="absolute").fit(X, chain2.F)


def test_unknown_coordinates_are_refused(chain2):
    with pytest.raises(ChannelError, match="'polar' is unknown"):
        NRFRegressor(coordinates="polar").fit(chain2.X, chain2.F)


def test_nan_edges_are_masked_and_counted(chain4, fitted):
    X = chain4.X.copy()
    F = chain4.F.copy()
    X[:30, 2] = np.nan
    X[-40:, 7] = np.nan
    F[:50, 1] = np.nan
    model = NRFRegressor(degree=3).fit(X, F)
    assert_same(model, fitted, 1e-10)
    assert model.n_samples_ == len(X) - 90

    predicted = model.predict(X)
    assert np.isnan(predicted[:30]).all()
    assert np.isnan(predicted[-40:]).all()
    assert np.isfinite(predicted[30:-40]).all()


def test_a_sensor_that_fell_out_is_no_edge_of_a_filter(chain4):
    X = chain4.X.copy()
    X[700:, 5] = np.nan
    named = rf"leave 700 of {len(X)} rows; channel v2 is measured in 700"
    with pytest.warns(DataQualityWarning, match=named):
        model = NRFRegressor(degree=3).fit(X, chain4.F)
    cut = NRFRegressor(degree=3).fit(chain4.X[:700], chain4.F[:700])
    assert np.array_equal(model.masses_, cut.masses_)


def test_nan_edges_inside_stacked_records(chain4, fitted):
    n = len(chain4.X)
    X = np.vstack([chain4.X, chain4.X])
    F = np.vstack([chain4.F, chain4.F])
    X[n - 20 : n + 20] = np.nan
    model = NRFRegressor(degree=3).fit(X, F, record=np.repeat(["a", "b"], n))
    assert_same(model, fitted, 1e-10)


def test_forces_may_be_numbered(chain2):
    """Columns 0 and 1 of a table of forces are F1 and F2."""
    numbered = NRFRegressor().fit(chain2.X, pd.DataFrame(chain2.F))
    plain = NRFRegressor().fit(chain2.X, chain2.F)
    np.testing.assert_array_equal(numbered.masses_, plain.masses_)


def test_seven_rows_are_too_few_to_call_shuffled():
    case = chains.duffing(1, [1], seed=1, n_samples=400, cubic=False)
    with warnings.catch_warnings(action="ignore"):
        model = NRFRegressor(degree=1).fit(case.X[200:207], case.F[200:207])
    assert model.masses_ == pytest.approx(case.m, rel=1e-6)


def test_no_rows_are_refused(fitted):
    with pytest.raises(ValueError, match="0 rows|no samples|0 sample"):
        fitted.predict(np.zeros((0, 12)))


def test_weights_of_another_number_of_samples_are_refused(chain4, fitted):
    with pytest.raises(ChannelError, match="sample_weight has 5 values"):
        fitted.score(chain4.X, chain4.F, sample_weight=np.ones(5))


# -- orders and laws -----------------------------------------------------------------


def test_orders_by_storey(chain4):
    model = NRFRegressor(orders={"storey 2": 5, 3: (2, 1)})
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        forces = model.fit(chain4.X, chain4.F).restoring_forces_
    counts = [len(forces[i].coefficients) for i in (1, 2, 3, 4)]
    assert counts == [9, 20, 5, 9]
    terms = forces[3].coefficients.index
    assert list(terms) == ["v", "s", "v^2", "v s", "v^2 s"]


def test_a_degree_that_no_storey_has_is_refused(chain4):
    orders = {"storey 2": 5, 3: (2, 1), 4: 3, 1: 3}
    with pytest.raises(ChainError, match="contradicts"):
        NRFRegressor(degree=1, orders=orders).fit(chain4.X, chain4.F)


def test_laws_replace_the_series_where_they_are_named(chain4):
    duffing = [laws.LinearViscous(), laws.Duffing()]
    everywhere = NRFRegressor(laws=dict.fromkeys((1, 2, 3, 4), duffing))
    everywhere.fit(chain4.X, chain4.F)
    assert worst(everywhere.masses_, chain4.m) < 1e-10
    terms = everywhere.restoring_forces_[2].coefficients.index
    assert list(terms) == ["v", "s", "s^3"]

    in_one = NRFRegressor(laws={2: duffing}).fit(chain4.X, chain4.F)
    assert in_one.restoring_forces_[1].coefficients.size == 9


def test_a_law_on_one_dof_is_found_there():
    """A shaker adds 3 kg and pulls with 20 N at DOF 2, whose mass is known without."""
    case = chains.duffing(3, [1, 2, 3], seed=4)
    F = case.F.copy()
    F[:, 1] += 3.0 * case.a[:, 1] - 20.0
    model = NRFRegressor(
        known_masses={2: case.m[1]},
        laws={"dof 2": [laws.AddedMass(), laws.ConstantForce()]},
    )
    coefficients = model.fit(case.X, F).restoring_forces_["dof 2"].coefficients
    assert coefficients.tolist() == pytest.approx([3.0, -20.0], rel=1e-7)


def test_an_added_mass_that_leaves_nothing_is_named():
    """The force of DOF 2 was read with 1.5 times its inertia taken off."""
    case = chains.duffing(2, [1, 2], seed=4)
    known = case.m[1]
    added = -1.5 * case.m[1]
    F = case.F.copy()
    F[:, 1] += added * case.a[:, 1]
    model = NRFRegressor(known_masses={2: known}, laws={"dof 2": laws.AddedMass()})
    named = f"DOF 2 has {known:.4g} kg and {added:.4g} kg added"
    with pytest.warns(BiasWarning, match=named):
        model.fit(case.X, F)
    total = [case.m[0], known + added]
    assert model.model_.total_masses == pytest.approx(total, rel=1e-6)


# -- output --------------------------------------------------------------------------


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def test_predicted_forces_are_the_measured_ones(chain4, fitted):
    assert np.allclose(fitted.predict(chain4.X), chain4.F, atol=1e-7)
    one_row = fitted.predict(chain4.X[[100]])
    assert np.allclose(one_row, chain4.F[[100]], atol=1e-7)


def test_restoring_forces_are_those_of_the_storeys(chain4, fitted):
    forces = fitted.restoring_force(chain4.X)
    assert np.allclose(forces, chain4.storey_forces, rtol=1e-8, atol=1e-8)


def test_score_judges_accelerations(chain4, fitted, noisy):
    """R^2 of the predicted accelerations, pooled; against the same written out."""
    force = fitted.restoring_force(noisy)
    from_above = np.hstack([force[:, 1:], np.zeros((len(noisy), 1))])
    predicted = (chain4.F - force + from_above) / fitted.masses_
    a = noisy[:, :4]
    missed = ((a - predicted) ** 2).sum()
    expected = 1 - missed / ((a - a.mean(axis=0)) ** 2).sum()
    assert fitted.score(noisy, chain4.F) == pytest.approx(expected, rel=1e-10)


def test_an_exact_model_scores_one(chain4, fitted):
    assert fitted.score(chain4.X, chain4.F) == pytest.approx(1.0, abs=1e-12)


def test_score_leaves_out_balances_whose_force_is_unknown(chain4, fitted):
    F = chain4.F.copy()
    F[:, 2] = np.nan
    assert fitted.score(chain4.X, F) == pytest.approx(1.0, abs=1e-12)


def test_errors_are_shares_of_the_force_or_of_the_inertia(chain4, noisy):
    """100 rms(e) / rms(F) on the forced DOF, / rms(m a) elsewhere."""
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        model = NRFRegressor(degree=3).fit(noisy, chain4.F)
    errors = model.errors_
    assert list(errors["of"][:4]) == ["m a", "m a", "F", "m a"]

    missed = rms(model.predict(noisy) - chain4.F)
    inertia = rms(noisy[:, :4] * model.masses_)
    forced = np.array([False, False, True, False])
    reference = np.where(forced, rms(chain4.F), inertia)
    of_dofs = errors.loc[["dof 1", "dof 2", "dof 3", "dof 4"], "error"]
    assert of_dofs.to_numpy() == pytest.approx(100 * missed / reference, rel=1e-9)

    storeys = rms(model.restoring_force(noisy))
    shares = [((x / storeys) ** 2).sum() for x in (missed, reference)]
    pooled = 100 * np.sqrt(shares[0] / shares[1])
    assert errors.loc["pooled", "error"] == pytest.approx(pooled, rel=1e-9)
    pd.testing.assert_frame_equal(model.balance_errors(noisy, chain4.F), errors)


def least_squares(columns, force):
    size = columns.std(axis=0)
    return np.linalg.lstsq(columns / size, force)[0] / size


def test_the_third_law_gap_is_the_difference_of_two_estimates(dahl):
    """R_2 from balance 2 and from balance 1, each by ordinary least squares."""
    case, *_ = dahl
    motion = np.column_stack([case.v[:, 1], case.s[:, 1]])
    below = np.column_stack([case.a[:, 0], case.v[:, 0], case.s[:, 0], -motion])
    above = np.column_stack([case.a[:, 1], motion])
    lower = least_squares(below, case.F[:, 0])[3:]
    upper = least_squares(above, case.F[:, 1])[1:]
    difference = np.linalg.norm(motion @ (upper - lower))
    expected = 100 * difference / np.linalg.norm(motion @ upper)

    model = NRFRegressor(degree=1)
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        model.fit(case.X, case.F)
        assert model.third_law_gap_["storey 2"] == pytest.approx(expected, rel=1e-6)
        model.set_params(strategy="complete").fit(case.X, case.F)
    coefficients = model.restoring_forces_[2].coefficients.to_numpy()
    assert coefficients == pytest.approx(upper, rel=1e-9), "the one of balance 2"


# -- a band --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def in_band(chain4):
    model = NRFRegressor(degree=3, band=(1.0, 80.0), dt=chain4.dt)
    return model.fit(chain4.X, chain4.F)


def test_a_band_keeps_an_exact_model_exact(chain4, in_band):
    assert worst(in_band.masses_, chain4.m) < 1e-8


def test_a_band_judges_inside_of_it(chain4, fitted, in_band):
    """Noise above 150 Hz alone."""
    hiss = np.random.default_rng(0).standard_normal(chain4.X.shape)
    spectrum = np.fft.rfft(hiss, axis=0)
    spectrum[np.fft.rfftfreq(len(hiss), chain4.dt) <= 150.0] = 0
    hiss = np.fft.irfft(spectrum, len(hiss), axis=0)
    X = chain4.X + 0.2 * chain4.X.std(axis=0) * hiss

    assert fitted.score(X, chain4.F) < 0.999 < in_band.score(X, chain4.F)
    assert in_band.balance_errors(X, chain4.F).loc["pooled", "error"] < 5


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_a_band_leaves_an_unknown_force_unknown():
    """The force on floor 2 is unknown: the balance of floor 1 alone gives m1."""
    storey = laws.PowerSeries(1, [30.0, 4e4])
    truth = ChainModel([8.0, 6.0], {"storey 1": storey, "storey 2": storey})
    F = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[1, 2], rms=60.0, band=(1, 40), random_state=0
    )
    X, _ = simulate(truth, F, 1 / 500).to_features(smooth=False)
    model = NRFRegressor(degree=1, dt=1 / 500, band=(3, 60), known_masses={2: 6.0})
    model.fit(X.to_numpy(), F * [1.0, np.nan])
    assert model.masses_[0] == pytest.approx(8.0, rel=1e-3)


# -- a model that is saved -----------------------------------------------------------


def test_a_fitted_model_survives_pickling(chain4, fitted):
    again = pickle.loads(pickle.dumps(fitted))
    assert np.array_equal(again.predict(chain4.X), fitted.predict(chain4.X))
    force = fitted.restoring_forces_["storey 2"](0.1, 1e-4)
    assert again.restoring_forces_["storey 2"](0.1, 1e-4) == force
    pd.testing.assert_series_equal(again.condition_, fitted.condition_)


def test_a_saved_model_has_no_data(fitted):
    again = pickle.loads(pickle.dumps(fitted))
    assert again.result_.data is None
    with pytest.raises(ChannelError, match="without the data"):
        again.free_runs()
