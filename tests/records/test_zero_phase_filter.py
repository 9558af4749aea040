"""A balance stays a balance through the fair filter."""

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
    force = columns @ coefficients
    operator = ZeroPhaseFilter(band, fs=500.0)
    left, right = operator.apply(columns) @ coefficients, operator.apply(force)
    assert np.abs(left - right).max() <= 1e-9 * np.abs(columns * coefficients).max()


def test_gain_is_the_squared_butterworth_and_the_phase_is_zero():
    fs, t = 1000.0, np.arange(20000) / 1000.0
    operator = ZeroPhaseFilter((2.0, 60.0), fs)
    for f in (1.5, 5.0, 20.0, 55.0, 80.0):
        out = operator.apply(np.sin(2 * np.pi * f * t))[operator.edge : -operator.edge]
        inside = t[operator.edge : -operator.edge]
        basis = np.column_stack(
            [np.sin(2 * np.pi * f * inside), np.cos(2 * np.pi * f * inside)]
        )
        gain = np.linalg.lstsq(basis, out, rcond=None)[0]
        low = (
            np.abs(sosfreqz(butter(4, 60.0, fs=fs, output="sos"), [f], fs=fs)[1][0])
            ** 2
        )
        high = (
            np.abs(
                sosfreqz(butter(4, 2.0, "high", fs=fs, output="sos"), [f], fs=fs)[1][0]
            )
            ** 2
        )
        np.testing.assert_allclose(gain, [low * high, 0.0], atol=1e-3)


def test_unmeasured_columns_stay_nan_and_holes_are_refused():
    values = np.random.default_rng(0).normal(size=(1000, 3))
    values[:, 1] = np.nan
    out = ZeroPhaseFilter((None, 20.0), 100.0).apply(values)
    assert np.isnan(out[:, 1]).all() and np.isfinite(out[:, [0, 2]]).all()
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


def test_impossible_order_and_rate_are_refused():
    for order in (0, -1, 2.5, True):
        with pytest.raises(ChannelError, match="order"):
            ZeroPhaseFilter((None, 10.0), 100.0, order)
    for fs in (0.0, -5.0, np.nan):
        with pytest.raises(ChannelError, match="sampling rate"):
            ZeroPhaseFilter((None, 10.0), fs)


@pytest.mark.parametrize("band", [(None, 30.0), (1.0, 60.0), None])
def test_the_noise_that_a_filter_passes_is_the_energy_of_its_impulse_response(band):
    filter = ZeroPhaseFilter(band, 500.0)
    impulse = np.zeros(20001)
    impulse[10000] = 1.0
    assert filter.noise_gain() == pytest.approx(
        (filter.apply(impulse) ** 2).sum(), rel=1e-3
    )
