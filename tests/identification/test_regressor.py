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
from pysindy_nrf.records.dataset import feature_names

NAMES4 = [f"{kind}{j}" for kind in "avs" for j in range(1, 5)]


@pytest.fixture(scope="module")
def fitted(chain4):
    return NRFRegressor(degree=3).fit(chain4.X, chain4.F)


def same(model, other, tolerance=1e-12):
    assert worst(model.masses_, other.masses_) < tolerance
    for site, R in other.restoring_forces_.items():
        assert np.allclose(
            model.restoring_forces_[site].coefficients,
            R.coefficients,
            rtol=1e-6,
            atol=1e-6,
        )


# -- input in every form -------------------------------------------------------


def test_tables_are_read_by_name_in_any_order(chain4, fitted):
    X, F = (
        pd.DataFrame(chain4.X, columns=NAMES4),
        pd.DataFrame(chain4.F, columns=["F1", "F2", "F3", "F4"]),
    )
    shuffled = X.sample(frac=1, axis=1, random_state=3)
    model = NRFRegressor(degree=3).fit(shuffled, F[["F3", "F1", "F4", "F2"]])
    same(model, fitted)
    assert (
        list(model.feature_names_in_) == list(shuffled.columns)
        and model.n_features_in_ == 12
    )
    assert np.allclose(model.predict(X), fitted.predict(chain4.X), atol=1e-6)


def test_a_time_index_is_the_clock(dahl):
    case, *_ = dahl
    held = {1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}
    t = pd.Index(3.0 + np.arange(len(case.X)) * case.dt, name="t")
    X = pd.DataFrame(case.X, columns=["a1", "a2", "v1", "v2", "s1", "s2"], index=t)
    dates = X.set_axis(pd.date_range("2024-01-01", periods=len(X), freq="1ms"))
    reference = NRFRegressor(degree=1, laws=held, dt=case.dt).fit(case.X, case.F)
    for table in (X, dates, X.reset_index()):
        assert (
            worst(
                NRFRegressor(degree=1, laws=held).fit(table, case.F).masses_,
                reference.masses_,
            )
            < 1e-7
        )
    assert (
        worst(
            NRFRegressor(degree=1, laws=held).fit(case.X, case.F, time=t).masses_,
            reference.masses_,
        )
        < 1e-7
    )


def test_without_a_clock_a_law_with_memory_warns(dahl):
    case, *_ = dahl
    model = NRFRegressor(
        degree=1, laws={1: [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]}
    )
    with pytest.warns(DataQualityWarning, match="Pass dt="):
        model.fit(case.X, case.F)
    assert worst(model.masses_, case.m) > 1e-5  # the price


def test_single_precision_is_enough_for_six_digits(chain4, fitted):
    model = NRFRegressor(degree=3).fit(
        chain4.X.astype(np.float32), chain4.F.astype(np.float32)
    )
    assert (
        worst(model.masses_, fitted.masses_) < 1e-5
        and model.masses_.dtype == np.float64
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda A: A.tolist(),
        np.asfortranarray,
        lambda A: A.astype(object),
        np.ma.masked_invalid,
        lambda A: np.repeat(A, 2, axis=0)[::2],
        lambda A: _read_only(A),
        lambda A: pd.DataFrame(A, columns=NAMES4).convert_dtypes(),
    ],
    ids=["list", "fortran", "object", "masked", "strided", "read-only", "nullable"],
)
def test_any_container_of_the_same_numbers(chain4, fitted, change):
    same(NRFRegressor(degree=3).fit(change(chain4.X), chain4.F), fitted)


def _read_only(A):
    A = A.copy()
    A.flags.writeable = False
    return A


def test_the_input_is_never_changed(chain4):
    X, F = chain4.X.copy(), chain4.F.copy()
    X[:10], F[-5:, 0] = np.nan, np.nan
    before = X.tobytes(), F.tobytes()
    model = NRFRegressor(degree=3, dt=chain4.dt, band=(0.5, 100.0)).fit(X, F)
    (
        model.predict(X),
        model.score(X, F),
        model.balance_errors(X, F),
        model.restoring_force(X),
    )
    assert (X.tobytes(), F.tobytes()) == before


def test_absolute_motion(chain4, fitted):
    same(
        NRFRegressor(degree=3, coordinates="absolute").fit(chain4.absolute, chain4.F),
        fitted,
        1e-10,
    )


def test_absolute_motion_on_a_moving_base():
    ag = chains.band_limited(3000, 1e-3, np.random.default_rng(5), rms=2.0)
    case = chains.duffing(3, [3], seed=7, ag=ag)
    xg, vg = (
        0.01 * np.sin(3 * np.arange(3000) / 1e3),
        0.2 * np.cos(5 * np.arange(3000) / 1e3),
    )  # whatever the base did
    A = case.absolute.copy()
    A[:, 3:6] += vg[:, None]
    A[:, 6:] += xg[:, None]
    names = [f"{kind}{j}" for kind in ("a", "xdot", "x") for j in range(1, 4)]
    X = pd.DataFrame(A, columns=names).assign(x0=xg, xdot0=vg)
    model = NRFRegressor(degree=3, coordinates="absolute").fit(
        X, case.F, base_acceleration=ag
    )
    assert worst(model.masses_, case.m) < 1e-8 and np.allclose(
        model.predict(X), case.F, atol=1e-5
    )


def test_nan_edges_are_masked_and_counted(chain4, fitted):
    X, F = chain4.X.copy(), chain4.F.copy()
    X[:30, 2], X[-40:, 7], F[:50, 1] = np.nan, np.nan, np.nan
    model = NRFRegressor(degree=3).fit(X, F)
    same(model, fitted, 1e-10)
    assert model.n_samples_ == len(X) - 90
    predicted = model.predict(X)
    assert (
        np.isnan(predicted[:30]).all()
        and np.isnan(predicted[-40:]).all()
        and np.isfinite(predicted[30:-40]).all()
    )


def test_a_sensor_that_fell_out_is_no_edge_of_a_filter(chain4):
    X = chain4.X.copy()
    X[700:, 5] = np.nan
    with pytest.warns(
        DataQualityWarning,
        match=rf"leave 700 of {len(X)} rows; channel v2 is measured in 700",
    ):
        model = NRFRegressor(degree=3).fit(X, chain4.F)
    assert np.array_equal(
        model.masses_,
        NRFRegressor(degree=3).fit(chain4.X[:700], chain4.F[:700]).masses_,
    )


def test_nan_edges_inside_stacked_records(chain4, fitted):
    X, F = np.vstack([chain4.X, chain4.X]), np.vstack([chain4.F, chain4.F])
    n = len(chain4.X)
    X[n - 20 : n + 20] = np.nan
    same(
        NRFRegressor(degree=3).fit(X, F, record=np.repeat(["a", "b"], n)), fitted, 1e-10
    )


# -- orders and laws -----------------------------------------------------------


def test_orders_by_storey(chain4):
    model = NRFRegressor(degree=1, orders={"storey 2": 5, 3: (2, 1), 4: 3, 1: 3})
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        with pytest.raises(ChainError, match="contradicts"):
            model.fit(chain4.X, chain4.F)
        R = (
            NRFRegressor(orders={"storey 2": 5, 3: (2, 1)})
            .fit(chain4.X, chain4.F)
            .restoring_forces_
        )
    assert [len(R[i].coefficients) for i in range(1, 5)] == [9, 20, 5, 9]
    assert list(R[3].coefficients.index) == ["v", "s", "v^2", "v s", "v^2 s"]


def test_laws_replace_the_series_where_they_are_named(chain4):
    held = {i: [laws.LinearViscous(), laws.Duffing()] for i in range(1, 5)}
    model = NRFRegressor(laws=held).fit(chain4.X, chain4.F)
    assert worst(model.masses_, chain4.m) < 1e-10
    assert list(model.restoring_forces_[2].coefficients.index) == ["v", "s", "s^3"]
    assert (
        NRFRegressor(laws={2: held[2]})
        .fit(chain4.X, chain4.F)
        .restoring_forces_[1]
        .coefficients.size
        == 9
    )


def test_a_law_on_one_dof_is_found_there():
    """A shaker's added mass and a constant force, in the balance of DOF 2 alone; mass 2
    is known without the load.
    """
    case = chains.duffing(3, [1, 2, 3], seed=4)
    F = case.F.copy()
    F[:, 1] += 3.0 * case.a[:, 1] - 20.0
    model = NRFRegressor(
        known_masses={2: case.m[1]},
        laws={"dof 2": [laws.AddedMass(), laws.ConstantForce()]},
    )
    R = model.fit(case.X, F).restoring_forces_["dof 2"].coefficients
    assert R.tolist() == pytest.approx([3.0, -20.0], rel=1e-7)


def test_an_added_mass_that_leaves_nothing_is_named():
    """The known mass of DOF 2 is right; its force was read with 1.5 times its inertia
    taken off.
    """
    case = chains.duffing(2, [1, 2], seed=4)
    F = case.F.copy()
    F[:, 1] -= 1.5 * case.m[1] * case.a[:, 1]
    model = NRFRegressor(known_masses={2: case.m[1]}, laws={"dof 2": laws.AddedMass()})
    with pytest.warns(
        BiasWarning,
        match=f"DOF 2 has {case.m[1]:.4g} kg and {-1.5 * case.m[1]:.4g} kg added to it",
    ):
        model.fit(case.X, F)
    assert model.model_.total_masses == pytest.approx(
        [case.m[0], -0.5 * case.m[1]], rel=1e-6
    )


# -- output --------------------------------------------------------------------


def test_predict_and_restoring_force(chain4, fitted):
    assert np.allclose(fitted.predict(chain4.X), chain4.F, atol=1e-7)
    assert np.allclose(
        fitted.restoring_force(chain4.X), chain4.storey_forces, rtol=1e-8, atol=1e-8
    )
    one = fitted.predict(chain4.X[[100]])
    assert np.allclose(one, chain4.F[[100]], atol=1e-7)


def test_score_judges_accelerations(chain4, fitted):
    """R^2 of the predicted accelerations, pooled; against the same thing written
    out.
    """
    rng = np.random.default_rng(0)
    X = chain4.X + 0.05 * chain4.X.std(axis=0) * rng.standard_normal(chain4.X.shape)
    force = fitted.restoring_force(X)
    a_hat = (
        chain4.F - force + np.hstack([force[:, 1:], np.zeros((len(X), 1))])
    ) / fitted.masses_
    a = X[:, :4]
    expected = 1 - ((a - a_hat) ** 2).sum() / ((a - a.mean(axis=0)) ** 2).sum()
    assert fitted.score(X, chain4.F) == pytest.approx(expected, rel=1e-10)
    assert fitted.score(chain4.X, chain4.F) == pytest.approx(1.0, abs=1e-12)


def test_score_leaves_out_balances_whose_force_is_unknown(chain4, fitted):
    F = chain4.F.copy()
    F[:, 2] = np.nan
    assert fitted.score(chain4.X, F) == pytest.approx(1.0, abs=1e-12)


def test_errors_are_on_the_one_ruler(chain4):
    """100 rms(e) / rms(F) on the forced DOF, / rms(m a) elsewhere; pooled over storey
    forces.
    """
    rng = np.random.default_rng(0)
    X = chain4.X + 0.03 * chain4.X.std(axis=0) * rng.standard_normal(chain4.X.shape)
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        model = NRFRegressor(degree=3).fit(X, chain4.F)
    rms = lambda y: np.sqrt(np.mean(y**2, axis=0))  # noqa: E731
    e = rms(model.predict(X) - chain4.F)
    reference = np.where(
        [False, False, True, False], rms(chain4.F), rms(X[:, :4] * model.masses_)
    )
    R = rms(model.restoring_force(X))
    found = model.errors_["error"]
    assert found[[f"dof {j}" for j in range(1, 5)]].to_numpy() == pytest.approx(
        100 * e / reference, rel=1e-9
    )
    assert found["pooled"] == pytest.approx(
        100 * np.sqrt(((e / R) ** 2).sum() / ((reference / R) ** 2).sum()), rel=1e-9
    )
    assert list(model.errors_["of"][:4]) == ["m a", "m a", "F", "m a"]
    pd.testing.assert_frame_equal(model.balance_errors(X, chain4.F), model.errors_)


def test_the_third_law_gap_is_the_difference_of_two_estimates(dahl):
    """R_2 from balance 2 and from balance 1, each by ordinary least squares, whatever
    is returned.
    """
    case, *_ = dahl
    model = NRFRegressor(degree=1)
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        model.fit(case.X, case.F)
    one = np.column_stack(
        [case.a[:, 0], case.v[:, 0], case.s[:, 0], -case.v[:, 1], -case.s[:, 1]]
    )
    two = np.column_stack([case.a[:, 1], case.v[:, 1], case.s[:, 1]])
    lower = np.linalg.lstsq(one / one.std(0), case.F[:, 0])[0] / one.std(0)
    upper = np.linalg.lstsq(two / two.std(0), case.F[:, 1])[0] / two.std(0)
    motion = np.column_stack([case.v[:, 1], case.s[:, 1]])
    expected = (
        100
        * np.linalg.norm(motion @ (upper[1:] - lower[3:]))
        / np.linalg.norm(motion @ upper[1:])
    )
    assert model.third_law_gap_["storey 2"] == pytest.approx(expected, rel=1e-6)
    model.set_params(strategy="complete").fit(case.X, case.F)
    assert model.restoring_forces_[2].coefficients.to_numpy() == pytest.approx(
        upper[1:], rel=1e-9
    )  # balance 2's own


def test_a_band_keeps_an_exact_model_exact_and_judges_inside(chain4, fitted):
    model = NRFRegressor(degree=3, band=(1.0, 80.0), dt=chain4.dt).fit(
        chain4.X, chain4.F
    )
    assert worst(model.masses_, chain4.m) < 1e-8
    rng = np.random.default_rng(0)
    hiss = rng.standard_normal(chain4.X.shape)
    hiss -= chains.np.apply_along_axis(
        lambda y: _low_pass(y, 150.0, chain4.dt), 0, hiss
    )
    X = chain4.X + 0.2 * chain4.X.std(axis=0) * hiss  # noise outside the band alone
    assert model.score(X, chain4.F) > 0.999 > fitted.score(X, chain4.F)
    assert model.balance_errors(X, chain4.F).loc["pooled", "error"] < 5


def _low_pass(y, edge, dt):
    spectrum = np.fft.rfft(y)
    spectrum[np.fft.rfftfreq(len(y), dt) > edge] = 0
    return np.fft.irfft(spectrum, len(y))


# -- a scikit-learn estimator --------------------------------------------------


def test_a_fitted_model_survives_pickling(chain4, fitted):
    again = pickle.loads(pickle.dumps(fitted))
    assert np.array_equal(again.predict(chain4.X), fitted.predict(chain4.X))
    assert again.restoring_forces_["storey 2"](0.1, 1e-4) == fitted.restoring_forces_[
        "storey 2"
    ](0.1, 1e-4)
    pd.testing.assert_series_equal(again.condition_, fitted.condition_)


def test_forces_may_be_numbered_and_few_rows_are_enough(chain2):
    """Columns 0, 1 of a table of forces are F1, F2; seven rows are too few to call
    shuffled.
    """
    whole = NRFRegressor().fit(chain2.X, chain2.F)
    numbered = NRFRegressor().fit(chain2.X, pd.DataFrame(chain2.F))
    np.testing.assert_array_equal(numbered.masses_, whole.masses_)
    single = chains.duffing(1, [1], seed=1, n_samples=400, cubic=False)
    with warnings.catch_warnings(action="ignore"):
        few = NRFRegressor(degree=1).fit(single.X[200:207], single.F[200:207])
    assert few.masses_ == pytest.approx(single.m, rel=1e-6)
    with pytest.raises(ValueError, match="0 rows|no samples|0 sample"):
        whole.predict(np.zeros((0, 6)))


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_a_band_leaves_an_unknown_force_unknown():
    """Floor 2 has an unknown force: the balance of floor 1 alone, in the band, gives
    m1.
    """
    truth = ChainModel(
        [8.0, 6.0], {f"storey {i}": [laws.PowerSeries(1, [30.0, 4e4])] for i in (1, 2)}
    )
    F = excitation.band_limited_random(
        2, 8.0, 500.0, excited=[1, 2], rms=60.0, band=(1, 40), random_state=0
    )
    X, _ = simulate(truth, F, 1 / 500).to_features(smooth=False)
    model = NRFRegressor(degree=1, dt=1 / 500, band=(3, 60), known_masses={2: 6.0})
    assert model.fit(X.to_numpy(), F * [1.0, np.nan]).masses_[0] == pytest.approx(
        8.0, rel=1e-3
    )


def test_weights_of_another_number_of_samples_are_refused(chain4, fitted):
    with pytest.raises(ChannelError, match="sample_weight has 5 values"):
        fitted.score(chain4.X, chain4.F, sample_weight=np.ones(5))


def test_half_a_base_is_refused(chain2):
    names = feature_names(2, "absolute")
    frame = pd.DataFrame(
        np.hstack([chain2.X, 0 * chain2.X[:, :1]]), columns=[*names, "x0"]
    )
    with pytest.raises(ChannelError, match="only one of the columns xdot0 and x0"):
        NRFRegressor(coordinates="absolute").fit(frame, chain2.F)
