"""General laws are grown where something is missing, and judged at other amplitudes."""

import numpy as np
import pytest
from loop_parts import at_other_amplitudes, first_state, grown_at
from simulated_cases import Plan, simulated

from pysindy_nrf import NRFRegressor, Record, Site, close_loop, laws

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


def test_an_effect_that_is_there_holds_at_every_amplitude():
    state = first_state(hidden("cubic"))
    site = Site("storey 2")
    after = state.model.with_laws([(site, laws.CubicStiffness())])
    judged = at_other_amplitudes(state.model, after, [site])
    assert judged.holds and judged.value > 3.0


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
