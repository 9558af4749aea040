"""Changes between two tests, parameters that vary with time, and the onset of a
change.
"""

import numpy as np
import pytest
from paper_cases import model_agreement
from three_floors import FS, chain, features, noisy, run

from pysindy_nrf import Chain, ChainModel, NRFRegressor, excitation, laws, simulate
from pysindy_nrf.exceptions import ChainError, ChannelError
from pysindy_nrf.monitoring import compare_tests, track
from pysindy_nrf.simulation.noise import add_noise


def test_change_of_damping_and_stiffness_are_told_apart():
    before = noisy(run(chain(), [3], duration=30.0), 0.02, 1)
    after = noisy(
        run(chain((3, laws.LinearElastic(-4e3))), [3], duration=30.0, seed=5), 0.02, 2
    )
    report = compare_tests(NRFRegressor(degree=1), before, after)
    assert report.damaged == ["storey 3"]
    assert report.changed["change"].iloc[0] == pytest.approx(-8.0, abs=0.5)
    assert str(report).startswith("Stiffness of storey 3 changed by -")
    table = report.map(3, size=21)
    visited = table[table["visited"]]
    wrong = visited["change"] + 4e3 * visited["s"]
    assert np.abs(wrong).max() < 0.05 * np.abs(4e3 * visited["s"]).max()
    assert visited.loc[
        visited["s"].abs() > 0.5 * visited["s"].max(), "significant"
    ].all()


def test_a_cubic_spring_that_appears_is_a_change_and_the_map_shows_its_force():
    """In the declared linear law a cubic spring is next to nothing; as a force it is 30
    % of the storey's spring.
    """
    before = run(chain(), [3], duration=12.0).record
    drift = np.diff(before.displacement, axis=1)[:, 0]
    k3 = 0.3 * 5e4 * drift.std() / (drift**3).std()
    after = run(
        chain((2, laws.CubicStiffness(k3))), [3], rms=80.0, duration=12.0, seed=5
    ).record
    report = compare_tests(
        NRFRegressor(degree=1),
        *(add_noise(r, 0.01, random_state=i) for i, r in enumerate((before, after))),
    )
    assert report.damaged == ["storey 2"] and report.changed["term"].tolist() == ["k3"]
    assert str(report).startswith("Cubic spring of storey 2 changed by")
    table = report.map(2)
    seen = table[table["visited"]]
    assert (
        np.abs(seen["change"] - k3 * seen["s"] ** 3).max()
        < 0.1 * np.abs(k3 * seen["s"] ** 3).max()
    )
    assert (
        not report.map(3)["significant"].any()
        and not report.map(1)["significant"].any()
    )


def test_another_amplitude_of_a_damper_that_no_law_knows_is_no_change():
    damped = chain((3, laws.Dahl(sigma=5e4, Fd=20.0)))
    tests = [
        add_noise(
            run(damped, [3], rms=r, duration=20.0, seed=i).record, 0.01, random_state=i
        )
        for i, r in enumerate((80, 160))
    ]
    report = compare_tests(NRFRegressor(degree=1), *tests)
    assert not len(report.changed) and report.damaged == []
    assert "storey 3" in report.explained["storey"].tolist()
    assert "Storey 3: fitted apart" in str(
        report
    ) and "amplitude alone explains it (rms drift" in str(report)


def test_a_law_with_a_state_is_compared_on_its_own_parameters():
    own = {"storey 2": [laws.PowerSeries(1), laws.Dahl()]}
    tests = [
        run(chain((2, laws.Dahl(sigma=s, Fd=f))), [3], duration=12.0, seed=i).record
        for i, (s, f) in enumerate([(2e4, 20.0), (2e4, 26.0)])
    ]
    report = compare_tests(NRFRegressor(degree=1, laws=own), *tests)
    assert report.damaged == ["storey 2"] and report.changed["term"].iloc[0].startswith(
        "own Fd"
    )
    change = report.table.set_index(["storey", "term"]).loc["storey 2", "change"]
    assert change["Fd"] == pytest.approx(30.0, abs=0.5) and change[
        "sigma"
    ] == pytest.approx(0.0, abs=3.0)


def test_added_mass_is_no_damage():
    heavy = ChainModel([10.0, 10.8, 10.0], chain().laws)
    report = compare_tests(
        NRFRegressor(degree=1),
        run(chain(), [3], duration=12.0).record,
        run(heavy, [1], duration=12.0, seed=4).record,
    )
    assert (
        report.changed[["place", "term"]].to_numpy().tolist() == [["dof 2", "m"]]
        and report.damaged == []
    )
    assert report.changed["change"].iloc[0] == pytest.approx(8.0, abs=0.3)
    assert report.after.masses - report.before.masses == pytest.approx(
        [0.0, 0.8, 0.0], abs=0.03
    )


@pytest.mark.slow
def test_standard_errors_hold_what_they_promise():
    """Of repeated tests of an unchanged structure, few stiffnesses and dampings leave
    two standard errors.
    """
    z, p = [], []
    for seed in range(20, 32, 2):
        tests = [
            add_noise(
                run(chain(), [3], duration=12.0, seed=k).record, 0.05, random_state=k
            )
            for k in (seed, seed + 1)
        ]
        table = compare_tests(NRFRegressor(degree=1), *tests).table
        z.append(table["change"] / table["error"])
        p.append(table["p"].min())
    assert (np.array(p) > 0.01).all()
    each = np.sqrt(
        np.mean(np.square(z), axis=0)
    )  # of every term, over six pairs: 99.9 % lie within these for a true 1
    assert (0.25 < each).all() and (each < 1.95).all()


def test_track_follows_a_drifting_stiffness():
    X, F = features(run(chain((2, laws.StiffnessDrift(-250.0))), [3], duration=20.0))
    known = dict.fromkeys((1, 2, 3), 10.0)
    table = track(
        NRFRegressor(degree=1, known_masses=known).fit(X, F),
        X,
        F,
        window=1.0,
        masses=known,
    )
    assert np.allclose(table["k2"], 5e4 - 250.0 * table["t"], rtol=3e-3)
    assert table["k1"].to_numpy() == pytest.approx(5e4, rel=3e-3)
    assert np.diff(table["t"]) == pytest.approx(0.25)


def test_window_of_block_moments_is_the_fit_of_its_samples():
    X, F = features(
        run(chain((2, laws.StiffnessDrift(-250.0))), [1, 2, 3], duration=10.0)
    )
    model = NRFRegressor(degree=1).fit(X, F)
    row = track(model, X, F, window=2.0, step=0.5, masses=None).iloc[3]
    part = slice(int(1.5 * FS), int(3.5 * FS))
    own = NRFRegressor(degree=1).fit(X.iloc[part], F.iloc[part])
    for i in (1, 2, 3):
        assert row[f"k{i}"] == pytest.approx(
            own.restoring_forces_[i].linear_part()["k"], rel=1e-9
        )


def test_pieces_too_short_and_seconds_without_a_step(chain2):
    X, F = chain2.X, chain2.F
    with pytest.raises(
        ChannelError, match="A window in seconds needs the sampling step"
    ):
        track(NRFRegressor().fit(X, F), X, F, window=0.5, step=0.1)
    timed = NRFRegressor(dt=1e-3).fit(X, F)
    with pytest.raises(ChannelError, match="Pieces of 2 samples are too short"):
        track(timed, X, F, window=0.5, step=0.002)
    for words, window, masses in (
        ("No window of 60 s fits into the records", 60.0, None),
        ("masses='all' is", 0.5, "all"),
    ):
        with pytest.raises(ChainError, match=words):
            track(timed, X, F, window=window, step=0.5, masses=masses)
    with pytest.raises(ChainError, match="standard error"):
        compare_tests(NRFRegressor(degree=1), None, None, n_blocks=3)
    with pytest.raises(ChainError, match="have 2 and 1 DOFs"):
        compare_tests(timed, (X, F), (X[:, ::2], F[:, :1]))


def test_a_window_never_joins_two_records(chain2):
    """Two records of 1.2 and 0.8 s: windows of 0.4 s in steps of 0.2 s lie inside one
    of them.
    """
    ids = np.repeat(["a", "b"], [1200, 800])
    model = NRFRegressor(dt=1e-3, degree=1).fit(chain2.X, chain2.F, record=ids)
    found = track(model, chain2.X, chain2.F, window=0.4, step=0.2, record=ids)
    assert found["record"].value_counts().to_dict() == {0: 5, 1: 3}


LINEAR = laws.PowerSeries(1, [60.0, 4e4])


def forced(model, seconds=4.0, fs=500.0, seed=0, **options):
    n = model.n_dof
    F = excitation.band_limited_random(
        n,
        seconds,
        fs,
        excited=range(1, n + 1),
        rms=50.0,
        band=(1, 60),
        random_state=seed,
        **options,
    )
    return simulate(model, F, 1 / fs)


def test_a_free_chain_is_compared_where_it_has_storeys():
    chain = Chain(2, ground="free")
    truth = ChainModel([10.0, 12.0], {"storey 2": LINEAR}, chain)
    damaged = ChainModel(
        [10.0, 12.0], {"storey 2": laws.PowerSeries(1, [60.0, 3.6e4])}, chain
    )
    before, after = (
        forced(m, seed=i).to_features(smooth=False)
        for i, m in enumerate((truth, damaged))
    )
    report = compare_tests(NRFRegressor(degree=1, chain=chain, dt=2e-3), before, after)
    assert report.damaged == ["storey 2"]
    table = report.table.set_index(["storey", "term"])
    assert table.loc[("storey 2", "k"), "change"] == pytest.approx(-10.0, abs=0.01)
    assert (
        table.loc["storey 1", ["before", "after", "change", "p"]].isna().all(axis=None)
    )
    agreement = model_agreement(truth, damaged, before[0])
    assert agreement.loc["storey 2", "k"] == pytest.approx(-10.0)
    assert agreement.loc["storey 1", ["k", "c"]].isna().all()
