"""What is said of a fit stays right in the corners: two laws alike, a band, other records, a storey that is not there."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import Chain, ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.diagnostics.delays import force_delay
from pysindy_nrf.estimation import model_agreement
from pysindy_nrf.estimation.constraints import TotalMass, _nearest, _with_parameters
from pysindy_nrf.estimation.intervals import parameters_of
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.monitoring import compare_tests
from pysindy_nrf.output.cli.outcome import coefficients
from pysindy_nrf.output.displays import FreeRunDisplay
from pysindy_nrf.output.report.content import _data
from pysindy_nrf.regression.layout import LawLayout, distinct_labels
from pysindy_nrf.selection import BlockEnsemble, select_sparsity
from pysindy_nrf.signals.alignment import align, channel_alignment
from pysindy_nrf.signals.zero_phase_filter import FairFilter
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
LINEAR = laws.PowerSeries(1, [60.0, 4e4])
TWINS = [laws.PowerSeries(1, [30.0, 4e4]), laws.Dahl(sigma=3e4, Fd=4.0), laws.Dahl(sigma=2e3, Fd=12.0)]


def forced(model, seconds=4.0, fs=500.0, seed=0, **options):
    n = model.n_dof
    F = excitation.band_limited_random(
        n, seconds, fs, dofs=range(1, n + 1), rms=50.0, band=(1, 60), random_state=seed, **options
    )
    return simulate(model, F, 1 / fs)


@pytest.fixture(scope="module")
def three():
    """Three linear storeys with noise in every channel."""
    truth = ChainModel([10.0, 12.0, 8.0], {i: LINEAR for i in (1, 2, 3)})
    return add_noise(forced(truth, 6.0, seed=3), 0.02, random_state=1).to_features()


def test_two_laws_of_one_family_keep_their_own_coefficients():
    model = ChainModel([10.0], {1: TWINS})
    own = model.restoring_forces[1].coefficients
    assert own.to_dict() == {"v": 30.0, "s": 4e4, "Z (dahl 1)": 4.0, "Z (dahl 2)": 12.0}
    assert LawLayout(model.chain, model.laws).labels("storey 1") == own.index.tolist()
    named = parameters_of(model)
    assert named.tolist() == [10.0, 30.0, 4e4, 4.0, 12.0]
    assert _with_parameters(model, named) == model
    assert coefficients(model)["unit"].tolist() == ["N s/m", "N/m", "N", "N"]


def test_names_change_only_where_two_would_be_equal():
    other = laws.CovariateDahl()
    assert distinct_labels(TWINS[:2]) == ["v", "s", "Z"]
    assert distinct_labels([laws.Dahl(), other])[:2] == ["Z (dahl)", f"Z ({other.name})"]
    assert distinct_labels([laws.Dahl(), other, laws.Dahl()])[:2] == ["Z (dahl 1)", f"Z ({other.name})"]


def absolute(model, **left_out):
    """The same motion relative to the base, and absolute."""
    t = np.arange(4000) * 1e-3
    ag = 3 * np.sin(19 * t) * np.sin(2.5 * t) + 2 * np.sin(46 * t + 1) * np.sin(5.6 * t)
    vg = np.r_[0, np.cumsum(0.5 * (ag[1:] + ag[:-1])) * 1e-3]
    xg = np.r_[0, np.cumsum(0.5 * (vg[1:] + vg[:-1])) * 1e-3]
    own = simulate(model, np.zeros((4000, 2)), 1e-3, base_acceleration=ag)
    given = dict(
        acceleration=own.acceleration, velocity=own.velocity + vg[:, None], displacement=own.displacement + xg[:, None],
        base_acceleration=ag, base_velocity=vg, base_displacement=xg, fs=1000.0, coordinates="absolute",
    )  # fmt: skip
    return Record(**(given | left_out))


@pytest.mark.parametrize("left_out", ["", "base_velocity", "base_acceleration"])
def test_a_free_run_over_absolute_displacements_is_that_of_the_true_model(left_out):
    model = ChainModel([10.0, 12.0], {1: LINEAR, 2: LINEAR})
    record = absolute(model, **({left_out: None} if left_out else {}))
    assert FreeRunDisplay.from_estimator(model, record).error.max() < 0.1


def test_a_free_run_takes_the_covariates_of_the_record():
    law = laws.CovariateFriction()
    law = law.with_values(coefficients=np.ones(len(law.terms())))
    model = ChainModel([10.0], {1: [LINEAR, law]})
    F = excitation.band_limited_random(1, 2.0, 500.0, dofs=1, rms=50.0, band=(1, 60), random_state=0)
    record = simulate(model, F, 2e-3, covariates={"voltage": 1 + np.sin(0.01 * np.arange(len(F)))})
    assert FreeRunDisplay.from_estimator(model, record).error.max() < 1e-9


@pytest.mark.parametrize("band", [(None, 30.0), (1.0, 60.0), None])
def test_the_noise_that_a_filter_passes_is_the_energy_of_its_impulse_response(band):
    filter = FairFilter(band, 500.0)
    impulse = np.zeros(20001)
    impulse[10000] = 1.0
    assert filter.noise_gain() == pytest.approx((filter.apply(impulse) ** 2).sum(), rel=1e-3)


@pytest.mark.parametrize("band", [None, (1.0, 30.0)])
def test_the_bias_that_is_said_is_the_bias_that_is_there(band):
    masses = np.array([10.0, 12.0, 8.0])
    X, F = forced(ChainModel(masses, {i: LINEAR for i in (1, 2, 3)}), 8.0, seed=3).to_features(smooth=False)
    X = X + 0.1 * X.std().to_numpy() * np.random.default_rng(0).standard_normal(X.shape)
    model = NRFRegressor(degree=1, dt=2e-3, band=band).fit(X, F)
    found = model.diagnose().table.query("limit == 'noise'").set_index("where")["size"]
    low = 1 - model.masses_ / masses
    np.testing.assert_allclose(found.reindex(["m1", "m2", "m3"]), low, atol=0.015)


def test_an_incoherent_channel_is_left_as_it_is():
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 500
    x = sum(np.sin(w * t + w**2) / w**2 for w in np.arange(9.0, 120.0, 1.3))
    record = Record(acceleration=np.gradient(np.gradient(x, t), t), displacement=rng.normal(size=4000), fs=500.0)
    found = channel_alignment(record)
    assert found["sign"].isna().any()
    np.testing.assert_array_equal(align(record, found).displacement, record.displacement)


def test_one_delay_is_told_from_records_of_different_rates():
    model = ChainModel([10.0], {1: laws.PowerSeries(1, [60.0, 1e5])})
    late = []
    for fs in (500.0, 1000.0):
        record = forced(model, 8.0, fs)
        late.append(add_noise(record.replace(force=np.roll(record.force, round(0.004 * fs), axis=0)), 0.01, 0))
    for given in (late, late[::-1]):
        row = force_delay(NRFRegressor(degree=1).fit(given)).loc["F1"]
        assert row["delay"] == pytest.approx(0.004, abs=5e-5)
        assert row["samples"] == pytest.approx(0.004 * given[0].fs, abs=0.05)


def test_a_page_shows_the_records_and_the_band_that_are_given():
    truth = ChainModel([10.0, 12.0], {1: LINEAR, 2: LINEAR})
    mine, other = (forced(truth, 2.0, seed=seed) for seed in (0, 1))
    model = NRFRegressor(degree=1, band=(1.0, 100.0)).fit(mine)
    data, filters = _data(model, [other], (5.0, 20.0))
    np.testing.assert_array_equal(data.segments[0].F, other.force)
    assert filters[0].band == (5.0, 20.0)
    for given in (None, [mine]):
        assert _data(model, given, (5.0, 20.0))[1][0].band == (5.0, 20.0)
        assert _data(model, given, (1.0, 100.0))[1][0].band == (1.0, 100.0)


def test_records_without_any_force_are_told_apart_by_the_motion_of_the_base():
    truth = ChainModel([10.0, 12.0], {1: LINEAR, 2: LINEAR})
    mine, other = absolute(truth), absolute(truth).replace(name="other")
    model = NRFRegressor(degree=1, known_masses={1: 10.0, 2: 12.0}).fit(mine)
    assert _data(model, [other], None)[0] is _data(model, None, None)[0]
    other = other.replace(base_acceleration=2 * other.base_acceleration)
    assert _data(model, [other], None)[0] is not _data(model, None, None)[0]


def test_orders_that_were_thinned_out_stand_in_the_laws(three):
    ps = pytest.importorskip("pysindy")
    paths = {"ensemble": [BlockEnsemble(ps.STLSQ(threshold=0.02), n_models=3)]}
    regressor = select_sparsity(*three, degree=1, orders={2: 3}, paths=paths, prune=False).regressor()
    assert regressor.fit(*three).masses_ == pytest.approx([10.0, 12.0, 8.0], rel=0.02)


def test_a_free_chain_is_compared_where_it_has_storeys():
    chain = Chain(2, ground="free")
    truth = ChainModel([10.0, 12.0], {"storey 2": LINEAR}, chain)
    damaged = ChainModel([10.0, 12.0], {"storey 2": laws.PowerSeries(1, [60.0, 3.6e4])}, chain)
    before, after = (forced(m, seed=i).to_features(smooth=False) for i, m in enumerate((truth, damaged)))
    report = compare_tests(NRFRegressor(degree=1, chain=chain, dt=2e-3), before, after)
    assert report.damaged == ["storey 2"]
    table = report.table.set_index(["storey", "term"])
    assert table.loc[("storey 2", "k"), "change"] == pytest.approx(-10.0, abs=0.01)
    assert table.loc["storey 1", ["before", "after", "change", "p"]].isna().all(axis=None)
    agreement = model_agreement(truth, damaged, before[0])
    assert agreement.loc["storey 2", "k"] == pytest.approx(-10.0)
    assert agreement.loc["storey 1", ["k", "c"]].isna().all()


def test_a_total_of_known_masses_is_checked_and_not_solved(three):
    known = {1: 10.0, 2: 12.0, 3: 8.0}
    fit = NRFRegressor(degree=1, known_masses=known, constraints=TotalMass(30.0)).fit
    assert fit(*three).masses_.tolist() == [10.0, 12.0, 8.0]
    with pytest.raises(ChainError, match="known masses are 1 kg away"):
        NRFRegressor(degree=1, known_masses=known, constraints=TotalMass(31.0)).fit(*three)


def test_bounds_give_way_to_one_another_and_only_true_contradictions_are_refused():
    both = np.array([True, True])
    P = np.array([[0.809, 1.215], [1.215, 2.538]])
    found = _nearest(np.array([-1.201, -1.282]), P, np.array([[1.0, -1.0]]), np.array([0.5]), both)
    np.testing.assert_allclose(found, [0.5, 0.0], atol=1e-12)
    with pytest.raises(ChainError, match="contradict each other"):
        _nearest(np.array([1.0, 2.0]), P, np.array([[1.0, 1.0]]), np.array([-0.5]), both)


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_point_fulfils_the_conditions_of_optimality(seed):
    """With multipliers of the equations free and those of the bounds not negative (Karush, Kuhn and Tucker)."""
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    L = rng.normal(size=(n, n))
    P = L @ L.T + 0.1 * np.eye(n)
    A = np.round(rng.normal(size=(1, n))) + np.eye(1, n) * 3
    b = A @ np.where(rng.random(n) < 0.6, rng.random(n), 0.0)  # a point that obeys everything
    start = rng.normal(size=n) - 1.0
    x = _nearest(start, P, A, b, np.ones(n, dtype=bool))
    assert x.min() > -1e-8
    np.testing.assert_allclose(A @ x, b, atol=1e-6)
    sides = np.vstack([A, np.eye(n)[x < 1e-7]])
    low = np.r_[-np.inf, np.zeros(len(sides) - 1)]
    slope = np.linalg.solve(P, x - start)
    left = lsq_linear(sides.T, slope, bounds=(low, np.inf)).fun
    assert np.abs(left).max() < 1e-5 * max(1.0, np.abs(slope).max())


def test_probabilities_that_do_not_exist_do_not_count_in_the_correction():
    from pysindy_nrf.monitoring.change import _holm

    found = _holm(np.array([0.02, np.nan, 0.01]))
    np.testing.assert_allclose(found, [0.02, np.nan, 0.02])
    assert pd.isna(found[1])


def test_a_change_is_dated_in_a_chain_that_stands_on_nothing():
    """A free chain has no storey 1; storey 2 loses a fifth of its stiffness after 6 s."""
    from pysindy_nrf.monitoring import find_onset, track

    free = Chain(3, ground="free")
    damaged = laws.StiffnessStep(t0=6.0, dk=-8e3)
    truth = ChainModel(
        [10.0, 12.0, 8.0], {2: [laws.PowerSeries(1, [30.0, 4e4]), damaged], 3: [laws.PowerSeries(1, [30.0, 4e4])]}, free
    )
    F = excitation.band_limited_random(3, 12.0, 500.0, dofs=[1, 2, 3], rms=50.0, band=(1, 60), random_state=0)
    X, F = simulate(truth, F - F.mean(axis=0), 2e-3).to_features(smooth=False)
    model = NRFRegressor(degree=1, dt=2e-3, chain=free).fit(X, F)
    onset = find_onset(model, X, F)
    assert onset.storey == "storey 2" and onset.time == pytest.approx(6.0, abs=1.0)
    assert onset.change == pytest.approx(-20.0, abs=5.0)
    assert track(model, X, F)["k1"].isna().all() and track(model, X, F)["k2"].notna().all()
