"""Each fault is found and named; healthy channels, hammers and rests are left alone."""

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records.checks.channel_checks import check_channels
from pysindy_nrf.simulation.noise import add_noise


def record(force: str = "random", noise: float = 0.01):
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    if force == "random":
        F = excitation.band_limited_random(
            2, 8.0, 1000.0, excited=[2], rms=100.0, band=(0.5, 60.0), random_state=0
        )
    else:
        F = excitation.impact_hammer(
            2, 8.0, 1000.0, excited=[2], level=1000.0, n_hits=4, random_state=0
        )
    return add_noise(simulate(truth, F, 1e-3), noise, random_state=1)


@pytest.mark.parametrize("force", ["random", "hammer"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_healthy_channels_are_left_alone(force, noise):
    assert check_channels(record(force, noise)).empty


FAULTS = {  # channel, and what becomes of it
    "clipped": ("a1", lambda y: np.clip(y, -0.7 * np.abs(y).max(), np.inf)),
    "dead": ("x2", lambda y: np.full(len(y), 0.3)),
    "dead on the way": ("a2", lambda y: np.where(np.arange(len(y)) < 5000, y, y[5000])),
    "dead at the end of its range": (
        "x2",
        lambda y: np.where(np.arange(len(y)) < 5000, y, 1.2 * y.max()),
    ),
    "spikes": (
        "a1",
        lambda y: y + 30 * y.std() * np.isin(np.arange(len(y)), [700, 3000]),
    ),
    "quantised": ("x1", lambda y: 0.1 * y.std() * np.round(10 * y / y.std())),
}


def faulty(fault: str):
    rec = record()
    if fault == "copied":
        return rec.replace(velocity=rec.velocity[:, [0, 0]])
    name, change = FAULTS[fault]
    key = {"a": "acceleration", "x": "displacement"}[name[0]]
    array = getattr(rec, key).copy()
    array[:, int(name[1]) - 1] = change(array[:, int(name[1]) - 1])
    return rec.replace(**{key: array})


@pytest.mark.parametrize("fault", [*FAULTS, "copied"])
def test_a_fault_is_found_where_it_is(fault):
    channel = FAULTS[fault][0] if fault in FAULTS else "v2"
    table = check_channels(faulty(fault))
    assert table[["channel", "problem"]].values.tolist() == [
        [channel, fault.split()[0]]
    ]
    assert channel in table["message"][0]
    with pytest.warns(DataQualityWarning, match=channel):
        check_channels(faulty(fault), warn=True)


def test_shares_count_samples():
    table = check_channels(faulty("dead on the way"))
    assert table["share"][0] == pytest.approx(3000 / 8000, abs=0.01)


def test_the_jumps_of_dry_friction_are_no_spikes():
    """The acceleration of a mass that sticks and slips jumps by 2 Fc / m at every
    turn.
    """
    storey = [
        laws.LinearElastic(2e5),
        laws.LinearViscous(50.0),
        laws.CoulombFriction(18.0),
    ]
    truth = ChainModel([4.0, 12.0], {1: storey, 2: storey})
    rec = driven(truth, [1], 8.0, 1000.0, 100.0, (0.5, 120.0), seed=15)
    assert np.abs(np.diff(rec.acceleration[:, 0])).max() > 3.0
    assert not len(check_channels(rec, warn=False).query("problem == 'spikes'"))
