"""Instrumental variables and output error: noise does not bias them, and they say where
they cannot serve.
"""

import warnings

import chains
import numpy as np
import paper_cases
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
    IdentifiabilityError,
)
from pysindy_nrf.records import FrequencyResponse
from pysindy_nrf.simulation import add_noise

MASS = 12.4
STIFFNESS = 1.4e5
DAMPING = 25.0
FS = 1000.0


def frame(n: int = 4) -> ChainModel:
    storey = laws.PowerSeries(1, [DAMPING, STIFFNESS])
    return ChainModel([MASS] * n, dict.fromkeys(range(1, n + 1), storey))


def cubic_frame() -> ChainModel:
    """Three floors, the second storey of which hardens."""
    cubic = laws.PowerSeries((0, 3), [STIFFNESS, 0.0, 5e8])
    return frame(3).with_laws({"storey 2": [cubic, laws.LinearViscous(DAMPING)]})


def measured(truth, dofs, seed, noise=0.05, duration=8.0):
    exact = driven(
        truth, dofs, duration, FS, 100.0, (0.5, 60.0), seed=seed, hold="cubic"
    )
    return add_noise(exact, noise, random_state=[seed, 1])


def linear_parts(model, key):
    storeys = range(1, len(model.masses_) + 1)
    return [model.restoring_forces_[i].linear_part()[key] for i in storeys]


# -- noise does not bias them --------------------------------------------------------


@pytest.fixture(scope="module")
def four_floors():
    return [measured(frame(), [3], seed, duration=16.0) for seed in range(3)]


@pytest.mark.slow
def test_estimates_survive_five_percent_noise(four_floors):
    errors = {"mass": [], "k": [], "c": []}
    for record in four_floors:
        model = NRFRegressor(degree=1, estimation="iv").fit(record)
        errors["mass"].append(worst(model.masses_, [MASS] * 4))
        errors["k"].append(worst(linear_parts(model, "k"), [STIFFNESS] * 4))
        errors["c"].append(worst(linear_parts(model, "c"), [DAMPING] * 4))
    assert np.median(errors["mass"]) < 0.006
    assert np.median(errors["k"]) < 0.006
    assert np.median(errors["c"]) < 0.10


@pytest.mark.slow
def test_least_squares_of_raw_channels_loses_a_third_of_the_mass(four_floors):
    X, F = four_floors[0].to_features(smooth=False)
    with warnings.catch_warnings(action="ignore"):
        model = NRFRegressor(degree=1).fit(X, F)
    assert model.masses_.max() < 0.7 * MASS


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["auto", "complete"])
def test_every_strategy_has_instruments(strategy):
    model = NRFRegressor(degree=1, estimation="iv", strategy=strategy)
    fits = [model.fit(measured(frame(2), [1, 2], seed)).masses_ for seed in range(3)]
    assert worst(np.mean(fits, axis=0), [MASS] * 2) < 0.012


@pytest.mark.slow
def test_a_cubic_storey_has_instruments():
    model = NRFRegressor(degree=1, estimation="iv", orders={"storey 2": 3})
    masses = []
    cubic = []
    for seed in range(3):
        model.fit(measured(cubic_frame(), [3], seed))
        masses.append(model.masses_)
        cubic.append(model.restoring_forces_[2].coefficients["s^3"])
    assert worst(np.mean(masses, axis=0), [MASS] * 3) < 0.012
    assert np.mean(cubic) == pytest.approx(5e8, rel=0.25)


@pytest.mark.slow
def test_a_stick_slip_damper_of_the_size_of_the_noise():
    """70 N turn over within 0.02 mm, the noise of the drift."""
    case = paper_cases.four_storey(
        paper_cases.INCOMPLETE_FRAME, 70.0, 0.01, level=1000.0, duration=16.0
    )
    damper = [laws.PowerSeries(1), laws.Dahl(sigma=5e4)]
    declared = {"degree": 1, "laws": {"storey 4": damper}}
    with warnings.catch_warnings(action="ignore", category=BiasWarning):
        plain = NRFRegressor(**declared, estimation="ls").fit(case.measured)
    model = NRFRegressor(**declared, estimation="iv").fit(case.measured)

    assert worst(plain.masses_, case.truth.masses) > 0.05
    assert worst(model.masses_, case.truth.masses) < 0.015
    friction = model.restoring_forces_[4].coefficients.iloc[-1]
    assert friction == pytest.approx(70.0, rel=0.03)


@pytest.mark.slow
def test_displacements_alone_do_not_ask_for_what_they_cannot_show():
    """At 2 % noise a displacement sensor is blind above some 40 Hz; the force goes on
    to 60 Hz.
    """
    masses = []
    for seed in range(3):
        record = measured(frame(), [3], seed, 0.02, 16.0)
        alone = record.replace(acceleration=None, velocity=None)
        masses.append(NRFRegressor(degree=1, estimation="iv").fit(alone).masses_)
    assert worst(np.median(masses, axis=0), [MASS] * 4) < 0.01


@pytest.mark.slow
def test_motions_fused_apart_serve_like_their_record(four_floors):
    apart = KinematicSmoother(joint=False)
    X, F = four_floors[0].to_features(smooth=apart)
    model = NRFRegressor(degree=1, estimation="iv")
    with warnings.catch_warnings(action="error", category=DataQualityWarning):
        masses = model.fit(X, F).masses_
    assert worst(masses, model.fit(four_floors[0]).masses_) < 1e-3


def test_exact_data_give_exact_numbers():
    case = chains.duffing(3, [2], seed=4, cubic=False)
    model = NRFRegressor(degree=1, estimation="iv", dt=case.dt).fit(case.X, case.F)
    assert worst(model.masses_, case.m) < 1e-7
    assert worst(linear_parts(model, "k"), case.k) < 1e-7
    assert model.result_.method == "iv"


@pytest.fixture(scope="module")
def noisy_damper():
    """The paper's frame with its Dahl damper, by LSODA, at 2 % noise."""
    case, *_ = chains.paper_case(duration=2.0, fs=500.0)
    return add_noise(case.record(), 0.02, random_state=0)


def damper_by(estimation, record):
    free = {"storey 1": [laws.PowerSeries(1), laws.Dahl()]}
    model = NRFRegressor(degree=1, laws=free, estimation=estimation).fit(record).model_
    sigma = model.laws["storey 1"][1].shape["sigma"]
    return sigma, model.coefficients["storey 1"][-1]


def test_instruments_find_the_shape_of_a_law(noisy_damper):
    sigma, friction = damper_by("iv", noisy_damper)
    assert sigma == pytest.approx(5e4, rel=0.03)
    assert friction == pytest.approx(34.85, rel=0.015)


def test_least_squares_loses_a_part_of_a_damper(noisy_damper):
    sigma, friction = damper_by("ls", noisy_damper)
    assert sigma < 4e4
    assert friction < 32.5


# -- they say where they cannot serve ------------------------------------------------


def test_doubts_about_masses_and_laws_come_as_one_warning():
    rubbing = [laws.PowerSeries(1, [DAMPING, STIFFNESS]), laws.CoulombFriction(60.0)]
    truth = frame(2).with_laws({"storey 1": rubbing})
    X, F = measured(truth, [2], 0).to_features(smooth=False)
    with warnings.catch_warnings(record=True, action="always") as caught:
        NRFRegressor(degree=1).fit(X, F)
    (doubts,) = [
        str(warning.message) for warning in caught if warning.category is BiasWarning
    ]
    assert "is likely biased" in doubts
    assert "A law is missing" in doubts


def test_a_band_that_ends_close_above_a_resonance_leaves_instruments():
    """First instruments are a quarter of a period of the end late, here 75 degrees."""
    truth = ChainModel([10.0], {1: laws.PowerSeries(1, [25.0, 1.58e5])})  # 20 Hz
    exact = driven(truth, [1], 4.0, 500.0, 100.0, (0.5, 60.0), seed=0, hold="cubic")
    record = add_noise(exact, 0.05, random_state=0)
    result = NRFRegressor(degree=1, band=(None, 24.0)).fit(record).result_
    assert result.method == "iv"
    assert result.model.info["estimation"]["correlation"] > 0.9
    low, high = result.bounds[0]["m1"]
    assert low < 10.0 < high


def test_a_mass_by_instruments_is_not_doubted_for_the_bias_of_least_squares():
    truth = ChainModel([10.0], {1: laws.PowerSeries(1, [50.0, 1e5])})
    t = np.arange(1000) / 500.0
    force = 100.0 * np.sin(2 * np.pi * 5.0 * t)[:, None]
    exact = simulate(truth, force, 1 / 500.0).replace(velocity=None)
    record = add_noise(exact, 0.05, random_state=0)

    plain = NRFRegressor(degree=1, estimation="ls")
    with pytest.warns(BiasWarning, match="m1 = .* kg is likely biased"):
        plain.fit(record)
    model = NRFRegressor(degree=1).fit(record)
    assert model.result_.method == "iv"
    assert not model.result_.data_warnings["masses"]
    low, high = model.result_.bounds[0]["m1"]
    assert low < 10.0 < high


@pytest.fixture(scope="module")
def random_columns():
    rng = np.random.default_rng(0)
    return rng.normal(size=(2000, 6)), rng.normal(size=(2000, 2))


def test_where_no_free_run_serves_least_squares_is_kept(random_columns):
    model = NRFRegressor(degree=3, estimation="iv", dt=1e-3)
    with warnings.catch_warnings(action="ignore"):
        with pytest.warns(BiasWarning, match="fell back on least squares"):
            model.fit(*random_columns)
        plain = NRFRegressor(degree=3).fit(*random_columns)
    assert model.result_.method == "ls"
    assert "estimation" in model.diagnose().table["limit"].tolist()
    np.testing.assert_array_equal(model.masses_, plain.masses_)


def test_instruments_need_a_clock():
    case = chains.duffing(2, [2], seed=1, n_samples=500)
    with pytest.raises(ChannelError, match="sampling step"):
        NRFRegressor(degree=1, estimation="iv").fit(case.X, case.F)


# -- forces that are not known -------------------------------------------------------


def random_force(dofs, rms=100.0, seed=0):
    return excitation.band_limited_random(
        3, 4.0, FS, excited=dofs, rms=rms, band=(0.5, 60.0), random_state=seed
    )


def features_under(force):
    return simulate(frame(3), force, 1 / FS).to_features(smooth=False)


def test_an_unknown_force_is_returned():
    """Record 1 is hit on DOF 3; in record 2 an unmeasured force acts on DOF 2, too."""
    hit = random_force([3])
    both = hit + random_force([2], rms=70.0, seed=1)
    X = np.vstack([features_under(hit)[0], features_under(both)[0]])
    F = np.vstack([hit, both])
    F[len(hit) :, 1] = np.nan
    ids = np.repeat([0, 1], len(hit))

    unknown = NRFRegressor(degree=1).fit(X, F, record=ids).unknown_forces_

    assert list(unknown.columns) == ["F2"]
    assert unknown["F2"].iloc[: len(hit)].isna().all()
    np.testing.assert_allclose(unknown["F2"].iloc[len(hit) :], both[:, 1], atol=1e-5)


def test_an_unknown_force_everywhere_needs_the_mass():
    force = random_force([1, 3])
    X, F = features_under(force)
    model = NRFRegressor(degree=1, known_masses={3: MASS}).fit(X, F.assign(F3=np.nan))
    np.testing.assert_allclose(model.unknown_forces_["F3"], force[:, 2], atol=1e-5)


def test_a_storey_in_the_balance_of_an_unknown_force_alone_has_no_scale():
    X, F = features_under(random_force([1, 3]))
    model = NRFRegressor(degree=1, known_masses={1: MASS})
    with pytest.raises(IdentifiabilityError, match="storey 1 cannot be scaled"):
        model.fit(X, F.assign(F1=np.nan))


def unknown_on(record, dof):
    force = record.force.copy()
    force[:, dof - 1] = np.nan
    return record.replace(force=force)


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("estimation", ["iv", "simulation"])
def test_instruments_need_a_record_whose_forces_are_all_known(estimation):
    """Floor 1 is enough for least squares if m2 is known; a free run needs more."""
    hidden = unknown_on(measured(frame(2), [1, 2], 0, 0.03), 2)
    model = NRFRegressor(degree=1, estimation=estimation, known_masses={2: MASS})
    with pytest.warns(BiasWarning, match="in every record the force on some DOF"):
        model.fit([hidden, hidden.replace(name="second")])
    assert model.result_.method == "ls"


@pytest.fixture(scope="module")
def known_and_unknown():
    """Two records; in the second one the force on floor 1 is not known."""
    known = measured(frame(2), [1, 2], 0, 0.03)
    unknown = unknown_on(measured(frame(2), [1, 2], 5, 0.03), 1)
    return [known, unknown.replace(name="wind")]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
@pytest.mark.parametrize("estimation", ["iv", "simulation"])
def test_a_record_with_an_unknown_force_is_left_out_alone(
    known_and_unknown, estimation
):
    tables = [record.to_features() for record in known_and_unknown]
    X = np.vstack([X for X, _ in tables])
    F = np.vstack([F for _, F in tables])
    ids = np.repeat([0, 1], [record.n_samples for record in known_and_unknown])

    model = NRFRegressor(degree=1, estimation=estimation, dt=1 / FS)
    model.fit(X, F, record=ids)

    assert model.result_.method != "ls"
    assert "1 records with an unknown force were left out" in str(model.result_.notes)
    assert worst(model.masses_, [MASS, MASS]) < 0.03


@pytest.mark.slow
def test_a_list_of_records_may_hold_an_unknown_force(known_and_unknown):
    with warnings.catch_warnings(action="ignore"):
        model = NRFRegressor(degree=1, estimation="iv").fit(known_and_unknown)
    assert worst(model.masses_, [MASS, MASS]) < 0.03


def test_frequency_responses_need_lines():
    f = np.linspace(2.0, 25.0, 40)
    w = 2 * np.pi * f
    H = -(w**2) / (1e4 - 2.0 * w**2 + 8j * w)
    with pytest.raises(ChainError, match="8 lines"):
        NRFRegressor(degree=1).fit(FrequencyResponse(f[:8], H[:8, None]))
