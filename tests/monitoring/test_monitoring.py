"""Changes between two tests, parameters that vary with time, the onset of a change."""

import numpy as np
import pytest
from paper_cases import model_agreement
from three_floors import FS, chain, features, noisy, run

from pysindy_nrf import (
    Chain,
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import ChainError, ChannelError
from pysindy_nrf.monitoring import compare_tests, moving_windows
from pysindy_nrf.simulation import add_noise

MASS = 10.0
STIFFNESS = 5e4
DRIFT = -250.0  # of a stiffness, N/m/s
KNOWN = dict.fromkeys((1, 2, 3), MASS)
LINEAR = laws.PowerSeries(1, [60.0, 4e4])


def compared(before, after, **settings):
    """A comparison by declared linear storeys."""
    return compare_tests(NRFRegressor(degree=1, **settings), before, after)


def changed_terms(report):
    return report.changed[["place", "term"]].to_numpy().tolist()


# -- stiffness, damping, mass --------------------------------------------------


@pytest.fixture(scope="module")
def softened():
    """Storey 3 loses 8 % of its stiffness; 2 % noise."""
    weaker = chain((3, laws.LinearElastic(-4e3)))
    before = noisy(run(chain(), [3], duration=30.0), 0.02, 1)
    after = noisy(run(weaker, [3], duration=30.0, seed=5), 0.02, 2)
    return compared(before, after)


def test_a_loss_of_stiffness_is_found_in_its_storey(softened):
    assert softened.damaged == ["storey 3"]
    assert softened.changed["change"].iloc[0] == pytest.approx(-8.0, abs=0.5)
    assert str(softened).startswith("Stiffness of storey 3 changed by -")
    (change,) = softened.stiffness_changes
    assert change.storey == "storey 3"
    assert change.change == pytest.approx(-8.0, abs=0.5)


def test_the_map_of_a_loss_of_stiffness_is_a_plane(softened):
    table = softened.map(3, size=21)
    visited = table[table["visited"]]
    expected = -4e3 * visited["s"]
    assert np.abs(visited["change"] - expected).max() < 0.05 * expected.abs().max()

    drifts = visited["s"].abs()
    assert visited.loc[drifts > 0.5 * drifts.max(), "significant"].all()


@pytest.fixture(scope="module")
def stiffened():
    """A cubic spring in storey 2 that appears, with 30 % of the force of its spring."""
    before = run(chain(), [3], duration=12.0).record
    drift = np.diff(before.displacement, axis=1)[:, 0]
    k3 = 0.3 * STIFFNESS * drift.std() / (drift**3).std()
    cubic = chain((2, laws.CubicStiffness(k3)))
    after = run(cubic, [3], rms=80.0, duration=12.0, seed=5).record
    before = add_noise(before, 0.01, random_state=0)
    after = add_noise(after, 0.01, random_state=1)
    return k3, compared(before, after)


def test_a_cubic_spring_that_appears_is_a_change(stiffened):
    """In the declared linear law it is next to nothing."""
    _, report = stiffened
    assert report.damaged == ["storey 2"]
    assert changed_terms(report) == [["storey 2", "k3"]]
    assert str(report).startswith("Cubic spring of storey 2 changed by")


def test_the_map_shows_the_force_of_a_cubic_spring(stiffened):
    k3, report = stiffened
    table = report.map(2)
    visited = table[table["visited"]]
    expected = k3 * visited["s"] ** 3
    assert np.abs(visited["change"] - expected).max() < 0.1 * expected.abs().max()


def test_maps_of_other_storeys_show_nothing_significant(stiffened):
    _, report = stiffened
    assert not report.map(3)["significant"].any()
    assert not report.map(1)["significant"].any()


def test_added_mass_is_no_damage():
    heavy = ChainModel([10.0, 10.8, 10.0], chain().laws)
    before = run(chain(), [3], duration=12.0).record
    after = run(heavy, [1], duration=12.0, seed=4).record
    report = compared(before, after)
    assert changed_terms(report) == [["dof 2", "m"]]
    assert report.damaged == []
    assert report.changed["change"].iloc[0] == pytest.approx(8.0, abs=0.3)
    added = report.after.masses - report.before.masses
    assert added == pytest.approx([0.0, 0.8, 0.0], abs=0.03)


# -- rival explanations --------------------------------------------------------


MASSES = np.array([12.0, 9.0, 10.0, 8.0])
STIFFNESSES = np.array([8e4, 6e4, 7e4, 5e4])


def four_floors(stiffness=1.0, mass=1.0, damping=1.0):
    """Four unlike floors, all changed by factors."""
    storeys = {}
    for i, k in enumerate(STIFFNESSES * stiffness, 1):
        storeys[i] = [laws.LinearElastic(k), laws.LinearViscous(50.0 * damping)]
    return ChainModel(MASSES * mass, storeys)


def compared_floors(excited, noise=0.005, gain=1.0, **factors):
    """A comparison of four floors before and after a change."""
    tests = []
    for seed, model in enumerate((four_floors(), four_floors(**factors))):
        exact = run(model, excited, duration=24.0, seed=seed).record
        tests.append(add_noise(exact, noise, random_state=seed))
    before, after = tests
    misread = Record(
        force=gain * after.force,
        acceleration=after.acceleration,
        velocity=after.velocity,
        displacement=after.displacement,
        fs=FS,
    )
    return compared(before, misread)


@pytest.mark.parametrize("excited", [[1], [4], [1, 2, 3, 4]])
@pytest.mark.parametrize("loss", [0.03, 0.15])
def test_a_loss_in_all_storeys_is_no_added_mass(excited, loss):
    report = compared_floors(excited, stiffness=1 - loss)
    assert changed_terms(report) == [[f"storey {i}", "k"] for i in (1, 2, 3, 4)]
    assert report.damaged == [f"storey {i}" for i in (1, 2, 3, 4)]
    assert report.changed["change"].to_numpy() == pytest.approx(-100 * loss, abs=0.2)
    assert np.allclose(report.after.masses, report.before.masses)


def test_mass_added_to_all_floors_is_no_loss_of_stiffness():
    report = compared_floors([1, 2, 3, 4], mass=1.06)
    assert set(report.changed["term"]) == {"m"}
    assert report.damaged == []
    assert report.changed["change"].to_numpy() == pytest.approx(6.0, abs=0.2)


def test_another_gain_of_the_forces_is_no_change_of_the_structure():
    """Masses and stiffnesses that are fitted apart differ by 7 %."""
    report = compared_floors([4], gain=1.07)
    assert changed_terms(report) == [["all forces", "gain"]]
    assert report.damaged == []
    assert report.changed["change"].iloc[0] == pytest.approx(7.0, abs=0.3)
    stiffness = report.table[report.table["term"] == "k"]
    assert stiffness["change"].abs().max() < 0.5


def test_a_gain_that_two_tests_cannot_show_is_an_assumption():
    """Heavier and stiffer by one factor, it moves as under smaller forces."""
    report = compared_floors([4], stiffness=1.07, mass=1.07, damping=1.07)
    assert changed_terms(report) == [["all forces", "gain"]]
    assert report.changed["change"].iloc[0] == pytest.approx(7.0, abs=0.3)
    assert "Assumed" in str(report)


def test_explanations_that_leave_as_little_are_rivals():
    """At 4 % noise a loss of 2 % in all storeys may be mass on all floors."""
    report = compared_floors([1], noise=0.04, stiffness=0.98)
    assert report.damaged == [f"storey {i}" for i in (1, 2, 3, 4)]
    (rival,) = report.rivals
    assert set(rival["term"]) == {"m"}
    assert "As well explained by mass" in str(report)


# -- laws with a state ---------------------------------------------------------


def test_another_amplitude_of_a_damper_that_no_law_knows_is_no_change():
    damped = chain((3, laws.Dahl(sigma=5e4, Fd=20.0)))
    tests = []
    for seed, rms in enumerate((80, 160)):
        exact = run(damped, [3], rms=rms, duration=20.0, seed=seed).record
        tests.append(add_noise(exact, 0.01, random_state=seed))
    report = compared(*tests)
    assert report.changed.empty
    assert report.damaged == []
    assert "storey 3" in report.explained["storey"].tolist()
    assert "amplitude alone explains it" in str(report)


def test_a_law_with_a_state_is_compared_on_its_own_parameters():
    """The sliding force grows from 20 to 26 N."""
    declared = {"storey 2": [laws.PowerSeries(1), laws.Dahl()]}
    tests = []
    for seed, force in enumerate((20.0, 26.0)):
        damped = chain((2, laws.Dahl(sigma=2e4, Fd=force)))
        tests.append(run(damped, [3], duration=12.0, seed=seed).record)
    report = compared(*tests, laws=declared)
    assert report.damaged == ["storey 2"]
    assert report.changed["term"].iloc[0].startswith("own Fd")

    change = report.table.set_index(["storey", "term"]).loc["storey 2", "change"]
    assert change["Fd"] == pytest.approx(30.0, abs=0.5)
    assert change["sigma"] == pytest.approx(0.0, abs=3.0)


# -- standard errors -----------------------------------------------------------


@pytest.mark.slow
def test_standard_errors_hold_what_they_promise():
    """Of repeated tests of an unchanged structure."""
    z = []
    p = []
    for seed in range(20, 32, 2):
        tests = []
        for number in (seed, seed + 1):
            exact = run(chain(), [3], duration=12.0, seed=number).record
            tests.append(add_noise(exact, 0.05, random_state=number))
        table = compared(*tests).table
        z.append(table["change"] / table["error"])
        p.append(table["p"].min())

    assert min(p) > 0.01
    # of every term, over six pairs: 99.9 % lie within these for a true 1
    each = np.sqrt(np.mean(np.square(z), axis=0))
    assert each.min() > 0.25
    assert each.max() < 1.95


# -- within a record -----------------------------------------------------------


@pytest.fixture(scope="module")
def drifting():
    """Motions and forces of a chain whose storey 2 loses stiffness in time."""
    return features(run(chain((2, laws.StiffnessDrift(DRIFT))), [3], duration=20.0))


def test_windows_follow_a_drifting_stiffness(drifting):
    fitted = NRFRegressor(degree=1, known_masses=KNOWN).fit(*drifting)
    table = moving_windows(fitted, *drifting, window=1.0, masses=KNOWN)
    assert np.allclose(table["k2"], STIFFNESS + DRIFT * table["t"], rtol=3e-3)
    assert table["k1"].to_numpy() == pytest.approx(STIFFNESS, rel=3e-3)
    assert np.diff(table["t"]) == pytest.approx(0.25)


def test_a_window_is_the_fit_of_its_samples():
    softening = chain((2, laws.StiffnessDrift(DRIFT)))
    X, F = features(run(softening, [1, 2, 3], duration=10.0))
    model = NRFRegressor(degree=1).fit(X, F)
    row = moving_windows(model, X, F, window=2.0, step=0.5, masses=None).iloc[3]
    rows = slice(int(1.5 * FS), int(3.5 * FS))
    fitted = NRFRegressor(degree=1).fit(X.iloc[rows], F.iloc[rows])
    for i in (1, 2, 3):
        stiffness = fitted.restoring_forces_[i].linear_part()["k"]
        assert row[f"k{i}"] == pytest.approx(stiffness, rel=1e-9)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.BiasWarning")
def test_a_window_never_joins_two_records(chain2):
    """Of 1.2 and 0.8 s: windows of 0.4 s in steps of 0.2 s lie inside one of them."""
    X = chain2.X
    F = chain2.F
    ids = np.repeat(["a", "b"], [1200, 800])
    model = NRFRegressor(dt=1e-3, degree=1).fit(X, F, record=ids)
    table = moving_windows(model, X, F, window=0.4, step=0.2, record=ids)
    assert table["record"].value_counts().to_dict() == {0: 5, 1: 3}


# -- refused -------------------------------------------------------------------


def test_seconds_without_a_step_are_refused(chain2):
    X = chain2.X
    F = chain2.F
    with pytest.raises(ChannelError, match="needs the sampling step"):
        moving_windows(NRFRegressor().fit(X, F), X, F, window=0.5, step=0.1)


@pytest.mark.parametrize(
    ("error", "words", "settings"),
    [
        (ChannelError, "Pieces of 2 samples", {"step": 0.002}),
        (ChainError, "No window of 60 s", {"window": 60.0, "masses": None}),
        (ChainError, "masses='all' is", {"masses": "all"}),
    ],
)
def test_windows_that_cannot_be_are_refused(chain2, error, words, settings):
    X = chain2.X
    F = chain2.F
    timed = NRFRegressor(dt=1e-3).fit(X, F)
    with pytest.raises(error, match=words):
        moving_windows(timed, X, F, **{"window": 0.5, "step": 0.5, **settings})


def test_few_blocks_are_refused():
    with pytest.raises(ChainError, match="standard error"):
        compare_tests(NRFRegressor(degree=1), None, None, n_blocks=3)


def test_tests_of_other_structures_are_refused(chain2):
    X = chain2.X
    F = chain2.F
    one_floor = (X[:, ::2], F[:, :1])
    with pytest.raises(ChainError, match="have 2 and 1 DOFs"):
        compared((X, F), one_floor, dt=1e-3)


# -- a free chain --------------------------------------------------------------


def free_chain(stiffness):
    """Two masses that float, joined by storey 2."""
    storey = laws.PowerSeries(1, [60.0, stiffness])
    return ChainModel([10.0, 12.0], {"storey 2": storey}, Chain(2, ground="free"))


def forced(model, seed):
    """Motions and forces of a model, forced on every floor."""
    F = excitation.band_limited_random(
        2, 4.0, 500.0, excited=[1, 2], rms=50.0, band=(1, 60), random_state=seed
    )
    return simulate(model, F, 1 / 500.0).to_features(smooth=False)


@pytest.fixture(scope="module")
def floating():
    before = forced(free_chain(4e4), 0)
    after = forced(free_chain(3.6e4), 1)
    return compared(before, after, chain=Chain(2, ground="free"), dt=2e-3)


def test_a_free_chain_is_compared_where_it_has_storeys(floating):
    table = floating.table.set_index(["storey", "term"])
    none = table.loc["storey 1", ["before", "after", "change", "p"]]
    assert floating.damaged == ["storey 2"]
    assert table.loc[("storey 2", "k"), "change"] == pytest.approx(-10.0, abs=0.01)
    assert none.isna().all(axis=None)


def test_models_of_free_chains_agree_where_they_have_storeys():
    motion = forced(free_chain(4e4), 0)[0]
    agreement = model_agreement(free_chain(4e4), free_chain(3.6e4), motion)
    assert agreement.loc["storey 2", "k"] == pytest.approx(-10.0)
    assert agreement.loc["storey 1", ["k", "c"]].isna().all()
