"""A balance stays a balance through a zero-phase filter."""

import numpy as np
import pytest
from scipy.signal import butter, sosfreqz

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import ZeroPhaseFilter

BANDS = [(1.0, 40.0), (None, 40.0), (0, 40.0), (1.0, None), None, (None, None)]


@pytest.mark.parametrize("band", BANDS)
@pytest.mark.parametrize("n", [2, 30, 500, 6000])
def test_exact_balance_holds_to_round_off_edges_included(band, n):
    rng = np.random.default_rng(n)
    s = np.cumsum(rng.normal(size=n)) / 50
    columns = np.column_stack([rng.normal(size=n), s, s**3, np.sign(s), np.abs(s) * s])
    coefficients = np.array([12.4, 1.4e2, 1e3, 20.0, -7.0])
    operator = ZeroPhaseFilter(band, fs=500.0)
    filtered = operator.apply(columns) @ coefficients
    right = operator.apply(columns @ coefficients)
    assert np.abs(filtered - right).max() <= 1e-9 * np.abs(columns * coefficients).max()


@pytest.mark.parametrize("frequency", [1.5, 5.0, 20.0, 55.0, 80.0])
def test_gain_is_the_squared_butterworth_and_the_phase_is_zero(frequency):
    fs = 1000.0
    angle = 2 * np.pi * frequency * np.arange(20000) / fs
    operator = ZeroPhaseFilter((2.0, 60.0), fs)
    inside = slice(operator.edge, -operator.edge)
    out = operator.apply(np.sin(angle))[inside]
    basis = np.column_stack([np.sin(angle), np.cos(angle)])[inside]
    amplitudes = np.linalg.lstsq(basis, out, rcond=None)[0]

    gain = 1.0
    for edge, kind in ((60.0, "lowpass"), (2.0, "highpass")):
        sections = butter(4, edge, kind, fs=fs, output="sos")
        _, response = sosfreqz(sections, [frequency], fs=fs)
        gain *= np.abs(response[0]) ** 2
    np.testing.assert_allclose(amplitudes, [gain, 0.0], atol=1e-3)


def test_one_hertz_high_pass_spoils_three_seconds():
    fast = ZeroPhaseFilter((1.0, None), 1000.0).edge
    slow = ZeroPhaseFilter((1.0, None), 250.0).edge
    assert 2.5 < fast / 1000.0 < 3.5
    assert slow == pytest.approx(fast / 4, rel=0.02)


def test_inside_the_edges_the_filter_does_not_feel_where_the_record_was_cut():
    record = np.random.default_rng(0).normal(size=(30000, 1))
    operator = ZeroPhaseFilter((1.0, 60.0), 1000.0)
    inside = slice(8000, 22000)
    gap = np.abs(operator.apply(record[inside]) - operator.apply(record)[inside])
    assert gap[operator.edge : -operator.edge].max() < 1e-3
    assert gap.max() > 1e-2


def test_unmeasured_columns_stay_nan_and_holes_are_refused():
    values = np.random.default_rng(0).normal(size=(1000, 3))
    values[:, 1] = np.nan
    operator = ZeroPhaseFilter((None, 20.0), 100.0)
    out = operator.apply(values)
    assert np.isnan(out[:, 1]).all()
    assert np.isfinite(out[:, [0, 2]]).all()
    values[7, 2] = np.nan
    with pytest.raises(ChannelError, match="Column 3 .* row 7"):
        operator.apply(values)


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
def test_an_impossible_order_is_refused(order):
    with pytest.raises(ChannelError, match="order"):
        ZeroPhaseFilter((None, 10.0), 100.0, order)


@pytest.mark.parametrize("fs", [0.0, -5.0, np.nan])
def test_an_impossible_rate_is_refused(fs):
    with pytest.raises(ChannelError, match="sampling rate"):
        ZeroPhaseFilter((None, 10.0), fs)


@pytest.mark.parametrize("band", [(None, 30.0), (1.0, 60.0), None])
def test_the_noise_that_a_filter_passes_is_the_energy_of_its_impulse_response(band):
    operator = ZeroPhaseFilter(band, 500.0)
    impulse = np.zeros(20001)
    impulse[10000] = 1.0
    energy = (operator.apply(impulse) ** 2).sum()
    assert operator.noise_gain() == pytest.approx(energy, rel=1e-3)
