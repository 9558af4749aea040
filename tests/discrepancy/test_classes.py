"""General laws are grown where something is missing, and judged at other amplitudes."""

import numpy as np
import pytest
from loop_parts import OtherCondition, at_other_amplitudes, first_state, grown_at
from simulated_cases import Plan, simulated

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    Site,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.simulation.noise import add_noise

STOREYS = ("storey 1", "storey 2", "storey 3")


def hidden(kind, share=0.12, noise=0.01):
    """Three forced floors with an effect in storey 2."""
    effects = ((kind, 2, 1, share),) if kind else ()
    return Plan(3, (1, 2, 3), noise=noise, effects=effects, seed=72)


@pytest.mark.parametrize(
    ("kind", "effect_class"),
    [
        ("coulomb", "memoryless"),
        ("cubic", "memoryless"),
        ("two_sided_gap", "memoryless"),
        ("bouc_wen", "hysteresis"),
    ],
)
def test_the_general_law_of_its_class_explains_an_effect_where_it_is(
    kind, effect_class
):
    state = first_state(hidden(kind))
    gains = {site: grown_at(state, effect_class, site)[1] for site in STOREYS}
    assert gains["storey 2"] > 3.0
    assert gains["storey 2"] > 5.0 * max(gains["storey 1"], gains["storey 3"])


@pytest.mark.parametrize("effect_class", ["memoryless", "hysteresis"])
def test_where_nothing_is_missing_no_general_law_gains(effect_class):
    state = first_state(hidden(None, noise=0.05))
    for site in STOREYS:
        assert grown_at(state, effect_class, site)[1] < 0.5


def test_amplitude_speaks_where_it_is_sure_of_little():
    assert OtherCondition(0.1, 0.4).is_below(1.0)
    assert not OtherCondition(0.1, 0.5).is_below(1.0)
    assert not OtherCondition(0.0, np.inf).is_below(1.0)


def test_an_effect_that_is_there_holds_at_every_amplitude():
    state = first_state(hidden("cubic"))
    site = Site("storey 2")
    after = state.model.with_laws([(site, laws.CubicStiffness())])
    judged = at_other_amplitudes(state.model, after, [site])
    assert judged.exceeds(3.0, errors=2.0)


def test_an_effect_that_is_not_there_does_not_hold():
    state = first_state(hidden(None))
    site = Site("storey 2")
    after = state.model.with_laws([(site, laws.CubicStiffness())])
    judged = at_other_amplitudes(state.model, after, [site])
    assert judged.value < 0.2


def two_strengths(n_samples=6000, fs=200.0):
    """A slider of 900 N one way and 1,500 N the other behind a backlash of 1 mm."""
    t = np.arange(n_samples) / fs
    x = 0.01 * np.sin(2 * np.pi * 0.5 * t) * (0.6 + 0.4 * np.sin(2 * np.pi * 0.05 * t))
    reach, gap, uy = 1.5e-3, 1e-3, 0.5e-3
    state, force = 0.0, np.zeros(n_samples)
    for i in range(1, n_samples):
        state = np.clip(state + x[i] - x[i - 1], -reach, reach)
        share = min(max((abs(state) - gap) / uy, 0.0), 1.0)
        force[i] = share * (900.0 if state > 0 else -1500.0)
    noise = 10.0 * np.random.default_rng(0).standard_normal(n_samples)
    return Record(force=force + noise, displacement=x, fs=fs)


def test_two_strengths_are_one_hysteresis_and_no_constant_force():
    report = close_loop(two_strengths(), NRFRegressor(degree=1, massless=True))
    confirmed = [step for step in report.steps if step.confirmed]
    assert [step.effect_class for step in confirmed] == ["hysteresis"]
    parameters = confirmed[0].parameters
    assert parameters["Fyp"] == pytest.approx(900.0, rel=0.01)
    assert parameters["Fym"] == pytest.approx(1500.0, rel=0.01)
    assert parameters["gap"] == pytest.approx(1e-3, rel=0.01)


def test_one_class_at_a_site_is_claimed_once():
    channels = simulated(hidden("quintic", share=0.2)).channels
    report = close_loop(
        Record(**channels), catalogue=[laws.CubicStiffness(), laws.TwoSidedGap()]
    )
    claimed = [(s.effect_class, s.site) for s in report.steps if s.confirmed]
    assert claimed == [("memoryless", "storey 2")]


@pytest.mark.parametrize(
    "law",
    [
        laws.GeneralCurve([("hinge", 2e-3, 1), ("sign", 0.01, -1)], [4e4, 20.0]),
        laws.GeneralHysteresis(
            [("slider", 1e-3, 4e-4, 1), ("branch", 0.2), ("pinched", 1e-3, 2e-3)],
            [900.0, 5e3, 100.0],
        ),
    ],
)
def test_a_general_law_comes_back_from_plain_data(law):
    again = laws.from_dict(law.to_dict())
    t = np.linspace(0.0, 4.0, 800)
    drift = 5e-3 * np.sin(2 * np.pi * t)
    motion = laws.Motion(drift, np.gradient(drift, t), t=t)
    assert again == law
    assert again.force(motion) == pytest.approx(law.force(motion))


def forced_chain(*missing, extra=None, noise=0.01):
    """Three linear floors, the third one shaken, with laws that nobody declared."""
    linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    storeys = {1: [*linear, *missing], 2: linear, 3: linear}
    F = excitation.band_limited_random(
        3, 20.0, 500.0, excited=3, rms=60.0, band=(0.5, 40.0), random_state=1
    )
    hidden = np.zeros_like(F) if extra is None else extra(np.arange(len(F)) / 500.0)
    record = simulate(ChainModel([10.0] * 3, storeys), F + hidden, 1 / 500)
    return add_noise(record.replace(force=F), noise, random_state=0)


def test_the_only_law_of_a_catalogue_is_the_name_where_noise_alone_bends_it():
    record = forced_chain(laws.CoulombFriction(20.0), noise=0.05)
    report = close_loop(record, catalogue=[laws.CoulombFriction()])
    (step,) = report.steps
    assert (step.law, step.site, step.carries) == ("coulomb_friction", "storey 1", True)
    assert step.parameters["Fc"] == pytest.approx(20.0, rel=0.05)


def test_two_harmonic_forces_on_one_floor_are_two_effects():
    amplitudes = {9.3: 20.0, 14.7: 14.0}

    def on_floor_2(t):
        force = np.zeros((len(t), 3))
        for frequency, size in amplitudes.items():
            force[:, 1] += size * np.sin(2 * np.pi * frequency * t)
        return force

    sizes = {}
    for step in close_loop(forced_chain(extra=on_floor_2)).steps:
        assert (step.law, step.site) == ("harmonic_force", "dof 2")
        size = np.hypot(step.parameters["A"], step.parameters["B"])
        sizes[round(step.parameters["frequency"], 1)] = size
    assert sizes == pytest.approx(amplitudes, rel=0.05)


def test_a_spring_that_softens_beyond_a_drift_is_named():
    record = forced_chain(laws.SofteningKnee(8e-4, [5e4]))
    (step,) = close_loop(record).steps
    assert (step.law, step.site) == ("softening_knee", "storey 1")
    assert step.parameters == pytest.approx({"u": 8e-4, "dk": 5e4}, rel=0.01)


@pytest.mark.parametrize(
    ("n_floors", "excited", "noise", "within"),
    [(3, 1, 0.0, 1e-3), (3, [1, 2, 3], 0.005, 0.1), (5, 1, 0.002, 0.1)],
)
def test_damping_by_mass_is_a_dashpot_from_every_floor_to_the_ground(
    n_floors, excited, noise, within
):
    """Rayleigh damping of 0.8 / s on floors of 10 kg."""
    linear = [laws.LinearElastic(1e5), laws.LinearViscous(60.0)]
    expected = {f"ground {j}": 8.0 for j in range(2, n_floors + 1)}
    links = {j: linear for j in range(1, n_floors + 1)}
    links |= {site: [laws.GroundDashpot([c])] for site, c in expected.items()}
    truth = ChainModel([10.0] * n_floors, links)
    F = excitation.band_limited_random(
        n_floors, 20.0, 500.0, excited=excited, rms=60.0, band=(0.5, 40), random_state=3
    )
    record = add_noise(simulate(truth, F, 1 / 500), noise, random_state=3)
    report = close_loop(record)
    dashpots = {step.site: step.parameters.get("c") for step in report.steps}
    assert dashpots == pytest.approx(expected, rel=within)


def test_a_rest_before_the_motion_hides_nothing():
    """The motion lasts a twentieth of the record."""
    clock = np.arange(440) / 20.0
    x = 0.02 * (1 + clock / 22.0) * np.sin(2 * np.pi * clock / 5.5)
    force = 4e4 * x + 8e6 * x**3
    noise = np.random.default_rng(0).standard_normal((2, 8800))
    signals = [np.concatenate([np.zeros(8360), y]) for y in (x, force)]
    x, force = (y + 1e-4 * abs(y).max() * e for y, e in zip(signals, noise))
    step = close_loop(Record(displacement=x, force=force)).steps[0]
    assert (step.effect_class, step.site) == ("memoryless", "storey 1")


def two_floors(extra, force, seed):
    """Two floors of 10 kg on alike storeys with laws that nobody declared."""
    linear = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
    by_site = {"storey 1": linear, "storey 2": linear}
    for site, law in extra.items():
        by_site[site] = [*by_site.get(site, ()), law]
    record = simulate(ChainModel([10.0, 10.0], by_site), force, 1 / 400)
    return add_noise(record.replace(name=f"test {seed}"), 0.01, random_state=seed)


def test_in_a_narrow_band_a_dashpot_and_a_damped_oscillator_are_one_force():
    """Another record of the same band refutes neither."""
    dashpot = {"ground 2": laws.LinkSpringDashpot(k=0.0, c=40.0)}
    records = []
    for seed in (1, 2):
        F = excitation.band_limited_random(
            2, 10.0, 400.0, excited=2, rms=60.0, band=(8, 12), random_state=seed
        )
        records.append(two_floors(dashpot, F, seed))
    tried = [laws.GroundDashpot(), laws.HiddenOscillator()]
    (step,) = close_loop(records[0], catalogue=tried, heldout=records[1]).steps
    assert (step.law, step.site) == ("ground_dashpot", "ground 2")
    assert step.confirmed and not step.sure
    assert [rival[:2] for rival in step.rivals] == [("hidden_oscillator", "dof 2")]


def test_two_sines_make_no_wrong_name_sure():
    """A cubic spring below the forced floor; each record has one frequency."""
    t = np.arange(4000) / 400.0
    records = []
    for seed, frequency, size in ((1, 8.0, 60.0), (2, 11.0, 80.0)):
        F = np.zeros((4000, 2))
        ramp = np.clip(t * frequency / 5.0, 0.0, 1.0)
        F[:, 0] = size * ramp * np.sin(2 * np.pi * frequency * t)
        records.append(two_floors({"storey 1": laws.CubicStiffness(3e9)}, F, seed))
    report = close_loop(records[0], heldout=records[1])
    sure = {step.law for step in report.steps if step.confirmed and step.sure}
    assert sure <= {"cubic_stiffness"}


def test_one_line_matters_beside_what_is_at_its_frequency():
    """A harmonic force of 0.7 % of the random forces (rms), which no sensor makes."""
    linear = [laws.LinearElastic(4e4), laws.LinearViscous(60.0)]
    storeys = dict.fromkeys((1, 2, 3), linear)
    hum = {"dof 2": [laws.HarmonicForce(12.0, A=1.0, B=0.0)]}
    F = excitation.band_limited_random(
        3, 30.0, 200.0, excited=[1, 2, 3], rms=100.0, band=(1, 40), random_state=4
    )
    run = simulate(ChainModel([10.0] * 3, {**storeys, **hum}), F, 1 / 200)
    report = close_loop(add_noise(run, 0.002, random_state=5))

    (step,) = report.steps
    assert (step.effect_class, step.site) == ("outside force", "dof 2")
    assert step.confirmed
    assert step.parameters["frequency"] == pytest.approx(12.0, rel=1e-3)
    amplitude = np.hypot(step.parameters["A"], step.parameters["B"])
    assert amplitude == pytest.approx(1.0, rel=0.05)
