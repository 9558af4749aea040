"""A declared friction that is right is not refined, and a wrong one is found out."""

import pytest

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

LINEAR = [laws.LinearElastic(6e4), laws.LinearViscous(40.0)]
DECLARED = [laws.LinearElastic(), laws.LinearViscous(), laws.CoulombFriction()]


def report_on(laws_there, load, seed):
    """The loop on two floors of which storey 2 is declared to rub."""
    truth = ChainModel([10.0, 8.0], {1: LINEAR, 2: [*LINEAR, *laws_there]})
    if load == "blows":
        options = {"level": 1000.0, "n_hits": 6, "width": 0.03}
        F = excitation.impact_hammer(
            2, 15.0, 200.0, excited=[1, 2], random_state=seed, **options
        )
    else:
        F = excitation.band_limited_random(
            2, 15.0, 200.0, excited=2, rms=60.0, band=(1, 25), random_state=seed
        )
    record = simulate(truth, F, 1 / 200, hold="cubic").replace(velocity=None)
    record = add_noise(record, 0.01, random_state=seed)
    return close_loop(record, NRFRegressor(degree=1, laws={2: DECLARED}))


@pytest.mark.parametrize(("load", "seed"), [("blows", 2), ("random", 1), ("random", 5)])
def test_noise_in_the_rate_makes_no_other_friction_of_a_declared_one(load, seed):
    report = report_on([laws.CoulombFriction(8.0)], load, seed)
    assert report.steps == [] and report.verdict.state == "green"


@pytest.mark.parametrize(
    ("more", "effect_class"),
    [
        ([laws.CoulombFriction(8.0), laws.CubicStiffness(2e9)], "memoryless"),
        ([laws.MaxwellBranch(0.02, [3e4])], "hysteresis"),
    ],
    ids=["cubic", "maxwell"],
)
def test_what_a_declared_friction_misses_is_still_found(more, effect_class):
    report = report_on(more, "random", 3)
    step = report.steps[0]
    assert (step.effect_class, step.site) == (effect_class, "storey 2")
    assert step.confirmed
