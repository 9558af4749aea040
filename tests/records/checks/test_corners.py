"""Accelerations behind a high-pass filter of first order, as ICP amplifiers have."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.records.checks.alignment import channel_alignment
from pysindy_nrf.records.checks.channel_checks import channel_notes
from pysindy_nrf.records.checks.corners import before_filter, without_corners
from pysindy_nrf.simulation import add_noise

FS = 250.0


def two_floors(seed=4):
    """Half a minute of two floors with modes at 2.5 and 6.6 Hz."""
    storey = [laws.LinearElastic(6e4), laws.LinearViscous(60.0)]
    truth = ChainModel([100.0, 80.0], {1: storey, 2: storey})
    F = excitation.band_limited_random(
        2, 30.0, FS, excited=[2], rms=50.0, band=(0.8, 25), random_state=seed
    )
    return simulate(truth, F, 1 / FS, hold="cubic").replace(velocity=None)


def filtered(values, corner):
    return sosfilt(butter(1, corner, "high", fs=FS, output="sos"), values, axis=0)


@pytest.mark.parametrize("corner", [0.3, 0.8])
def test_the_corner_of_an_accelerometer_is_found_beside_a_displacement(corner):
    clean = two_floors()
    record = clean.replace(acceleration=filtered(clean.acceleration, corner))
    notes = channel_notes(add_noise(record, 0.01, random_state=1))

    assert [note.kind for note in notes] == ["corner", "corner"]
    assert [note.channel for note in notes] == ["a1", "a2"]
    assert [note.witness for note in notes] == ["x1", "x2"]
    assert [note.size for note in notes] == pytest.approx([corner] * 2, rel=0.05)


def test_the_corner_of_a_displacement_is_that_of_the_displacement():
    clean = two_floors()
    record = clean.replace(displacement=filtered(clean.displacement, 0.5))
    notes = channel_notes(add_noise(record, 0.01, random_state=1))

    kinds = {(note.kind, note.channel, note.witness) for note in notes}
    assert kinds == {("corner", "x1", "a1"), ("corner", "x2", "a2")}
    assert without_corners(record, notes).acceleration is not None


@pytest.mark.parametrize("noise", [0.001, 0.01, 0.1])
def test_clean_channels_have_no_corner(noise):
    table = channel_alignment(add_noise(two_floors(7), noise, random_state=2))
    assert table["corner"].isna().all()


def test_a_late_channel_has_no_corner():
    clean = two_floors()
    late = clean.replace(displacement=np.roll(clean.displacement, 3, axis=0))
    table = channel_alignment(late)

    assert table["corner"].isna().all()
    assert table["samples"].tolist() == pytest.approx([3.0, 3.0], abs=0.05)


def test_the_signal_before_a_filter_follows_from_the_one_behind_it():
    t = np.arange(8000) / FS
    signal = np.sin(2 * np.pi * 0.7 * t) + 0.5 * np.cos(2 * np.pi * 3.1 * t)
    before = before_filter(filtered(signal, 0.4), 0.4, 1 / FS)

    settled = slice(1000, -1000)
    assert before[settled] == pytest.approx(signal[settled], abs=0.02)


def test_a_signal_keeps_its_gaps():
    behind = np.array([np.nan, 1.0, -1.0, 0.5, -0.5, np.nan])
    before = before_filter(behind, 0.5, 0.01)
    assert np.isnan(before).tolist() == np.isnan(behind).tolist()


def test_accelerations_alone_have_no_witness():
    a = filtered(two_floors().acceleration, 0.5)
    assert not channel_notes(Record(force=None, acceleration=a, fs=FS))
