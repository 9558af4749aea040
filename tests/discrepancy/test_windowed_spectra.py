"""Windowed spectra: inner products by band, means, bands of a sine."""

import numpy as np
import pytest
from loop_parts import windows_of

from pysindy_nrf.exceptions import ChannelError

N, DT = 6000, 0.01
EDGES = [(0, 3200), (3200, N)]


@pytest.fixture
def windows():
    """Windows of 2 s in two folds."""
    return two_folds(centred=True)


def two_folds(centred):
    return windows_of(N, EDGES, 2.0, DT, centred)


def spectra_of(windows, rows):
    return windows.spectra(lambda _: np.atleast_2d(rows))


def products_by_hand(rows, low, high):
    """Inner products of half-overlapping Hann windows of 200 samples.

    The lines at 0 and at half the rate count twice.
    """
    size, total = 200, np.zeros((len(rows), len(rows)))
    hann = np.sin(np.pi * np.arange(size) / size) ** 2
    for start in range(low, high - size + 1, size // 2):
        y = hann * rows[:, start : start + size] / np.sqrt(0.75)
        at_zero = y.sum(axis=1)
        at_half_the_rate = y @ np.cos(np.pi * np.arange(size))
        total += y @ y.T + np.outer(at_zero, at_zero) / size
        total += np.outer(at_half_the_rate, at_half_the_rate) / size
    return total


def test_bands_hold_the_inner_products_of_the_windowed_rows():
    """Parseval's theorem."""
    rows = np.random.default_rng(0).standard_normal((3, N))
    windows = two_folds(centred=False)
    products = windows.products(spectra_of(windows, rows))
    for fold, (low, high) in enumerate(EDGES):
        by_hand = products_by_hand(rows, low, high)
        np.testing.assert_allclose(products[fold].sum(axis=0), by_hand, rtol=1e-10)


def test_products_of_white_noise_are_those_of_its_samples():
    rows = np.random.default_rng(0).standard_normal((3, N))
    windows = two_folds(centred=False)
    products = windows.products(spectra_of(windows, rows)).sum(axis=(0, 1))
    ratio = np.diag(products) / np.diag(rows @ rows.T)
    assert ratio == pytest.approx(np.ones(3), abs=0.1)


def test_means_are_taken_out_unless_asked_for(windows):
    x = np.random.default_rng(1).standard_normal(N)
    shifted = spectra_of(windows, x + 30.0)
    np.testing.assert_allclose(spectra_of(windows, x), shifted, atol=1e-9)
    assert np.abs(spectra_of(windows, np.ones(N))).max() < 1e-12
    assert np.abs(spectra_of(windows.with_means(), np.ones(N))).max() > 0.1


def test_a_sine_stands_in_its_own_band(windows):
    sine = np.sin(2 * np.pi * 7.0 * np.arange(N) * DT)
    power = windows.products(spectra_of(windows, sine)).sum(axis=0)[:, 0, 0]
    best = int(power.argmax())
    far = np.abs(best - np.arange(len(power))) > 1
    assert windows.edges[best] < 7.0 < windows.edges[best + 1]
    assert power[far].sum() < 1e-6


def test_spectra_that_are_cut_keep_their_bands(windows):
    np.testing.assert_array_equal(windows.up_to(4).edges, windows.edges[:6])


def test_a_band_that_is_given_leaves_no_line_outside():
    """Of 2 and 10 Hz the first leaves nothing between 5 and 20 Hz."""
    t = np.arange(8000) * DT
    slow, fast = np.sin(2 * np.pi * 2.0 * t), 0.01 * np.sin(2 * np.pi * 10.0 * t)
    # the first band ends at 3 Hz
    windows = windows_of(len(t), [(0, len(t))], 0.5)
    within = windows.within(5.0, 20.0)
    assert within.edges[0] == 5.0 and within.edges[-1] <= 20.0

    of_slow, of_fast = ((spectra_of(within, y) ** 2).sum() for y in (slow, fast))
    assert of_slow < 1e-3 * of_fast
    with pytest.raises(ChannelError, match="No spectral line"):
        windows.within(5.1, 5.9)
