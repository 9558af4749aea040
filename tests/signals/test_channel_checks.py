"""Each fault is found and named; healthy channels, hammers and rests are left alone."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, excitation, laws, simulate
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.signals.channel_checks import check_channels
from pysindy_nrf.simulation.noise import add_noise


def record(force: str = "random", noise: float = 0.01):
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    if force == "random":
        F = excitation.band_limited_random(2, 8.0, 1000.0, dofs=[2], rms=100.0, band=(0.5, 60.0), random_state=0)
    else:
        F = excitation.impact_hammer(2, 8.0, 1000.0, dofs=[2], level=1000.0, n_hits=4, random_state=0)
    return add_noise(simulate(truth, F, 1e-3), noise, random_state=1)


@pytest.mark.parametrize("force", ["random", "hammer"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_healthy_channels_are_left_alone(force, noise):
    assert check_channels(record(force, noise)).empty


def faulty(fault: str):
    rec = record()
    a, v, x = (np.array(y) for y in (rec.acceleration, rec.velocity, rec.displacement))
    if fault == "clipped":
        a[:, 0] = np.clip(a[:, 0], -0.7 * np.abs(a[:, 0]).max(), np.inf)
    elif fault == "dead":
        x[:, 1] = 0.3
    elif fault == "dead on the way":
        a[5000:, 1] = a[5000, 1]
    elif fault == "spiky":
        a[[700, 3000], 0] += 30 * a[:, 0].std()
    elif fault == "quantised":
        step = 0.1 * x[:, 0].std()
        x[:, 0] = step * np.round(x[:, 0] / step)
    elif fault == "copied":
        v[:, 1] = v[:, 0]
    return rec.replace(acceleration=a, velocity=v, displacement=x)


@pytest.mark.parametrize(
    ("fault", "channel"),
    [
        ("clipped", "a1"),
        ("dead", "x2"),
        ("dead on the way", "a2"),
        ("spiky", "a1"),
        ("quantised", "x1"),
        ("copied", "v2"),
    ],
)
def test_a_fault_is_found_where_it_is(fault, channel):
    table = check_channels(faulty(fault))
    assert table[["channel", "problem"]].values.tolist() == [[channel, fault.split()[0]]]
    assert channel in table["message"][0]
    with pytest.warns(DataQualityWarning, match=channel):
        check_channels(faulty(fault), warn=True)


def test_shares_count_samples():
    table = check_channels(faulty("dead on the way"))
    assert table["share"][0] == pytest.approx(3000 / 8000, abs=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_channels(record(), warn=True)


def test_the_jumps_of_dry_friction_are_no_spikes():
    """The acceleration of a mass that sticks and slips jumps by 2 Fc / m at every turn."""
    storey = [laws.LinearElastic(2e5), laws.LinearViscous(50.0), laws.CoulombFriction(18.0)]
    truth = ChainModel([4.0, 12.0], {1: storey, 2: storey})
    rec = driven(truth, [1], 8.0, 1000.0, 100.0, (0.5, 120.0), seed=15)
    assert np.abs(np.diff(rec.acceleration[:, 0])).max() > 3.0
    assert not len(check_channels(rec, warn=False).query("problem == 'spiky'"))
