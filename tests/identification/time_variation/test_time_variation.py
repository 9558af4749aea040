"""Coefficients that change while a structure shakes, integrated by SciPy's LSODA."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import binom

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.exceptions import BiasWarning, ChainError, ChannelError

FS = 200.0
T = np.arange(0, 30, 1 / FS)
MASSES = np.array([10.0, 8.0])
DAMPING = np.array([40.0, 30.0])
UPPER = 6e3  # N/m
HALF_PERIOD = 0.2  # s, of the first mode


def lower_constant(t):
    return np.full_like(np.asarray(t, dtype=float), 8e3)


def lower_ramp(t):
    return 8e3 - 2.4e3 * np.clip((np.asarray(t) - 8) / 14, 0, 1)


def lower_step(t):
    return np.where(np.asarray(t) < 13.0, 8e3, 6e3)


def shaken(stiffness, seed=0, cubic=0.0):
    """Two floors under random forces; the lower stiffness is a function of time."""
    F = excitation.band_limited_random(
        2, 30.0, FS, excited=[1, 2], rms=40.0, band=(0.5, 10), random_state=seed
    )

    m1, m2 = MASSES.tolist()
    c1, c2 = DAMPING.tolist()
    low, high = F[:, 0].tolist(), F[:, 1].tolist()
    k1 = stiffness(T).tolist()

    def slope(t, state):
        x1, x2, v1, v2 = state.tolist()
        i = min(int(t * FS), len(T) - 2)
        share = t * FS - i
        f1 = low[i] + share * (low[i + 1] - low[i])
        f2 = high[i] + share * (high[i + 1] - high[i])
        k = k1[i] + share * (k1[i + 1] - k1[i])
        lower = k * x1 + cubic * x1**3 + c1 * v1
        upper = UPPER * (x2 - x1) + c2 * (v2 - v1)
        return [v1, v2, (f1 - lower + upper) / m1, (f2 - upper) / m2]

    run = solve_ivp(
        slope, (0, T[-1]), np.zeros(4), method="LSODA", t_eval=T, rtol=1e-6, atol=1e-9
    )
    x, v = run.y[:2].T, run.y[2:].T
    a = np.array([slope(t, state)[2:] for t, state in zip(T, run.y.T)])
    return Record(force=F, acceleration=a, velocity=v, displacement=x, fs=FS)


def noisy(record, share, seed=1):
    """White noise on every channel."""
    rng = np.random.default_rng(seed)

    def with_noise(values):
        return values + share * values.std(axis=0) * rng.standard_normal(values.shape)

    return record.replace(
        force=with_noise(record.force),
        acceleration=with_noise(record.acceleration),
        velocity=with_noise(record.velocity),
        displacement=with_noise(record.displacement),
    )


@pytest.fixture(scope="module")
def ramp():
    record = noisy(shaken(lower_ramp), 0.01)
    with pytest.warns(BiasWarning, match="storey 1"):
        return NRFRegressor(degree=1, varying="auto").fit(record)


@pytest.fixture(scope="module")
def step():
    record = noisy(shaken(lower_step), 0.01)
    with pytest.warns(BiasWarning, match="storey 1"):
        return NRFRegressor(degree=1, varying="auto").fit(record)


def test_a_gradual_loss_is_followed_in_its_storey(ramp):
    variation = ramp.time_variation_
    assert variation.changing == ["storey 1"]
    course = variation.course("storey 1", "s")
    truth = lower_ramp(course.index)
    error = np.sqrt(np.mean((course["value"] - truth) ** 2) / np.mean(truth**2))
    assert error < 0.01


def test_masses_beside_a_course_are_right(ramp):
    assert ramp.time_variation_.masses == pytest.approx(MASSES, rel=0.01)
    errors = ramp.time_variation_.errors
    assert errors["varying"] < 0.5 * errors["constant"]


def test_a_sudden_loss_stays_sudden(step):
    variation = step.time_variation_
    (change,) = variation.changes.query("kind != 'constant'").to_dict("records")
    assert (change["site"], change["term"], change["kind"]) == (
        "storey 1",
        "s",
        "sudden",
    )
    assert change["change"] == pytest.approx(-25.0, abs=1.0)


def test_the_instant_of_a_loss_is_found_within_half_a_period(step):
    (row,) = step.time_variation_.instants.to_dict("records")
    assert row["t"] == pytest.approx(13.0, abs=HALF_PERIOD)
    assert row["t_lower"] < 13.0 < row["t_upper"]
    (change,) = step.time_variation_.stiffness_changes
    assert (change.storey, change.since) == ("storey 1", row["t"])
    assert change.lower < -25.0 < change.upper


def test_terms_that_are_named_are_followed_by_label_or_symbol():
    record = noisy(shaken(lower_ramp, seed=3), 0.01)
    damping = {"storey 1": [laws.LinearElastic(), laws.LinearViscous()]}
    asked = {1: ["k", "v"]}
    with pytest.warns(BiasWarning, match="storey 1"):
        model = NRFRegressor(degree=1, laws=damping, varying=asked).fit(record)
    changes = model.time_variation_.changes
    assert changes["term"].tolist() == ["s", "v"]
    assert changes["kind"].tolist() == ["gradual", "constant"]


def test_json_holds_courses_and_changes(step):
    content = json.loads(step.time_variation_.to_json())
    assert content["first_period_s"] == pytest.approx(0.4, abs=0.1)
    assert len(content["instants"]) == 1
    assert len(content["courses"]["t"]) == len(step.time_variation_.table)


def test_courses_are_drawn_with_their_bands(step):
    figure = step.time_variation_.plot().figure_
    assert len(figure.axes) >= 4


# -- what does not change ----------------------------------------------------------


def oscillator(rng, course):
    """Features and force of one mass; noise in the force only."""
    s = np.convolve(rng.standard_normal(len(T) + 40), np.hanning(41), "valid")[: len(T)]
    v = np.gradient(s, 1 / FS)
    a = np.gradient(v, 1 / FS)
    force = 2.0 * a + 3.0 * v + course * s
    noise = 0.1 * force.std() * rng.standard_normal(len(T))
    return np.column_stack([a, v, s]), (force + noise)[:, None]


def followed(X, F):
    return NRFRegressor(degree=1, dt=1 / FS, varying="auto").fit(X, F).time_variation_


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_constant_structures_are_called_changing_no_more_often_than_stated():
    runs = 80
    rng = np.random.default_rng(65)
    alarms = 0
    for _ in range(runs):
        X, F = oscillator(rng, 400.0)
        variation = followed(X, F)
        alarms += bool(variation.changing)
    assert alarms <= binom.ppf(0.999, runs, variation.false_alarm_rate)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_bands_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(66)
    course = 400.0 * (1 - 0.3 * np.sin(np.pi * T / T[-1]) ** 2)
    shares = []
    for _ in range(12):
        X, F = oscillator(rng, course)
        followed_course = followed(X, F).course(1, "s")
        truth = np.interp(followed_course.index, T, course)
        inside = (followed_course["lower"] <= truth) & (
            truth <= followed_course["upper"]
        )
        shares.append(inside.mean())
    assert 0.90 <= np.mean(shares) <= 0.99


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_an_element_without_mass_is_followed_too():
    X, F = oscillator(np.random.default_rng(67), np.where(T < 12, 400.0, 320.0))
    force = F - 2.0 * X[:, :1]
    model = NRFRegressor(degree=1, dt=1 / FS, massless=True, varying={1: ["s"]})
    (row,) = model.fit(X, force).time_variation_.instants.to_dict("records")
    assert row["t"] == pytest.approx(12.0, abs=0.1)
    assert row["change"] == pytest.approx(-20.0, abs=2.0)


# -- friction ----------------------------------------------------------------------


def test_noise_in_the_rate_does_not_lower_the_level_of_friction():
    friction = laws.RegularizedFriction(v0=0.004)
    declared = {1: [laws.PowerSeries(1), friction]}
    storey = [laws.PowerSeries(1, [30.0, 4e3]), friction.with_values([12.0])]
    level = np.interp(T, [8.0, 22.0], [12.0, 6.0])
    F = excitation.band_limited_random(
        1, 30.0, FS, excited=1, rms=40.0, band=(0.5, 10), random_state=3
    )
    run = simulate(
        ChainModel([10.0], {1: storey}),
        F,
        1 / FS,
        courses={"storey 1: tanh(v/v0)": level},
    )
    with pytest.warns(BiasWarning, match="storey 1"):
        model = NRFRegressor(degree=1, laws=declared, varying="auto").fit(
            noisy(run, 0.05)
        )
    course = model.time_variation_.course(1, "tanh(v/v0)")
    truth = np.interp(course.index, T, level)
    assert np.mean(course["value"] / truth) == pytest.approx(1.0, abs=0.05)
    inside = (course["lower"] <= truth) & (truth <= course["upper"])
    assert inside.mean() > 0.8


@pytest.mark.filterwarnings("ignore::pysindy_nrf.exceptions.NRFWarning")
def test_a_band_that_is_not_known_is_not_shown():
    # without mass there is no free run, whose rate would be without noise
    X, _ = oscillator(np.random.default_rng(68), 400.0)
    level = np.where(T < 15, 400.0, 200.0)[:, None]
    force = 400.0 * X[:, 2:] + level * np.sign(X[:, 1:2])
    device = {1: [laws.PowerSeries(1), laws.CoulombFriction()]}
    model = NRFRegressor(
        degree=1, laws=device, dt=1 / FS, massless=True, varying={1: ["s", "sgn(v)"]}
    )
    variation = model.fit(X, force).time_variation_
    assert variation.changing == ["storey 1"]
    assert variation.course(1, "sgn(v)")["lower"].isna().all()
    assert variation.course(1, "s")["lower"].notna().all()
    assert "NaN" not in variation.to_json()
    assert "unknown error" in str(variation)
    assert variation.plot().figure_.axes


def test_a_hardening_spring_is_not_called_changing():
    record = noisy(shaken(lower_constant, seed=5, cubic=2e6), 0.01)
    variation = NRFRegressor(degree=1, varying="auto").fit(record).time_variation_
    assert variation.changing == []


# -- refusals ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def record():
    return shaken(lower_constant)


@pytest.mark.parametrize("estimation", ["iv", "simulation"])
def test_other_methods_refuse_it_by_name(record, estimation):
    with pytest.raises(ChainError, match="varying"):
        NRFRegressor(degree=1, estimation=estimation, varying="auto").fit(record)


def test_data_in_pieces_and_partial_fits_refuse_it(record):
    X, F = record.to_features(smooth=False)
    with pytest.raises(ChannelError, match="varying"):
        NRFRegressor(degree=1, varying="auto").fit(iter([X]), iter([F]))
    with pytest.raises(ChainError, match="varying"):
        NRFRegressor(degree=1, varying="auto").partial_fit(X, F)


def test_several_records_are_refused(record):
    with pytest.raises(ChainError, match="one record"):
        NRFRegressor(degree=1, varying="auto").fit([record, record])


def test_a_record_without_a_clock_is_refused(record):
    X, F = (np.asarray(table) for table in record.to_features(smooth=False))
    with pytest.raises(ChannelError, match="sampling step"):
        NRFRegressor(degree=1, varying="auto").fit(X, F)


@pytest.mark.parametrize(
    "varying", ["all", {}, {"storey 1": ["s^3"]}, {"storey 7": ["s"]}]
)
def test_what_is_not_in_the_model_is_named(record, varying):
    with pytest.raises(ChainError, match="varying|storey 7"):
        NRFRegressor(degree=1, varying=varying).fit(record)


def test_a_coefficient_that_was_not_followed_is_named(step):
    with pytest.raises(ChainError, match="not followed"):
        step.time_variation_.course(1, "s^3")
