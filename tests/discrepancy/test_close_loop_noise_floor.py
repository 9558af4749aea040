"""The loop measures what is left against a floor from its surrogates, from repeated records, or from the user."""

import numpy as np
import pytest

from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
from pysindy_nrf.discrepancy.residual import NoiseFloor
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.simulation.noise import add_noise

LINEAR = [laws.LinearElastic(1e5), laws.LinearViscous(100.0)]
CATALOGUE = [laws.CoulombFriction(), laws.QuadraticDamping(), laws.CubicStiffness()]
NOISE = 5.0


def repetitions(count):
    """The same test several times; all that differs is white noise of 5 N in the force on the top mass."""
    truth = ChainModel([10.0, 10.0], {"storey 1": [*LINEAR, laws.CubicStiffness(1e9)], "storey 2": LINEAR})
    F = excitation.band_limited_random(2, 6.0, 500.0, dofs=2, rms=100.0, band=(1, 60), random_state=0)
    clean = simulate(truth, F, 1 / 500.0)
    level = NOISE / np.sqrt(np.mean(clean.force[:, 1] ** 2))
    return [add_noise(clean, level, random_state=seed, channels=["F2"]) for seed in range(count)]


def test_repeated_records_tell_the_noise_and_the_loop_stops_at_it():
    report = close_loop(repetitions(4), catalogue=CATALOGUE, noise_floor="repeats", n_surrogates=1)
    assert [(s.law, s.site) for s in report.steps] == [("cubic_stiffness", "storey 1")]
    assert report.evidence[0].floor.balance[1] == pytest.approx(NOISE, rel=0.05)  # beside the spring that is missing
    assert report.evidence[0].floor.balance[0] < 0.01 * NOISE  # no channel of DOF 1 is noisy
    assert "no more than noise (repeated records)" in report.stopped_because
    assert report.steps[0].noise_floor == pytest.approx(report.steps[0].validation_after, rel=0.15)


def test_a_residual_below_the_floor_of_the_user_is_left_alone():
    records = repetitions(1)
    told = close_loop(records, catalogue=CATALOGUE, noise_floor={1: 200.0, 2: 200.0}, n_surrogates=0)
    assert told.steps == [] and "given by the user" in told.stopped_because
    assert told.settings["loop"]["noise floor"] == "given by the user"
    free = close_loop(records, catalogue=CATALOGUE, noise_floor=NoiseFloor.given([1.0, NOISE], 2), n_surrogates=0)
    assert free.steps[0].law == "cubic_stiffness"
    # without a surrogate the floor would not be known
    assert np.isfinite(free.steps[0].noise_floor) and free.evidence[0].floor.balance[1] == NOISE


@pytest.mark.parametrize(
    ("noise_floor", "said"),
    [
        ("loud", "noise_floor='loud'"),
        ("repeats", "1 record with"),
        ({7: 1.0}, "balance 7"),
        ([1.0, 2.0, 3.0], "3 noise levels for 2 balances"),
        (-1.0, "negative"),
        (NoiseFloor.given(1.0, 3), "3 balances, the chain 2"),
    ],
)
def test_a_floor_that_does_not_fit_is_refused(noise_floor, said):
    with pytest.raises(ChannelError, match=said):
        close_loop(repetitions(1), catalogue=CATALOGUE, noise_floor=noise_floor, n_surrogates=0)


def test_other_tests_are_no_repetitions():
    one, two = repetitions(2)
    with pytest.raises(ChannelError, match="not excited alike"):
        close_loop([one, two.replace(force=-two.force)], catalogue=CATALOGUE, noise_floor="repeats", n_surrogates=0)
