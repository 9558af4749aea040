"""A gain that a floor's sensors share may be a tie of the floor above."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, NRFRegressor, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

MASSES = [10.0, 8.0]
STOREY = [laws.LinearElastic(6e4), laws.LinearViscous(40.0)]


def record_with(more, excited=2):
    """Two floors forced at the top, with something that nobody declared."""
    truth = ChainModel(MASSES, {1: STOREY, 2: STOREY, **more})
    F = excitation.band_limited_random(
        2, 20.0, 200.0, excited=excited, rms=60.0, band=(1, 30), random_state=4
    )
    record = simulate(truth, F, 1 / 200, hold="cubic").replace(velocity=None)
    return add_noise(record, 0.01, random_state=4)


@pytest.mark.parametrize(
    "more",
    [
        {"sensors 1": [laws.GainError(0.13)]},
        {"ground 2": [laws.LinearElastic(7e3), laws.LinearViscous(4.7)]},
    ],
    ids=["gain", "tie"],
)
def test_of_a_gain_and_a_tie_that_are_one_both_are_named(more):
    """k2 (x2 - x1 / g) = (k2 / g) (x2 - x1) + k2 (1 - 1 / g) x2, and so is c2."""
    report = close_loop(record_with(more))
    step = report.steps[0]
    assert step.site == "ground 2" and not step.sure

    instead = [each.place for each in report.alternatives]
    assert "sensors 1" in instead
    assert report.verdict.state == "amber"
    places = {ground.place for ground in report.verdict.grounds}
    assert "sensors 1" in places

    # no interval leaves out what is true
    for name, (low, high) in report.bounds.items():
        if name in ("m1", "m2"):
            true = MASSES[int(name[1:]) - 1]
            assert not np.isfinite([low, high]).all() or low <= true <= high


def test_of_the_gains_of_two_floors_either_is_within_the_intervals():
    """A gain of one floor is the inverse gain of the other, and another scale."""
    gain = {"sensors 1": [laws.GainError(0.15)]}
    report = close_loop(record_with(gain, excited=[1, 2]))
    step = report.steps[0]
    places = {step.site, *[each.place for each in report.alternatives]}
    assert {"sensors 1", "sensors 2"} <= places
    for j, true in enumerate(MASSES, start=1):
        low, high = report.bounds[f"m{j}"]
        assert low <= true <= high


def test_known_masses_on_storeys_without_a_spring_are_searched():
    """No mass and no stiffness is left that an alternative could move."""
    dampers = [laws.LinearViscous(), laws.CubicStiffness()]
    masses = dict(enumerate(MASSES, start=1))
    baseline = NRFRegressor(known_masses=masses, laws={1: dampers, 2: dampers})
    report = close_loop(record_with({}), baseline)
    assert report.verdict.state != "green" or report.steps


def test_a_tie_that_no_gain_imitates_has_no_such_alternative():
    report = close_loop(record_with({"ground 2": [laws.LinearElastic(7e3)]}))
    assert report.steps[0].site == "ground 2"
    assert not [each for each in report.alternatives if "sensors" in each.place]
