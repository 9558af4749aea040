"""Each fault of a channel is found and named; healthy ones are left alone."""

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records import channel_notes, check_channels
from pysindy_nrf.simulation import add_noise


def forces(kind):
    if kind == "random":
        return excitation.band_limited_random(
            2, 8.0, 1000.0, excited=[2], rms=100.0, band=(0.5, 60.0), random_state=0
        )
    return excitation.impact_hammer(
        2, 8.0, 1000.0, excited=[2], level=1000.0, n_hits=4, random_state=0
    )


def two_floors(kind="random", noise=0.01) -> Record:
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    return add_noise(simulate(truth, forces(kind), 1e-3), noise, random_state=1)


@pytest.mark.parametrize("kind", ["random", "hammer"])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_healthy_channels_are_left_alone(kind, noise):
    assert check_channels(two_floors(kind, noise)).empty


def clipped(y):
    return np.clip(y, -0.7 * np.abs(y).max(), np.inf)


def constant(y):
    return np.full(len(y), 0.3)


def stuck(y):
    return np.where(np.arange(len(y)) < 5000, y, y[5000])


def stuck_at_an_end(y):
    return np.where(np.arange(len(y)) < 5000, y, 1.2 * y.max())


def spiky(y):
    y[[700, 3000]] += 30 * y.std()
    return y


def quantised(y):
    return 0.1 * y.std() * np.round(10 * y / y.std())


def interpolated(y):
    rows = np.arange(len(y))
    return np.interp(rows, rows[::4], y[::4])


def with_dropouts(y):
    return np.where(np.arange(len(y)) % 700 < 10, 0.0, y)


def with_hum(y):
    t = np.arange(len(y)) / 1000.0
    return y + 0.1 * y.std() * np.sin(2 * np.pi * 50.0 * t)


FAULTS = [
    ("a1", clipped, "clipped"),
    ("x2", constant, "dead"),
    ("a2", stuck, "dead"),
    ("x2", stuck_at_an_end, "dead"),
    ("a1", spiky, "spikes"),
    ("x1", quantised, "quantised"),
    ("x1", interpolated, "interpolated"),
    ("a2", with_dropouts, "dropouts"),
    ("x2", with_hum, "hum"),
]


def faulty(channel, fault) -> Record:
    record = two_floors()
    key = {"a": "acceleration", "x": "displacement"}[channel[0]]
    array = getattr(record, key).copy()
    column = int(channel[1]) - 1
    array[:, column] = fault(array[:, column])
    return record.replace(**{key: array})


@pytest.mark.parametrize(("channel", "fault", "kind"), FAULTS)
def test_a_fault_is_found_where_it_is(channel, fault, kind):
    record = faulty(channel, fault)
    table = check_channels(record)
    assert table[["channel", "problem"]].to_numpy().tolist() == [[channel, kind]]
    assert channel in table["message"][0]
    notes = channel_notes(record)
    assert (kind, channel) in [(note.kind, note.channel) for note in notes]
    with pytest.warns(DataQualityWarning, match=channel):
        check_channels(record, warn=True)


def test_a_copied_channel_names_the_one_it_is_copied_from():
    record = two_floors()
    (note,) = channel_notes(record.replace(velocity=record.velocity[:, [0, 0]]))[-1:]
    assert (note.kind, note.channel, note.witness) == ("copied", "v2", "v1")


def test_numbers_for_not_measured_are_found_with_their_share():
    record = two_floors()
    force = record.force.copy()
    force[[500, 2000], 1] = -9999.0
    (note,) = channel_notes(record.replace(force=force))
    assert (note.kind, note.channel) == ("filled", "F2")
    assert note.size == pytest.approx(2 / record.n_samples)
    assert "rows 500, 2000" in note.message


def test_shares_count_samples():
    table = check_channels(faulty("a2", stuck))
    assert table["share"][0] == pytest.approx(3000 / 8000, abs=0.01)


def driven_by_a_sine(frequency):
    """Two floors of which the lower one hardens, 8 s in a steady state."""
    hard = [laws.PowerSeries(1, [60.0, 1e5]), laws.CubicStiffness(3e10)]
    soft = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": hard, "storey 2": soft})
    t = np.arange(10_000) / 1000.0
    F = np.zeros((len(t), 2))
    F[:, 1] = 300.0 * np.sin(2 * np.pi * frequency * t)
    steady = simulate(truth, F, 1e-3).rows(slice(2000, 10_000))
    return add_noise(steady, 1e-3, random_state=0)


def test_a_harmonic_of_the_load_is_no_hum():
    """The fifth harmonic of 10 Hz lies at 50 Hz, that of 12 Hz at 60 Hz."""
    for frequency in (10.0, 12.0):
        record = driven_by_a_sine(frequency)
        assert "hum" not in {note.kind for note in channel_notes(record)}


def test_hum_beside_a_sine_is_named():
    record = driven_by_a_sine(11.0)
    displacement = record.displacement.copy()
    displacement[:, 1] = with_hum(displacement[:, 1])
    notes = channel_notes(record.replace(displacement=displacement))
    assert [(note.kind, note.channel) for note in notes] == [("hum", "x2")]


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
    assert "spikes" not in set(check_channels(rec)["problem"])
