"""Alignment: known delays, gains and signs come back; clocks are brought together; gaps are cut."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import ChainModel, Record, excitation, laws, simulate
from pysindy_nrf.alignment import align, channel_alignment, displacement_from_drifts, resampled, shifted, split_at_gaps
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.noise import add_noise


@pytest.fixture(scope="module")
def record():
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    F = excitation.band_limited_random(2, 16.0, 1000.0, dofs=[2], rms=100.0, band=(0.5, 60.0), random_state=0)
    return simulate(truth, F, 1e-3, hold="cubic")


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("samples", [-3.0, -0.25, 0.25, 2.6])
def test_a_delay_comes_back(record, samples, noise):
    noisy = add_noise(record, noise, random_state=0)
    x = noisy.displacement.copy()
    x[:, 1] = shifted(x[:, 1], samples)
    late = noisy.replace(displacement=x)
    found = channel_alignment(late)
    assert found.loc["x2", "samples"] == pytest.approx(samples, abs=0.06)
    assert found.loc["x2", "delay"] == pytest.approx(samples * 1e-3, abs=6e-5)
    assert found["aligned"].drop("x2").all() and ("late" if samples > 0 else "early") in found.loc["x2", "message"]
    if noise == 0.0:
        back = align(late, found).displacement[50:-50, 1]
        assert np.std(back - record.displacement[50:-50, 1]) < 0.02 * np.std(back)


def test_gain_and_sign_come_back(record):
    found = channel_alignment(record.replace(velocity=record.velocity * [-1.0, 1.25]))
    assert found.loc["v1", "sign"] == -1 and "opposite sign" in found.loc["v1", "message"]
    assert found.loc["v2", "gain"] == pytest.approx(1.25, rel=0.01)
    turned = align(record.replace(velocity=record.velocity * [-1.0, 1.25]), found, gains=True)
    np.testing.assert_allclose(turned.velocity, record.velocity, atol=0.01 * record.velocity.std())


def test_a_moving_base_is_no_misalignment(record):
    ag = excitation.band_limited_random(1, 16.0, 1000.0, dofs=[1], rms=3.0, band=(0.5, 40.0), random_state=3)[:, 0]
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    rec = simulate(truth, np.zeros((len(ag), 2)), 1e-3, base_acceleration=ag, hold="cubic")
    assert channel_alignment(rec)["aligned"].all()


def test_incoherent_channels_are_named():
    rng = np.random.default_rng(0)
    rec = Record(acceleration=rng.normal(size=4000), displacement=rng.normal(size=4000), fs=100.0)
    assert "not coherent" in channel_alignment(rec).loc["x1", "message"]
    with pytest.raises(ChannelError, match="two kinds"):
        channel_alignment(Record(acceleration=rng.normal(size=4000), fs=100.0))


def test_channels_of_different_rates_meet_on_one_clock():
    fast, slow = np.arange(8000) / 1000.0, np.arange(4000) / 500.0
    rec = resampled(
        {"a1": np.sin(20 * fast), "x1": np.cos(20 * slow), "F1": np.sin(9 * fast)},
        {"a": 1000.0, "x": 500.0, "F": 1000.0},
    )
    assert rec.fs == 500.0
    inside = slice(50, -50)
    np.testing.assert_allclose(rec.acceleration[inside, 0], np.sin(20 * rec.time)[inside], atol=2e-3)
    np.testing.assert_array_equal(rec.displacement[:, 0], np.cos(20 * slow))
    with pytest.raises(ChannelError, match="rate of channel x1"):
        resampled({"a1": fast, "x1": slow}, {"a": 1000.0})


def test_gaps_cut_a_table_into_records():
    t = np.arange(2000) / 100.0
    table = pd.DataFrame({"t": np.delete(t, range(500, 540)), "x1": np.delete(np.sin(t), range(500, 540))})
    table.loc[1200:1210, "x1"] = np.nan
    parts = split_at_gaps(table, name="test 3")
    assert [p.n_samples for p in parts] == [500, 700, 749]
    assert parts[1].name == "test 3, part 2"
    np.testing.assert_allclose(parts[0].displacement[:, 0], np.sin(t[:500]))


def test_drifts_between_floors_add_up():
    x = np.random.default_rng(0).normal(size=(50, 3))
    np.testing.assert_allclose(displacement_from_drifts(np.diff(x, axis=1, prepend=0.0)), x)
