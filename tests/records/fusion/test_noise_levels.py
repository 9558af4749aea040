"""Levels of noise against noise that was added."""

import numpy as np
import pytest

from pysindy_nrf import Record
from pysindy_nrf.records import (
    denoised,
    levels_of,
    noisy_base,
    quiet_drive,
    quiet_level,
    white_level,
)


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def tones(n):
    """Some forty sines from 3 to 60 Hz at 500 Hz, each of amplitude one."""
    t = np.arange(n) / 500
    return sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(3.0, 60.0, 0.77))


@pytest.fixture
def blows():
    """Ten blows in 40 s, and noise of 0.5."""
    force = np.where(np.arange(20000) % 2000 < 20, 50.0, 0.0)
    return force + 0.5 * noise(20000)


@pytest.mark.parametrize("level", [0.1, 0.7])
def test_noise_is_read_at_quiet_frequencies(level):
    force = tones(20000) + level * noise(20000)
    assert quiet_level(force, 500.0) == pytest.approx(level, rel=0.05)
    force[7] += 99.0
    assert quiet_level(force, 500.0) > 0


@pytest.mark.parametrize("gap", [slice(0, 0), slice(3000, 3100)])
def test_noise_is_read_at_quiet_times(blows, gap):
    blows[gap] = np.nan
    assert quiet_level(blows, 500.0) == pytest.approx(0.5, rel=0.03)


def test_rows_that_are_left_out_add_no_noise():
    rows = np.ones(8000, dtype=bool)
    for start in (900, 2700, 4300, 6100):
        rows[start : start + 500] = False
    force = 50 * tones(8000) + 0.1 * noise(8000)
    assert quiet_level(force, 500.0, rows) == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("order", [4, 10])
def test_white_noise_explains_differences_of_any_order(order):
    slow = np.sin(np.arange(20000) / 500)
    level = white_level(slow + 0.2 * noise(20000), order)
    assert level == pytest.approx(0.2, rel=0.03)


def test_wieners_filter_takes_twice_the_noise_off():
    n, fs, level = 2**14, 100.0, 0.2
    pure = 3 * np.cos(2 * np.pi * 1638 * np.arange(n) / n)
    clean = denoised(pure + level * noise(n), level, fs)
    assert np.std(clean - pure) < 0.4 * level
    assert np.std(clean) == pytest.approx(3 / np.sqrt(2), rel=0.01)

    # noise of four times the variance: the gain is 1 - 2/4 on average
    loud = 2 * level * noise(n, 1)
    half = denoised(loud, level, fs)
    assert loud @ half / (loud @ loud) == pytest.approx(0.5, abs=0.03)


def test_a_signal_without_noise_or_with_holes_stays_as_it_is():
    y = noise(2000)
    holes = np.where(np.arange(2000) == 5, np.nan, y)
    assert denoised(y, 0.0, 100.0) is y
    assert denoised(holes, 0.2, 100.0) is holes


@pytest.fixture
def shaken():
    """A floor on a base that shakes at 7 Hz; noise of 0.3 on the base, 0.5 on both."""
    t = np.arange(20000) / 500
    ag = 5 * np.sin(2 * np.pi * 7 * t) + 0.3 * noise(20000, 1)
    a = 20 * np.sin(2 * np.pi * 7 * t) + 0.4 * noise(20000, 2)
    return Record(acceleration=a, base_acceleration=ag, fs=500.0)


def test_noise_of_the_base_is_taken_off_that_of_the_floors(shaken):
    """0.4^2 = 0.5^2 - 0.3^2"""
    levels = levels_of(shaken, {"a1": 0.5})
    assert levels["ag"] == pytest.approx(0.3, rel=0.05)
    assert levels["a1"] == pytest.approx(0.4, rel=0.05)


def test_a_quiet_drive_gets_fresh_noise(shaken):
    levels = {"ag": 0.3}
    quiet = quiet_drive(shaken, levels)
    assert quiet_level(quiet.base_acceleration, 500.0) < 0.1
    again = noisy_base(quiet, levels, np.random.default_rng(0))["base_acceleration"]
    assert np.std(again - quiet.base_acceleration) == pytest.approx(0.3, rel=0.03)
