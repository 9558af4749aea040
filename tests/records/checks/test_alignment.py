"""Known delays, gains and signs come back; clocks are joined; gaps are cut."""

import numpy as np
import pandas as pd
import pytest
from chains import driven
from scipy.interpolate import CubicSpline

from pysindy_nrf import ChainModel, Record, laws, simulate
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import (
    align,
    channel_alignment,
    compare_channels,
    resampled,
    split_at_gaps,
)
from pysindy_nrf.simulation import add_noise

NAMES = {"x": "displacement", "v": "velocity", "a": "acceleration"}


@pytest.fixture(scope="module")
def record():
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    return driven(truth, [2], 16.0, 1000.0, 100.0, (0.5, 60.0), hold="cubic")


@pytest.fixture(scope="module", params=[0.0, 0.02])
def noisy(record, request):
    return add_noise(record, request.param, random_state=0)


def delayed(y, samples):
    """A signal late by samples; what lies before its start is its first value."""
    rows = np.arange(len(y))
    return CubicSpline(rows, y)(np.clip(rows - samples, 0, len(y) - 1))


def late(record, kind, samples, gain=1.0):
    """The record with a late channel of floor 2 whose gain is wrong."""
    channel = getattr(record, NAMES[kind]).copy()
    channel[:, 1] = gain * delayed(channel[:, 1], samples)
    return record.replace(**{NAMES[kind]: channel})


@pytest.mark.parametrize("samples", [-9.5, -3.0, -0.25, 0.25, 2.6, 12.0])
def test_a_delay_comes_back(noisy, samples):
    table = channel_alignment(late(noisy, "x", samples))
    fault = table.loc["x2"]
    assert fault["samples"] == pytest.approx(samples, abs=0.06)
    assert fault["delay"] == pytest.approx(samples * 1e-3, abs=6e-5)
    assert ("late" if samples > 0 else "early") in fault["message"]
    assert table["aligned"].drop("x2").all()


@pytest.mark.parametrize("samples", [-9.5, 0.25, 12.0])
def test_a_delay_is_taken_off(record, samples):
    wrong = late(record, "x", samples)
    corrected = align(wrong, channel_alignment(wrong)).displacement[50:-50, 1]
    error = corrected - record.displacement[50:-50, 1]
    assert np.std(error) < 0.02 * np.std(corrected)


RUNS = [slice(200, 2900), slice(3600, 5000), slice(7000, 11000), slice(12500, 15500)]


@pytest.mark.parametrize(
    "kind, samples, gain", [("x", 6.0, 1.0), ("x", -4.0, 1.2), ("v", 5.0, 0.8)]
)
def test_a_fault_comes_back_from_runs_with_gaps_between(noisy, kind, samples, gain):
    """What lies in the gaps may be anything; the other channels of the runs fit."""
    wrong = late(noisy, kind, samples, gain)
    outside = np.ones(wrong.n_samples, dtype=bool)
    for run in RUNS:
        outside[run] = False
    getattr(wrong, NAMES[kind])[outside] *= -3.0
    table = channel_alignment(wrong, runs=RUNS)
    fault = table.loc[f"{kind}2"]
    assert fault["samples"] == pytest.approx(samples, abs=0.1)
    assert fault["gain"] == pytest.approx(gain, rel=0.02)

    others = table.drop(f"{kind}2")
    assert others["samples"].abs().max() < 0.15
    assert (others["gain"] - 1).abs().max() < 0.03


def test_runs_without_a_fault_are_aligned(record):
    assert channel_alignment(record, runs=RUNS)["aligned"].all()


@pytest.fixture(scope="module")
def narrow():
    """Acceleration and velocity of a motion at 10 Hz, its size slowly changing."""
    t = np.arange(20000) * 1e-3
    size = 1 + 0.2 * np.sin(2 * np.pi * 0.3 * t)
    noise = 0.001 * np.random.default_rng(0).standard_normal(20000)
    a = size * np.sin(2 * np.pi * 10.0 * t) + noise
    return a, np.cumsum(a) * 1e-3


@pytest.mark.parametrize("samples, sign", [(15.0, 1), (0.0, -1)])
def test_of_two_readings_of_a_narrow_motion_the_shorter_shift_is_taken(
    narrow, samples, sign
):
    """A sine that is late by 0.3 periods is one of the other sign that is early by 0.2,
    and the reverse.
    """
    a, v = narrow
    v = sign * delayed(v, samples)
    row = channel_alignment(Record(acceleration=a, velocity=v, fs=1e3)).loc["v1"]
    assert row["sign"] == sign
    assert row["samples"] == pytest.approx(samples, abs=1)


def test_a_narrow_motion_in_noise_is_judged_by_the_few_lines_that_rise_above_it():
    """A steady sine of 16 s has a handful of coherent lines: enough for a gain and a
    delay, or nothing is said.
    """
    t = np.arange(0, 16, 0.02)
    delays = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        w = 2 * np.pi * rng.uniform(0.5, 10.0)
        channels = {
            "displacement": np.sin(w * t),
            "velocity": w * np.cos(w * t),
            "acceleration": -(w**2) * np.sin(w * t),
        }
        for kind, y in channels.items():
            channels[kind] = y + 0.2 * y.std() * rng.standard_normal(len(t))
        delays.append(channel_alignment(Record(time=t, **channels)))
    table = pd.concat(delays)[["gain", "delay"]].dropna()
    assert len(table) > 60
    np.testing.assert_allclose(table["gain"], 1.0, atol=0.1)
    np.testing.assert_allclose(table["delay"], 0.0, atol=0.01)


def test_gain_and_sign_come_back_and_are_corrected(record):
    wrong = record.replace(velocity=record.velocity * [-1.0, 1.25])
    table = channel_alignment(wrong)
    assert table.loc["v1", "sign"] == -1
    assert "opposite sign" in table.loc["v1", "message"]
    assert table.loc["v2", "gain"] == pytest.approx(1.25, rel=0.01)
    turned = align(wrong, table, gains=True).velocity
    tolerance = 0.01 * record.velocity.std()
    np.testing.assert_allclose(turned, record.velocity, atol=tolerance)


def test_each_comparison_gives_its_faults_by_kind(record):
    wrong = late(record.replace(velocity=-record.velocity), "x", 3.0)
    faults = {c.channel: c.faults for c in compare_channels(wrong)}
    assert set(faults) == {"v1", "v2", "x1", "x2"}
    assert faults["v1"] == {"sign": -1.0}
    assert faults["x2"]["delay"] == pytest.approx(3e-3, abs=6e-5)
    assert faults["x1"] == {}


def test_channels_that_do_not_follow_each_other_are_named():
    a, x = np.random.default_rng(0).normal(size=(2, 4000))
    strangers = Record(acceleration=a, displacement=x, fs=100.0)
    assert "not coherent" in channel_alignment(strangers).loc["x1", "message"]
    with pytest.raises(ChannelError, match="two kinds"):
        channel_alignment(strangers.replace(displacement=None))


def test_channels_of_different_rates_meet_on_one_clock():
    fast, slow = np.arange(8000) / 1000.0, np.arange(4000) / 500.0
    channels = {"a1": np.sin(20 * fast), "x1": np.cos(20 * slow)}
    rec = resampled(channels, {"a": 1000.0, "x": 500.0})
    assert rec.fs == 500.0
    inside = slice(50, -50)
    a = np.sin(20 * rec.time)[inside]
    np.testing.assert_allclose(rec.acceleration[inside, 0], a, atol=2e-3)
    np.testing.assert_array_equal(rec.displacement[:, 0], np.cos(20 * slow))


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        ({"a1": 500.0}, "rate of channel x1"),
        ({"a1": 500.0, "x1": 500.1}, "no simple ratio"),
    ],
)
def test_rates_that_cannot_be_brought_together_are_refused(rates, words):
    y = np.sin(np.arange(500) / 500.0)
    with pytest.raises(ChannelError, match=words):
        resampled({"a1": y, "x1": y}, rates)


def test_gaps_cut_a_table_into_records():
    t = np.arange(2000) / 100.0
    table = pd.DataFrame({"t": t, "x1": np.sin(t)}).drop(index=range(500, 540))
    table = table.reset_index(drop=True)
    table.loc[1200:1210, "x1"] = np.nan
    parts = split_at_gaps(table, name="test 3")
    assert [piece.n_samples for piece in parts] == [500, 700, 749]
    assert parts[1].name == "test 3, part 2"
    np.testing.assert_allclose(parts[0].displacement[:, 0], np.sin(t[:500]))


def test_short_pieces_between_gaps_are_left_out():
    t = np.arange(500) / 500.0
    holes = np.where(np.arange(500) % 40, np.sin(t), np.nan)
    table = pd.DataFrame({"t": t, "a1": holes})
    with pytest.raises(ChannelError, match="No piece without a gap"):
        split_at_gaps(table)
    parts = split_at_gaps(table, shortest=30)
    assert [piece.n_samples for piece in parts][:3] == [39, 39, 39]


@pytest.mark.parametrize("start", ["blow", "release"])
def test_a_motion_that_dies_away_is_not_late(start):
    """A record of one free decay, measured without any delay."""
    storeys = {i: laws.PowerSeries(1, [28.0, 3.3e4]) for i in (1, 2, 3)}
    model = ChainModel([9.0, 8.0, 7.0], storeys)
    F = np.zeros((9000, 3))
    x0 = [1e-3, 3e-3, 4e-3]
    if start == "blow":
        F[80:100, 2] = 300 * np.sin(np.pi * np.arange(20) / 20) ** 2
        x0 = None
    record = simulate(model, F, 1 / 1500, hold="cubic", x0=x0)
    table = channel_alignment(record.replace(velocity=None))
    assert table["aligned"].all()
    assert table["samples"].abs().max() < 0.02
    assert table["gain"].to_numpy() == pytest.approx(1.0, abs=0.005)
