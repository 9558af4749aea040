"""What one does with an identified chain."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, datasets, excitation, laws, simulate
from pysindy_nrf.diagnostics import missing_terms
from pysindy_nrf.estimation import (
    damper_force,
    dissipated_energy,
    energy_shares,
    found_twice,
    horizontal_component,
    linear_part,
    linear_twin,
    locate_nonlinearity,
    model_agreement,
    planarity,
    total_mass,
)
from pysindy_nrf.exceptions import BiasWarning, ChainError, ChannelError, DataQualityWarning
from pysindy_nrf.monitoring import compare_tests, find_onset, track
from pysindy_nrf.regression.errors import nrmse
from pysindy_nrf.selection.comparison import compare
from pysindy_nrf.simulation import free_run
from pysindy_nrf.simulation.excitation import band_limited_random
from pysindy_nrf.simulation.noise import add_noise

FS = 500.0
STOREY = laws.PowerSeries(1, [60.0, 5e4])


def chain(*extra, n=3):
    """Masses of 10 kg on linear storeys; extra laws as (storey, law)."""
    held = {i: [STOREY] for i in range(1, n + 1)}
    for storey, law in extra:
        held[storey].append(law)
    return ChainModel([10.0] * n, {f"storey {i}": group for i, group in held.items()})


def run(model, dofs, rms=100.0, duration=16.0, seed=0):
    F = band_limited_random(model.n_dof, duration, FS, dofs=dofs, rms=rms, band=(0.5, 40), random_state=seed)
    return free_run(model, F, 1 / FS)


def features(result):
    return result.record.to_features(smooth=False)


def noisy(result, level, seed=0):
    return add_noise(result.record, level, random_state=seed).to_features()


# -- forces and energies ----------------------------------------------------------------------


def test_damper_force_is_what_the_bare_structure_lacks():
    cubic = laws.CubicStiffness(2e8)
    result = run(chain((2, cubic)), [3])
    X, F = features(result)
    found = damper_force(NRFRegressor(degree=3).fit(X, F), chain(), X)
    assert np.allclose(found["storey 2"], 2e8 * X["s2"] ** 3, atol=1e-3)
    assert found[["storey 1", "storey 3"]].abs().max(axis=None) < 1e-3
    assert found.index.name == "t"


def test_dissipated_energy_balances_the_work_of_the_force():
    result = run(chain(), [1, 2, 3])
    X, _ = features(result)
    lost = dissipated_energy(chain(), X).to_numpy()[-1].sum()
    record = result.record
    kinetic = 0.5 * 10.0 * (record.velocity[-1] ** 2).sum()
    stored = 0.5 * 5e4 * (X[["s1", "s2", "s3"]].to_numpy()[-1] ** 2).sum()
    assert lost == pytest.approx(result.energy["input"].iloc[-1] - kinetic - stored, rel=1e-3)


def test_energy_shares_do_not_depend_on_the_level_but_on_the_damage():
    shares = []
    for rms, extra in ((50.0, ()), (200.0, ()), (50.0, ((2, laws.LinearViscous(120.0)),))):
        X, F = features(run(chain(*extra), [3], rms))
        shares.append(energy_shares(NRFRegressor(degree=1).fit(X, F), X)["share"])
    assert shares[1].to_numpy() == pytest.approx(shares[0].to_numpy(), rel=1e-6)
    assert (shares[2] - shares[0]).idxmax() == "storey 2"
    assert shares[2].sum() == pytest.approx(100.0)


def test_linear_twin_keeps_every_other_setting():
    twin = linear_twin(NRFRegressor(degree=3, orders={"storey 1": 5}, known_masses={1: 10.0}, band=(1, 30)))
    assert twin.degree == 1 and twin.orders is None and twin.known_masses == {1: 10.0} and twin.band == (1, 30)


def test_linear_part_is_the_tangent_at_rest():
    part = linear_part(chain((1, laws.CubicStiffness(1e9)), (2, laws.LinearElastic(1e3))))
    assert part.restoring_forces[1].linear_part().to_dict() == {"c": 60.0, "k": 5e4}
    assert part.restoring_forces[2].linear_part()["k"] == 5.1e4


def test_diagonal_load_cell():
    assert horizontal_component([100.0], rise=1.0, run=1.0)[0] == pytest.approx(100 / np.sqrt(2))
    with pytest.raises(ChannelError, match="no horizontal"):
        horizontal_component([1.0], rise=0.3, run=0.0)


# -- planarity and location -------------------------------------------------------------------


def test_large_cubic_coefficients_at_small_drifts_are_planar():
    # the paper's "linear" storeys carry 1e9 N/m^3
    X, F = features(run(chain((2, laws.CubicStiffness(1e9))), [1, 2, 3], rms=0.5))
    table = planarity(NRFRegressor(degree=3).fit(X, F), X, F, draws=0)
    assert table["planar"].all() and table["reference"].isna().all()


def test_noise_reference_covers_what_noise_does_to_a_planar_storey():
    inside = []
    for seed in range(3):
        X, F = noisy(run(chain(), [3], seed=seed), 0.1, seed)
        table = planarity(NRFRegressor(degree=3).fit(X, F), X, F, draws=10, random_state=0)
        inside.append((table["index"] < 2 * table["reference"]).to_numpy())
        assert (table["reference"] > 0.05).all()  # it is not nothing
    assert np.mean(inside) > 0.7


@pytest.mark.parametrize("storey", [1, 2, 3])
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
def test_damper_located_wherever_it_sits(storey, dofs):
    X, F = features(run(chain((storey, laws.Dahl(sigma=2e4, Fd=25.0))), dofs))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BiasWarning)
        model = NRFRegressor(degree=3).fit(X, F)
        location = locate_nonlinearity(model, X, F, draws=4, random_state=0)
    assert location.storeys == [f"storey {storey}"]
    assert location.estimator.masses_ == pytest.approx([10.0] * 3, rel=1e-3)
    assert str(location).startswith(f"The nonlinearity is in storey {storey};")


def test_linear_chain_has_no_nonlinear_storey():
    X, F = noisy(run(chain(), [3]), 0.02)
    location = locate_nonlinearity(NRFRegressor(degree=3).fit(X, F), X, F, draws=4, random_state=0)
    assert location.storeys == [] and str(location) == "Every storey is planar."


# -- the bias warning -------------------------------------------------------------------------

MISSING = {
    "friction": laws.CoulombFriction(25.0),
    "hysteresis": laws.Dahl(sigma=2e3, Fd=40.0),
    "gap": laws.TwoSidedGap(gap=2e-3, k=5e4),
    "quadratic damping": laws.QuadraticDamping(400.0),
}


@pytest.mark.parametrize("name", MISSING)
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3]])
def test_missing_law_is_warned_of(name, dofs):
    X, F = features(run(chain((1, MISSING[name])), dofs))
    with pytest.warns(BiasWarning, match="Balance of DOF 1"):
        NRFRegressor(degree=1).fit(X, F)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("dofs", [[1, 2, 3], [3], [1]])
@pytest.mark.parametrize("kind", ["linear", "cubic", "friction"])
def test_no_false_alarm_with_noise(noise, dofs, kind):
    law = {"linear": (), "cubic": ((2, laws.CubicStiffness(2e9)),), "friction": ((1, laws.CoulombFriction(25.0)),)}[
        kind
    ]
    known = {"storey 1": [laws.PowerSeries(1), laws.CoulombFriction()]} if kind == "friction" else None
    truth = chain(*law)
    result = run(truth, dofs, seed=int(100 * noise) + 1)
    X, F = noisy(result, noise, np.random.default_rng(0)) if noise else features(result)
    model = NRFRegressor(degree=3, laws=known).fit(X, F)
    if kind == "linear" or not noise:
        assert not model.missing_terms_["biased"].any(), model.missing_terms_
    elif model.missing_terms_["biased"].any():
        # noise that goes through a cube or a sign does bias; then the alarm is true
        exact, _ = features(result)
        forces = [nrmse(*pair) for pair in zip(truth.restoring_force(exact).T, model.restoring_force(exact).T)]
        friction = model.model_.laws["storey 1"][-1].coefficients[-1] if kind == "friction" else 25.0
        assert max(forces) > 2.0 or abs(friction / 25.0 - 1) > 0.1


def test_noise_in_unfused_channels_is_warned_of_too():
    noisy_record = add_noise(run(chain(), [3]).record, 0.05, random_state=0)
    X, F = noisy_record.to_features(smooth=False)
    with pytest.warns(BiasWarning, match="KinematicSmoother"):
        model = NRFRegressor(degree=1).fit(X, F)
    assert model.masses_.min() < 9.5  # and rightly: least squares is biased low


def test_missing_terms_in_a_band_and_on_memory_laws():
    X, F = features(run(chain((2, laws.Dahl(sigma=2e4, Fd=25.0))), [3]))
    with pytest.warns(BiasWarning):
        banded = NRFRegressor(degree=3, band=(1, 60)).fit(X, F)
    assert missing_terms(banded, X, F)["biased"].any()
    held = {"storey 2": [laws.PowerSeries(1), laws.Dahl(sigma=2e4)]}
    for band in (None, (1, 60)):
        assert not NRFRegressor(degree=1, laws=held, band=band).fit(X, F).missing_terms_["biased"].any()


# -- agreement --------------------------------------------------------------------------------


def test_model_agreement_in_percent():
    X, F = features(run(chain(), [3]))
    other = ChainModel(
        [10.0, 11.0, 10.0], {i: laws.PowerSeries(1, [60.0, 5e4 * (1.1 if i == 2 else 1)]) for i in (1, 2, 3)}
    )
    table = model_agreement(chain(), other, X)
    assert table["mass"].tolist() == pytest.approx([0, 10, 0])
    assert table["k"].tolist() == pytest.approx([0, 10, 0])
    assert table.loc["storey 1", "force"] == 0 and 8 < table.loc["storey 2", "force"] < 10.5


def test_found_twice_needs_complete_excitation():
    X, F = features(run(chain(), [1, 2, 3]))
    twice = found_twice(NRFRegressor(degree=1).fit(X, F), X, F)
    assert list(twice) == ["storey 2", "storey 3"]
    assert twice["storey 3"].loc["s"].to_list() == pytest.approx([5e4, 5e4])
    X, F = features(run(chain(), [3]))
    with pytest.raises(ChainError, match="twice"):
        found_twice(NRFRegressor(degree=1).fit(X, F), X, F)


# -- change -----------------------------------------------------------------------------------


def test_change_of_damping_and_stiffness_are_told_apart():
    before = noisy(run(chain(), [3], duration=30.0), 0.02, 1)
    after = noisy(run(chain((3, laws.LinearElastic(-4e3))), [3], duration=30.0, seed=5), 0.02, 2)
    report = compare_tests(NRFRegressor(degree=1), before, after)
    assert report.damaged == ["storey 3"]
    assert report.changed["change"].iloc[0] == pytest.approx(-8.0, abs=0.5)
    assert str(report).startswith("k of storey 3 changed by -")
    table = report.map(3, size=21)
    visited = table[table["visited"]]
    wrong = visited["change"] + 4e3 * visited["s"]
    assert np.abs(wrong).max() < 0.05 * np.abs(4e3 * visited["s"]).max()
    assert visited.loc[visited["s"].abs() > 0.5 * visited["s"].max(), "significant"].all()


def test_standard_errors_hold_what_they_promise():
    """Of repeated tests of an unchanged structure, few stiffnesses and dampings leave two standard errors."""
    z, p = [], []
    for seed in range(20, 32, 2):
        tests = [add_noise(run(chain(), [3], duration=12.0, seed=k).record, 0.05, random_state=k) for k in (seed, seed + 1)]
        table = compare_tests(NRFRegressor(degree=1), *tests).table
        z.append(table["change"] / table["error"])
        p.append(table["p"].min())
    assert (np.array(p) > 0.01).all()
    each = np.sqrt(np.mean(np.square(z), axis=0))  # of every term, over six pairs: 99.9 % lie within these for a true 1
    assert (0.25 < each).all() and (each < 1.95).all()


def test_motions_that_were_fused_together_are_said_to_look_too_alike():
    records = [add_noise(run(chain(), [3], duration=6.0, seed=k).record, 0.05, random_state=k) for k in (1, 2)]
    with pytest.warns(DataQualityWarning, match="fused so that the DOFs improve each other"):
        compare_tests(NRFRegressor(degree=1), *[r.to_features() for r in records])
    fitted = NRFRegressor(degree=1).fit(*records[0].to_features())
    with pytest.warns(DataQualityWarning, match="up to three times too narrow"):
        narrow = fitted.confidence_intervals()
    honest = NRFRegressor(degree=1).fit(records[0]).confidence_intervals()
    assert np.allclose(narrow["estimate"], honest["estimate"], rtol=1e-12)
    width = [(t["upper"] - t["lower"]).to_numpy() for t in (narrow, honest)]
    assert (width[1] > width[0]).all() and np.median(width[1] / width[0]) > 1.2


def test_compare_needs_blocks():
    with pytest.raises(ChainError, match="standard error"):
        compare_tests(NRFRegressor(degree=1), None, None, n_blocks=3)


# -- parameters that vary with time -----------------------------------------------------------


def test_track_follows_a_drifting_stiffness():
    X, F = features(run(chain((2, laws.StiffnessDrift(-250.0))), [3], duration=20.0))
    known = dict.fromkeys((1, 2, 3), 10.0)
    table = track(NRFRegressor(degree=1, known_masses=known).fit(X, F), X, F, window=1.0, masses=known)
    assert np.allclose(table["k2"], 5e4 - 250.0 * table["t"], rtol=3e-3)
    assert table["k1"].to_numpy() == pytest.approx(5e4, rel=3e-3)
    assert np.diff(table["t"]) == pytest.approx(0.25)


def test_window_of_block_moments_is_the_fit_of_its_samples():
    X, F = features(run(chain((2, laws.StiffnessDrift(-250.0))), [1, 2, 3], duration=10.0))
    model = NRFRegressor(degree=1).fit(X, F)
    row = track(model, X, F, window=2.0, step=0.5, masses=None).iloc[3]
    part = slice(int(1.5 * FS), int(3.5 * FS))
    own = NRFRegressor(degree=1).fit(X.iloc[part], F.iloc[part])
    for i in (1, 2, 3):
        assert row[f"k{i}"] == pytest.approx(own.restoring_forces_[i].linear_part()["k"], rel=1e-9)


@pytest.mark.parametrize("storey", [1, 3])
def test_onset_of_a_sudden_loss(storey):
    X, F = noisy(run(chain((storey, laws.StiffnessStep(t0=7.3, dk=-4e3))), [3], duration=20.0), 0.02)
    onset = find_onset(NRFRegressor(degree=1).fit(X, F), X, F)
    assert onset.storey == f"storey {storey}"
    assert onset.time == pytest.approx(7.3, abs=0.25) and onset.change == pytest.approx(-8.0, abs=1.0)


def test_no_onset_where_nothing_happened():
    for seed in range(4):
        X, F = noisy(run(chain(), [3], duration=20.0, seed=seed), 0.02, seed)
        onset = find_onset(NRFRegressor(degree=1).fit(X, F), X, F)
        assert onset.storey is None and np.isnan(onset.time) and "No change" in str(onset)


def test_onset_is_looked_for_in_one_record():
    X, F = features(run(chain(), [3], duration=8.0))
    both, ids = pd.concat([X, X]), np.repeat([0, 1], len(X))
    model = NRFRegressor(degree=1).fit(X, F)
    with pytest.raises(ChainError, match="one record"):
        find_onset(model, both, pd.concat([F, F]), record=ids)
    with pytest.raises(ChainError, match="too short"):
        find_onset(model, X, F, margin=5.0)


def test_a_missing_force_is_said_in_a_long_record_too():
    """Of 60,000 samples some thousand are judged. Of a friction in random motion a damper takes the share 2/pi."""
    rng = np.random.default_rng(0)
    v, s, a = (size * rng.standard_normal((60_000, 2)) for size in (0.1, 1e-3, 10.0))
    for friction in (0.0, 15.0):
        R = 80 * v + 1e5 * s + np.sign(v) * [friction, 0.0]  # at storey 1
        F = [10.0, 8.0] * a + R - np.column_stack([R[:, 1], np.zeros(len(R))])
        F += 0.005 * F.std(axis=0) * rng.standard_normal(F.shape)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = NRFRegressor(degree=1).fit(np.hstack([a, v, s]), F).missing_terms_
        assert found["biased"].to_dict() == {"balance of DOF 2": False, "balance of DOF 1": friction > 0}
        left = friction * np.sqrt(1 - 2 / np.pi) / F[:, 0].std()
        assert found.loc["balance of DOF 1", "missing"] == pytest.approx(100 * left, rel=0.05, abs=0.05)


def test_models_of_other_structures_are_not_compared(chain2, chain4):
    one, two = (NRFRegressor().fit(c.X, c.F) for c in (chain2, chain4))
    with pytest.raises(ChainError, match="have 2 and 4 DOFs"):
        model_agreement(one, two, chain2.X)
    with pytest.raises(ChainError, match="str is not a chain model"):
        total_mass({"first": "a model"})
    assert "gap" not in total_mass({"first": one})
    with pytest.raises(ChainError, match="data's own regressor"):
        locate_nonlinearity(one.model_, chain2.X, chain2.F)
    rec = datasets.load_demo()
    with pytest.raises(ChannelError, match="takes one contiguous record on a base at rest"):
        compare([rec, rec])


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("band", [None, (1.0, 30.0)])
def test_the_bias_that_is_said_is_the_bias_that_is_there(band):
    masses = np.array([10.0, 12.0, 8.0])
    truth = ChainModel(masses, {i: laws.PowerSeries(1, [60.0, 4e4]) for i in (1, 2, 3)})
    F = excitation.band_limited_random(3, 8.0, 500.0, dofs=[1, 2, 3], rms=50.0, band=(1, 60), random_state=3)
    X, F = simulate(truth, F, 2e-3).to_features(smooth=False)
    X = X + 0.1 * X.std().to_numpy() * np.random.default_rng(0).standard_normal(X.shape)
    model = NRFRegressor(degree=1, dt=2e-3, band=band).fit(X, F)
    found = model.diagnose().table.query("limit == 'noise'").set_index("where")["size"]
    low = 1 - model.masses_ / masses
    np.testing.assert_allclose(found.reindex(["m1", "m2", "m3"]), low, atol=0.015)
