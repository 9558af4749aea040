"""A balance stays a balance through the zero-phase filter."""

import numpy as np
import pytest
from scipy.signal import butter, sosfreqz

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter

BANDS = [(1.0, 40.0), (None, 40.0), (0, 40.0), (1.0, None), None, (None, None)]


@pytest.mark.parametrize("band", BANDS)
@pytest.mark.parametrize("n", [2, 30, 500, 6000])
def test_exact_balance_holds_to_round_off_edges_included(band, n):
    rng = np.random.default_rng(n)
    s = np.cumsum(rng.normal(size=n)) / 50
    columns = np.column_stack([rng.normal(size=n), s, s**3, np.sign(s), np.abs(s) * s])
    coefficients = np.array([12.4, 1.4e2, 1e3, 20.0, -7.0])
    operator = ZeroPhaseFilter(band, fs=500.0)
    left = operator.apply(columns) @ coefficients
    right = operator.apply(columns @ coefficients)
    largest_term = np.abs(columns * coefficients).max()
    assert np.abs(left - right).max() <= 1e-9 * largest_term


def squared_gain(corner, kind, f, fs):
    """Of a Butterworth filter of order 4 at one frequency."""
    sos = butter(4, corner, kind, fs=fs, output="sos")
    _, response = sosfreqz(sos, [f], fs=fs)
    return np.abs(response[0]) ** 2


@pytest.mark.parametrize("f", [1.5, 5.0, 20.0, 55.0, 80.0])
def test_gain_is_the_squared_butterworth_and_the_phase_is_zero(f):
    fs = 1000.0
    w = 2 * np.pi * f
    t = np.arange(20000) / fs
    operator = ZeroPhaseFilter((2.0, 60.0), fs)
    inside = slice(operator.edge, -operator.edge)
    filtered = operator.apply(np.sin(w * t))[inside]

    basis = np.column_stack([np.sin(w * t), np.cos(w * t)])[inside]
    in_phase, quadrature = np.linalg.lstsq(basis, filtered, rcond=None)[0]
    expected = squared_gain(60.0, "low", f, fs) * squared_gain(2.0, "high", f, fs)
    assert in_phase == pytest.approx(expected, abs=1e-3)
    assert quadrature == pytest.approx(0.0, abs=1e-3)


def test_unmeasured_columns_stay_nan():
    values = np.random.default_rng(0).normal(size=(1000, 3))
    values[:, 1] = np.nan
    filtered = ZeroPhaseFilter((None, 20.0), 100.0).apply(values)
    assert np.isnan(filtered[:, 1]).all()
    assert np.isfinite(filtered[:, [0, 2]]).all()


def test_holes_are_refused():
    values = np.random.default_rng(0).normal(size=(1000, 3))
    values[7, 2] = np.nan
    with pytest.raises(ChannelError, match="Column 3 .* row 7"):
        ZeroPhaseFilter((None, 20.0), 100.0).apply(values)


@pytest.mark.parametrize(
    ("band", "words"),
    [
        ((None, 50.0), "Nyquist"),
        ((60.0, None), "Nyquist"),
        ((20.0, 10.0), "empty"),
        ((10.0, 10.0), "empty"),
        ((-1.0, 10.0), "impossible"),
        ((np.nan, 10.0), "impossible"),
        (5.0, "pair"),
        ((1, 2, 3), "pair"),
        (("a", 2), "pair"),
    ],
)
def test_impossible_bands_are_refused(band, words):
    with pytest.raises(ChannelError, match=words):
        ZeroPhaseFilter(band, fs=100.0)


@pytest.mark.parametrize("order", [0, -1, 2.5, True])
def test_impossible_orders_are_refused(order):
    with pytest.raises(ChannelError, match="order"):
        ZeroPhaseFilter((None, 10.0), 100.0, order)


@pytest.mark.parametrize("fs", [0.0, -5.0, np.nan])
def test_impossible_rates_are_refused(fs):
    with pytest.raises(ChannelError, match="sampling rate"):
        ZeroPhaseFilter((None, 10.0), fs)


@pytest.mark.parametrize("band", [(None, 30.0), (1.0, 60.0), None])
def test_the_noise_gain_is_the_energy_of_the_impulse_response(band):
    operator = ZeroPhaseFilter(band, 500.0)
    impulse = np.zeros(20001)
    impulse[10000] = 1.0
    energy = (operator.apply(impulse) ** 2).sum()
    assert operator.noise_gain() == pytest.approx(energy, rel=1e-3)
