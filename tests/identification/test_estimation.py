"""Instrumental variables and output error: noise does not bias them, and they say where
they cannot serve.
"""

import warnings

import chains
import numpy as np
import paper_cases as cases
import pytest
from chains import driven, worst

from pysindy_nrf import (
    ChainModel,
    KinematicSmoother,
    NRFRegressor,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import (
    BiasWarning,
    ChainError,
    ChannelError,
    DataQualityWarning,
)
from pysindy_nrf.records.files.frequency_response import frequency_response
from pysindy_nrf.simulation.noise import add_noise

M, K, C, FS = 12.4, 1.4e5, 25.0, 1000.0


def frame(n: int = 4, cubic: float = 0.0) -> ChainModel:
    held = {f"storey {i}": [laws.PowerSeries(1, [C, K])] for i in range(1, n + 1)}
    if cubic:
        held["storey 2"] = [
            laws.PowerSeries((0, 3), [K, 0.0, cubic]),
            laws.LinearViscous(C),
        ]
    return ChainModel([M] * n, held)


def measured(
    truth: ChainModel, dofs, seed: int, noise: float = 0.05, duration: float = 8.0
):
    return add_noise(
        driven(truth, dofs, duration, FS, 100.0, (0.5, 60.0), seed=seed, hold="cubic"),
        noise,
        random_state=[seed, 1],
    )


def stiffness(model) -> list[float]:
    return [
        model.restoring_forces_[i].linear_part()["k"]
        for i in range(1, len(model.masses_) + 1)
    ]


@pytest.fixture(scope="module")
def four_floors():
    return [measured(frame(), [3], seed, duration=16.0) for seed in range(3)]


@pytest.mark.slow
def test_masses_and_stiffnesses_survive_five_percent_noise(four_floors):
    fits = [NRFRegressor(degree=1, estimation="iv").fit(rec) for rec in four_floors]
    masses = np.array([f.masses_ for f in fits]) / M - 1
    assert np.median(np.abs(masses).max(axis=1)) < 0.006
    assert np.median([worst(stiffness(f), [K] * 4) for f in fits]) < 0.006
    damping = [
        [f.restoring_forces_[i].linear_part()["c"] for i in (1, 2, 3, 4)] for f in fits
    ]
    assert np.median([worst(c, [C] * 4) for c in damping]) < 0.10
    # plain least squares on the raw channels loses a third of the mass or more
    with warnings.catch_warnings(action="ignore"):
        raw = NRFRegressor(degree=1).fit(*four_floors[0].to_features(smooth=False))
    assert raw.masses_.max() < 0.7 * M


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "told", "dofs"),
    [
        (frame(2), {}, [1, 2]),
        (frame(2), {"strategy": "complete"}, [1, 2]),
        (frame(3, cubic=5e8), {"orders": {"storey 2": 3}}, [3]),
    ],
    ids=["joint", "complete", "cubic storey"],
)
def test_every_strategy_and_nonlinear_laws(truth, told, dofs):
    fits = [
        NRFRegressor(degree=1, estimation="iv", **told).fit(measured(truth, dofs, seed))
        for seed in range(3)
    ]
    masses = np.array([f.masses_ for f in fits])
    assert worst(np.mean(masses, axis=0), truth.masses) < 0.012
    if "orders" in told:
        cubic = [f.restoring_forces_[2].coefficients["s^3"] for f in fits]
        assert np.mean(cubic) == pytest.approx(5e8, rel=0.25)


@pytest.mark.slow
def test_a_stick_slip_damper_of_the_size_of_the_noise():
    """70 N turn over within 0.02 mm, the noise of the drift: least squares loses 10 %
    of the masses, instruments do not.
    """
    case = cases.four_storey(
        cases.INCOMPLETE_FRAME, 70.0, 0.01, level=1000.0, duration=16.0
    )
    told = {
        "degree": 1,
        "laws": {"storey 4": [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]},
    }
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        plain = NRFRegressor(**told, estimation="ls").fit(case.measured)
    model = NRFRegressor(**told, estimation="iv").fit(case.measured)
    assert (
        worst(plain.masses_, case.truth.masses) > 0.05
        and worst(model.masses_, case.truth.masses) < 0.015
    )
    assert model.restoring_forces_[4].coefficients.iloc[-1] == pytest.approx(
        70.0, rel=0.03
    )


def test_doubts_about_masses_and_laws_come_as_one_warning():
    truth = frame(2).with_laws(
        {"storey 1": [laws.PowerSeries(1, [C, K]), laws.CoulombFriction(60.0)]}
    )
    X, F = measured(truth, [2], 0).to_features(smooth=False)
    with warnings.catch_warnings(record=True, action="always") as caught:
        NRFRegressor(degree=1).fit(X, F)
    said = [str(w.message) for w in caught if w.category is BiasWarning]
    assert (
        len(said) == 1
        and "is likely biased" in said[0]
        and "A law is missing" in said[0]
    )


def test_exact_data_give_exact_numbers():
    case = chains.duffing(3, [2], seed=4, cubic=False)
    model = NRFRegressor(degree=1, estimation="iv", dt=case.dt).fit(case.X, case.F)
    assert (
        worst(model.masses_, case.m) < 1e-7 and worst(stiffness(model), case.k) < 1e-7
    )
    assert model.model_.info["estimation"]["found"] == "iv"


@pytest.mark.slow
def test_displacements_alone_do_not_ask_for_what_they_cannot_show():
    """At 2 % noise a displacement sensor is blind above some 40 Hz while the force goes
    on to 60 Hz.
    """
    recs = [
        measured(frame(), [3], seed, 0.02, 16.0).replace(
            acceleration=None, velocity=None
        )
        for seed in range(3)
    ]
    masses = np.array(
        [NRFRegressor(degree=1, estimation="iv").fit(rec).masses_ for rec in recs]
    )
    assert worst(np.median(masses, axis=0), [M] * 4) < 0.01


@pytest.mark.slow
def test_motions_fused_apart_serve_like_their_record(four_floors):
    X, F = four_floors[0].to_features(smooth=KinematicSmoother(joint=False))
    with warnings.catch_warnings(action="error", category=DataQualityWarning):
        same = NRFRegressor(degree=1, estimation="iv").fit(X, F)
    assert (
        worst(
            same.masses_,
            NRFRegressor(degree=1, estimation="iv").fit(four_floors[0]).masses_,
        )
        < 1e-3
    )


def test_where_no_free_run_serves_least_squares_is_kept_and_said():
    rng = np.random.default_rng(0)
    X, F = rng.normal(size=(2000, 6)), rng.normal(size=(2000, 2))
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = NRFRegressor(degree=3, estimation="iv", dt=1e-3).fit(X, F)
    assert any(
        "fell back on least squares" in str(w.message)
        for w in caught
        if w.category is BiasWarning
    )
    assert model.model_.info["estimation"]["found"] == "ls"
    assert "estimation" in model.diagnose().table["limit"].tolist()
    np.testing.assert_array_equal(
        model.masses_, NRFRegressor(degree=3).fit(X, F).masses_
    )


def test_no_clock_and_unknown_names_are_refused():
    case = chains.duffing(2, [2], seed=1, n_samples=500)
    with pytest.raises(ChannelError, match="sampling step"):
        NRFRegressor(degree=1, estimation="iv").fit(case.X, case.F)
    with pytest.raises(ChainError, match="'ls', 'iv'|ls, iv"):
        NRFRegressor(estimation="magic").fit(case.X, case.F)


def test_unknown_force_is_returned_where_the_chain_allows_it():
    """Record 1 is hit on DOF 3 and identifies all; in record 2 an unmeasured force acts
    on DOF 2.
    """
    truth = frame(3)
    F = excitation.band_limited_random(
        3, 4.0, FS, excited=[3], rms=100.0, band=(0.5, 60.0), random_state=0
    )
    both = F + excitation.band_limited_random(
        3, 4.0, FS, excited=[2], rms=70.0, band=(0.5, 60.0), random_state=1
    )
    first, second = (
        simulate(truth, f, 1 / FS).to_features(smooth=False) for f in (F, both)
    )
    X = np.vstack([first[0], second[0]])
    told = np.vstack([first[1], second[1]])
    told[len(F) :, 1] = np.nan
    ids = np.repeat([0, 1], len(F))
    model = NRFRegressor(degree=1).fit(X, told, record=ids)
    assert list(model.unknown_forces_.columns) == ["F2"]
    assert model.unknown_forces_["F2"].iloc[: len(F)].isna().all()
    np.testing.assert_allclose(
        model.unknown_forces_["F2"].iloc[len(F) :], both[:, 1], atol=1e-5
    )


def test_unknown_force_everywhere_needs_the_mass():
    truth = frame(3)
    F = excitation.band_limited_random(
        3, 4.0, FS, excited=[1, 3], rms=100.0, band=(0.5, 60.0), random_state=0
    )
    X, told = simulate(truth, F, 1 / FS).to_features(smooth=False)
    told = told.assign(F1=np.nan)
    model = NRFRegressor(degree=1, known_masses={1: M}, chain=None)
    with pytest.raises(Exception, match="storey 1 cannot be scaled"):
        model.fit(X, told)  # storey 1 stands in the balance of DOF 1 alone
    told = simulate(truth, F, 1 / FS).to_features(smooth=False)[1].assign(F3=np.nan)
    model = NRFRegressor(degree=1, known_masses={3: M}).fit(X, told)
    np.testing.assert_allclose(model.unknown_forces_["F3"], F[:, 2], atol=1e-5)


def unknown_on(rec, dof):
    force = rec.force.copy()
    force[:, dof - 1] = np.nan
    return rec.replace(force=force)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_instruments_need_a_record_whose_forces_are_all_known():
    """An unknown force on floor 2: floor 1 is enough for least squares if m2 is known;
    a free run needs all forces.
    """
    hidden = unknown_on(measured(frame(2), [1, 2], 0, 0.03), 2)
    for kind in ("iv", "simulation"):
        with pytest.warns(
            BiasWarning, match="in every record the force on some DOF is unknown"
        ):
            model = NRFRegressor(degree=1, estimation=kind, known_masses={2: M}).fit(
                [hidden, hidden.replace(name="s")]
            )
        assert model.model_.info["estimation"]["found"] == "ls"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_a_record_with_an_unknown_force_is_left_out_of_the_instruments_alone():
    """As one table with ids, and as a list of records."""
    pair = [
        measured(frame(2), [1, 2], 0, 0.03),
        unknown_on(measured(frame(2), [1, 2], 5, 0.03), 1).replace(name="wind"),
    ]
    X, F = (np.vstack([rec.to_features()[k] for rec in pair]) for k in (0, 1))
    ids = np.repeat([0, 1], [rec.n_samples for rec in pair])
    for estimation in ("iv", "simulation"):
        model = NRFRegressor(degree=1, estimation=estimation, dt=1 / FS).fit(
            X, F, record=ids
        )
        facts = model.model_.info["estimation"]
        assert facts[
            "found"
        ] != "ls" and "1 records with an unknown force were left out" in str(facts)
        assert worst(model.masses_, [M, M]) < 0.03
    assert (
        worst(NRFRegressor(degree=1, estimation="iv").fit(pair).masses_, [M, M]) < 0.03
    )


def test_frequency_responses_are_linear_and_need_lines():
    f = np.linspace(2.0, 25.0, 40)
    w = 2 * np.pi * f
    H = -(w**2) / (1e4 - 2.0 * w**2 + 8j * w)
    response = frequency_response(f, H[:, None])
    with pytest.raises(
        ChainError, match="estimation='simulation' .* frequency responses"
    ):
        NRFRegressor(degree=1, estimation="simulation").fit(response)
    with pytest.raises(ChainError, match="8 lines .* do not tell noise"):
        NRFRegressor(degree=1).fit(frequency_response(f[:8], H[:8, None]))


def test_instruments_find_the_shape_of_a_law():
    """Truth by LSODA: at 2 % noise least squares finds sigma a quarter and the friction
    a tenth too low.
    """
    case, *_ = chains.paper_case(duration=2.0, fs=500.0)
    noisy, told = (
        add_noise(case.record(), 0.02, random_state=0),
        {"storey 1": [laws.PowerSeries(1), laws.Dahl()]},
    )
    plain, model = (
        NRFRegressor(degree=1, laws=told, estimation=e).fit(noisy).model_
        for e in ("ls", "iv")
    )
    assert (
        plain.laws["storey 1"][1].shape["sigma"] < 4e4
        and plain.coefficients["storey 1"][-1] < 32.5
    )
    assert model.laws["storey 1"][1].shape["sigma"] == pytest.approx(5e4, rel=0.03)
    assert model.coefficients["storey 1"][-1] == pytest.approx(34.85, rel=0.015)
