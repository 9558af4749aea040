"""Verdicts on fits: nothing wrong is green, nothing right is accused."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import ChainModel, NRFRegressor, Record, excitation, laws, simulate
from pysindy_nrf.diagnosis import Facts, effect_words, verdict_from
from pysindy_nrf.exceptions import SensitivityWarning
from pysindy_nrf.simulation import add_noise


def spring_and_dashpot(k, c=30.0):
    return [laws.LinearViscous(c), laws.LinearElastic(k)]


def shaken(model, seconds=10.0, noise=0.01, seed=2):
    n_dof = len(model.masses)
    F = excitation.band_limited_random(
        n_dof,
        seconds,
        800.0,
        excited=[n_dof],
        rms=90.0,
        band=(1, 60),
        random_state=seed,
    )
    clean = simulate(model, F, 1 / 800, hold="cubic").replace(velocity=None)
    return add_noise(clean, noise, random_state=seed)


def kinds(verdict):
    return {ground.kind for ground in verdict.grounds}


def test_floors_that_move_as_one_are_said_and_no_channel_is_accused():
    """The drift between two floors is a thousandth of the noise of their sensors."""
    storeys = {1: spring_and_dashpot(5e4), 2: spring_and_dashpot(2e9)}
    model = ChainModel([9.0, 7.0], storeys)
    verdict = NRFRegressor(degree=1).fit(shaken(model)).verdict()
    assert verdict.state == "red"
    assert "drift" in kinds(verdict)
    assert not kinds(verdict) & {"wiring", "channel"}


@pytest.mark.parametrize(
    "law, state", [(laws.LinkSpringDashpot, "red"), (laws.LinearElastic, "green")]
)
def test_a_tie_is_no_negative_spring_but_gravity_may_be_one(law, state):
    """A heavy floor on hinged columns pushes away from its rest."""
    storeys = {1: spring_and_dashpot(5e4), 2: spring_and_dashpot(4e4)}
    gravity = {"ground 2": [laws.LinearElastic(-2e3)]}
    record = shaken(ChainModel([9.0, 7.0], storeys | gravity))
    fitted = NRFRegressor(degree=1, laws={"ground 2": [law()]}).fit(record)
    verdict = fitted.verdict()
    assert verdict.state == state
    places = {ground.place for ground in verdict.grounds if ground.kind == "stiffness"}
    assert places == ({"ground 2"} if state == "red" else set())


def test_an_interval_that_says_little_is_not_green():
    model = ChainModel([9.0, 7.0], {i: spring_and_dashpot(3e4) for i in (1, 2)})
    short = shaken(model, noise=0.03).rows(slice(2000, 2090))
    fitted = NRFRegressor(degree=3).fit(short)
    assert fitted.verdict().state != "green"


@pytest.mark.parametrize(
    "low, high, state", [(9.5, 10.5, "green"), (8.0, 12.0, "amber")]
)
def test_a_mass_known_to_a_fifth_only_is_amber(low, high, state):
    facts = Facts(unexplained={1: 1.0}, intervals={"m1": (low, high)})
    assert verdict_from(facts).state == state


def test_errors_without_a_value_are_never_green():
    assert verdict_from(Facts(unexplained={1: np.nan, 2: np.nan})).state == "red"


def test_no_more_than_a_force_is_unexplained():
    verdict = verdict_from(Facts(unexplained={1: 5.07e16}))
    assert verdict.state == "red"
    assert "e+" not in str(verdict)


def test_an_exponential_window_is_red():
    """Windowed responses make the free run miss the motion by most of it."""
    model = ChainModel([9.0, 7.0, 6.0], {i: spring_and_dashpot(4e4) for i in (1, 2, 3)})
    t = np.arange(10000) / 2000
    F = np.zeros((len(t), 3))
    F[200:214, 1] = 400 * np.sin(np.pi * t[:14] / 0.007) ** 2
    clean = simulate(model, F, 1 / 2000, hold="cubic").replace(velocity=None)
    measured = add_noise(clean, 0.005, random_state=0)
    window = np.exp(-t / 0.6)[:, None]
    windowed = measured.replace(
        acceleration=measured.acceleration * window,
        displacement=measured.displacement * window,
    )
    assert NRFRegressor(degree=1).fit(windowed).verdict().state == "red"


@pytest.mark.parametrize("milliseconds", [3.5, 5.0])
def test_blows_that_only_push_accuse_neither_force_nor_channels(milliseconds):
    """Blows of a few samples: no spikes of a line, no gain of a pull that is not."""
    model = ChainModel([9.0, 7.0, 6.0], {i: spring_and_dashpot(4e4) for i in (1, 2, 3)})
    t = np.arange(12 * 6000) / 6000
    width = milliseconds / 1e3
    F = np.zeros((len(t), 3))
    for start in (0.4002, 3.3011, 6.2017, 9.1003):
        hit = (t >= start) & (t < start + width)
        F[hit, 1] = 600 * np.sin(np.pi * (t[hit] - start) / width) ** 2
    clean = simulate(model, F, 1 / 6000).replace(velocity=None)
    every = slice(None, None, 12)
    sampled = clean.replace(
        force=clean.force[every],
        acceleration=clean.acceleration[every],
        displacement=clean.displacement[every],
        fs=500.0,
    )
    record = add_noise(sampled, 0.003, random_state=0)
    verdict = NRFRegressor(degree=1).fit(record).verdict()
    assert not kinds(verdict) & {"quality", "channel", "wiring", "alternative"}
    assert verdict.state != "red"


def test_exchanged_sensors_are_named_though_they_hide_the_drift_between_them():
    """What displacement and acceleration of a floor disagree by is no noise."""
    storeys = {
        1: spring_and_dashpot(9e5, 220.0),
        2: spring_and_dashpot(8e5, 200.0),
        3: [*spring_and_dashpot(7e5, 180.0), laws.CubicStiffness(5e11)],
        4: spring_and_dashpot(5e5, 150.0),
    }
    model = ChainModel([30.0, 28.0, 26.0, 22.0], storeys)

    t = np.arange(0, 40, 1 / 200)
    steps = np.linspace(6, 34, 8)[np.minimum(t / 5, 7).astype(int)]
    F = np.zeros((len(t), 4))
    F[:, 1] = 90 * np.sin(2 * np.pi * np.cumsum(steps) / 200) * np.clip(t / 3, 0, 1)
    clean = simulate(model, F, 1 / 200).replace(velocity=None)
    record = add_noise(clean, 0.005, random_state=0)
    exchanged = record.replace(displacement=record.displacement[:, [0, 2, 1, 3]])

    verdict = NRFRegressor(degree=1).fit(exchanged).verdict()
    assert "x2 and x3 exchanged" in verdict.sentence
    assert "drift" not in kinds(verdict)


def driven_by_one_sine(model, frequency, fs, seconds, seed):
    """Three floors, of which a sine that grows from rest drives the second one."""
    t = np.arange(0, seconds, 1 / fs)
    F = np.zeros((len(t), 3))
    F[:, 1] = 1000 * np.sin(2 * np.pi * frequency * t) * np.clip(t / 3, 0, 1)
    clean = simulate(model, F, 1 / fs).replace(velocity=None)
    return add_noise(clean, 0.005, random_state=seed)


@pytest.mark.parametrize("seed", [0, 9])
def test_one_sine_accuses_no_channel(seed):
    """It leaves a mass negative: noise decides it, and no channel is reversed."""
    storeys = {
        1: spring_and_dashpot(2.2e6, 4000.0),
        2: spring_and_dashpot(1.0e6, 2000.0),
        3: spring_and_dashpot(2.7e6, 4000.0),
    }
    model = ChainModel([1100.0, 870.0, 1040.0], storeys)
    record = driven_by_one_sine(model, 2.2, 256, 40, seed)
    verdict = NRFRegressor(degree=1).fit(record).verdict()
    assert verdict.state == "red"
    assert not kinds(verdict) & {"quality", "channel", "wiring"}


def test_what_errors_of_the_estimate_leave_is_no_other_structure():
    """Floor 3 keeps the error of a force that one sine on floor 2 hardly determines."""
    storeys = {
        1: spring_and_dashpot(2.1e6, 2500.0),
        2: spring_and_dashpot(1.7e6, 2000.0),
        3: spring_and_dashpot(1.2e6, 1500.0),
    }
    truth = ChainModel([1200.0, 1000.0, 800.0], storeys)
    record = driven_by_one_sine(truth, 4.1, 128, 64, seed=3)
    fitted = NRFRegressor(degree=1).fit(record)

    verdict = fitted.verdict()
    assert "interval" in kinds(verdict)
    assert not kinds(verdict) & {"alternative", "residual", "unexplained"}
    table = fitted.confidence_intervals().set_index("parameter")
    # NaN where they are withheld
    masses = table.loc[["m1", "m2", "m3"]]
    assert not (masses["lower"] > truth.masses).any()
    assert not (masses["upper"] < truth.masses).any()


def test_a_chaotic_motion_is_said_and_its_parameters_are_right():
    """Ueda's oscillator: a cubic spring under a cosine (1979), by SciPy."""
    t = np.arange(0.0, 100.0, 0.02)
    F = 7.5 * np.cos(t)

    def rates(time, state):
        force = 7.5 * np.cos(time) - 0.05 * state[1] - state[0] ** 3
        return [state[1], force]

    run = solve_ivp(rates, t[[0, -1]], [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-9)
    x, v = run.y
    a = F - 0.05 * v - x**3
    columns = {"force": F, "acceleration": a, "displacement": x}
    clean = Record(time=t, **{name: y[:, None] for name, y in columns.items()})
    fitted = NRFRegressor(degree=3).fit(add_noise(clean, 0.01, random_state=0))

    verdict = fitted.verdict()
    assert kinds(verdict) == {"sensitivity"}
    assert verdict.state == "amber"
    assert fitted.masses_[0] == pytest.approx(1.0, rel=0.01)
    with pytest.warns(SensitivityWarning, match="% of its motion"):
        fitted.simulate(F[:, None], dt=0.02)
    fitted.simulate(F[:200, None], dt=0.02)  # too short to part


def test_a_harmonic_force_is_named_by_its_amplitude():
    """3 N of the cosine and 4 N of the sine are 5 N, known as well as they are."""
    values = {"A": 3.0, "B": 4.0, "frequency": 2.0}
    intervals = {"A": (2.9, 3.1), "B": (3.9, 4.1)}
    units = {"A": "N", "B": "N"}
    words = effect_words("harmonic_force", "dof 2", values, intervals, units)
    assert words == "harmonic force of 5 N (4.9 to 5.1 N) on floor 2"
