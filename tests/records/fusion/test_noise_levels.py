"""Levels of noise against noise that was added."""

import numpy as np
import pytest

from pysindy_nrf.records.fusion import noise_levels


def noise(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def test_noise_is_read_where_the_signal_is_quiet_in_frequency_or_time():
    t = np.arange(20000) / 500
    force = sum(np.sin(2 * np.pi * f * t + f**2) for f in np.arange(3.0, 60.0, 0.77))
    for level in (0.1, 0.7):
        assert noise_levels.quiet_level(
            force + level * noise(20000), 500.0
        ) == pytest.approx(level, rel=0.05)
        assert (
            noise_levels.quiet_level(
                force + level * noise(20000) + 99 * np.eye(1, 20000, 7)[0], 1.0
            )
            > 0
        )
    blows = np.where(np.arange(20000) % 2000 < 20, 50.0, 0.0)
    assert noise_levels.quiet_level(blows + 0.5 * noise(20000), 500.0) == pytest.approx(
        0.5, rel=0.03
    )
    with_gaps = blows + 0.5 * noise(20000)
    with_gaps[3000:3100] = np.nan
    assert noise_levels.quiet_level(with_gaps, 500.0) == pytest.approx(0.5, rel=0.03)


def test_rows_that_are_left_out_add_no_noise():
    t = np.arange(8000) / 500
    force = sum(
        50 * np.sin(2 * np.pi * f * t + f**2) for f in np.arange(3.0, 60.0, 0.77)
    )
    kept = np.ones(8000, dtype=bool)
    for start in (900, 2700, 4300, 6100):
        kept[start : start + 500] = False
    assert noise_levels.quiet_level(
        force + 0.1 * noise(8000), 500.0, kept
    ) == pytest.approx(0.1, rel=0.1)


def test_wieners_filter_takes_twice_the_noise_off():
    n, fs, level = 2**14, 100.0, 0.2
    t = np.arange(n) / fs
    pure = 3 * np.cos(2 * np.pi * 1638 / n * fs * t)
    found = noise_levels.denoised(pure + level * noise(n), level, fs)
    assert np.std(found - pure) < 0.4 * level and np.std(found) == pytest.approx(
        3 / np.sqrt(2), rel=0.01
    )
    # noise of four times the variance: the gain is 1 - 2/4 on average
    loud = 2 * level * noise(n, 1)
    half = noise_levels.denoised(loud, level, fs)
    assert (
        loud @ half / (loud @ loud) == pytest.approx(0.5, abs=0.03)
        and half.std() < loud.std()
    )
    assert noise_levels.denoised(loud, 0.0, fs) is loud
    holes = np.where(np.arange(n) == 5, np.nan, loud)
    assert noise_levels.denoised(holes, level, fs) is holes
