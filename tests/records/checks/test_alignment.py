"""Alignment: known delays, gains and signs come back; clocks are brought together; gaps
are cut.
"""

import numpy as np
import pandas as pd
import pytest
from chains import driven

from pysindy_nrf import ChainModel, Record, laws
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.checks.alignment import (
    align,
    channel_alignment,
    resampled,
    shifted,
    split_at_gaps,
)
from pysindy_nrf.simulation.noise import add_noise


@pytest.fixture(scope="module")
def record():
    storey = laws.PowerSeries(1, [60.0, 1e5])
    truth = ChainModel([10.0, 12.0], {"storey 1": storey, "storey 2": storey})
    return driven(truth, [2], 16.0, 1000.0, 100.0, (0.5, 60.0), hold="cubic")


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("samples", [-9.5, -3.0, -0.25, 0.25, 2.6, 12.0])
def test_a_delay_comes_back(record, samples, noise):
    noisy = add_noise(record, noise, random_state=0)
    x = noisy.displacement.copy()
    x[:, 1] = shifted(x[:, 1], samples)
    late = noisy.replace(displacement=x)
    found = channel_alignment(late)
    assert found.loc["x2", "samples"] == pytest.approx(samples, abs=0.06)
    assert found.loc["x2", "delay"] == pytest.approx(samples * 1e-3, abs=6e-5)
    assert (
        found["aligned"].drop("x2").all()
        and ("late" if samples > 0 else "early") in found.loc["x2", "message"]
    )
    if noise == 0.0:
        back = align(late, found).displacement[50:-50, 1]
        assert np.std(back - record.displacement[50:-50, 1]) < 0.02 * np.std(back)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize(
    "kind, samples, gain",
    [("x", 6.0, 1.0), ("x", -4.0, 1.2), ("v", 5.0, 0.8), ("v", 0.0, 1.0)],
)
def test_a_fault_comes_back_from_runs_with_gaps_between_them(
    record, kind, samples, gain, noise
):
    """What lies in the gaps may be anything; the other channels of the runs fit."""
    noisy = add_noise(record, noise, random_state=0)
    name = {"x": "displacement", "v": "velocity"}[kind]
    wrong = getattr(noisy, name).copy()
    wrong[:, 1] = gain * shifted(wrong[:, 1], samples)
    runs = [
        slice(200, 2900),
        slice(3600, 5000),
        slice(7000, 11000),
        slice(12500, 15500),
    ]
    inside = np.zeros(len(wrong), dtype=bool)
    for run in runs:
        inside[run] = True
    wrong[~inside] *= -3.0
    found = channel_alignment(noisy.replace(**{name: wrong}), runs=runs)
    assert found.loc[f"{kind}2", "samples"] == pytest.approx(samples, abs=0.1)
    assert found.loc[f"{kind}2", "gain"] == pytest.approx(gain, rel=0.02)
    others = found.drop(f"{kind}2")
    assert (
        others["samples"].abs().max() < 0.15 and (others["gain"] - 1).abs().max() < 0.03
    )
    assert noise or found.loc[f"{kind}2", "aligned"] == (samples == 0.0)


def test_of_two_readings_of_a_narrow_motion_the_shorter_shift_is_taken():
    """A sine that is late by 0.3 periods is one of the other sign that is early by 0.2,
    and the reverse.
    """
    t = np.arange(20000) * 1e-3
    slow = 1 + 0.2 * np.sin(2 * np.pi * 0.3 * t)
    a = slow * np.sin(2 * np.pi * 10.0 * t) + 0.001 * np.random.default_rng(
        0
    ).standard_normal(20000)
    v = np.cumsum(a) * 1e-3
    late = channel_alignment(
        Record(
            acceleration=a[:, None],
            velocity=shifted(v, 15.0)[:, None],
            force=a[:, None],
            fs=1e3,
        )
    )
    assert late.loc["v1", "sign"] == 1 and late.loc["v1", "samples"] == pytest.approx(
        15, abs=1
    )
    turned = channel_alignment(
        Record(acceleration=a[:, None], velocity=-v[:, None], force=a[:, None], fs=1e3)
    )
    assert turned.loc["v1", "sign"] == -1 and abs(turned.loc["v1", "samples"]) < 1


def test_a_narrow_motion_in_noise_is_told_from_the_few_lines_that_rise_above_it():
    """A steady sine of 16 s holds a handful of coherent lines: enough for a gain and a
    delay, or nothing is said.
    """
    t, told = np.arange(0, 16, 0.02), 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        w = 2 * np.pi * rng.uniform(0.5, 10.0)
        motion = {
            "displacement": np.sin(w * t),
            "velocity": w * np.cos(w * t),
            "acceleration": -(w**2) * np.sin(w * t),
        }
        noisy = {
            kind: (y + 0.2 * y.std() * rng.standard_normal(len(t)))[:, None]
            for kind, y in motion.items()
        }
        found = channel_alignment(Record(time=t, force=np.zeros((len(t), 1)), **noisy))[
            ["gain", "delay"]
        ].dropna()
        np.testing.assert_allclose(found["gain"], 1.0, atol=0.1)
        np.testing.assert_allclose(found["delay"], 0.0, atol=0.01)
        told += len(found)
    assert told > 60


def test_gain_and_sign_come_back(record):
    found = channel_alignment(record.replace(velocity=record.velocity * [-1.0, 1.25]))
    assert (
        found.loc["v1", "sign"] == -1 and "opposite sign" in found.loc["v1", "message"]
    )
    assert found.loc["v2", "gain"] == pytest.approx(1.25, rel=0.01)
    turned = align(
        record.replace(velocity=record.velocity * [-1.0, 1.25]), found, gains=True
    )
    np.testing.assert_allclose(
        turned.velocity, record.velocity, atol=0.01 * record.velocity.std()
    )


def test_incoherent_channels_are_named():
    rng = np.random.default_rng(0)
    rec = Record(
        acceleration=rng.normal(size=4000), displacement=rng.normal(size=4000), fs=100.0
    )
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
    np.testing.assert_allclose(
        rec.acceleration[inside, 0], np.sin(20 * rec.time)[inside], atol=2e-3
    )
    np.testing.assert_array_equal(rec.displacement[:, 0], np.cos(20 * slow))
    with pytest.raises(ChannelError, match="rate of channel x1"):
        resampled({"a1": fast, "x1": slow}, {"a": 1000.0})


def test_gaps_cut_a_table_into_records():
    t = np.arange(2000) / 100.0
    table = pd.DataFrame(
        {
            "t": np.delete(t, range(500, 540)),
            "x1": np.delete(np.sin(t), range(500, 540)),
        }
    )
    table.loc[1200:1210, "x1"] = np.nan
    parts = split_at_gaps(table, name="test 3")
    assert [p.n_samples for p in parts] == [500, 700, 749]
    assert parts[1].name == "test 3, part 2"
    np.testing.assert_allclose(parts[0].displacement[:, 0], np.sin(t[:500]))


FS = 500.0


def test_rates_and_gaps_that_cannot_be_mended():
    t = np.arange(500) / FS
    with pytest.raises(ChannelError, match="have no simple ratio"):
        resampled({"a1": np.sin(t), "x1": np.sin(t)}, rates={"a1": 500.0, "x1": 500.1})
    broken = pd.DataFrame(
        {"t": t, "a1": np.where(np.arange(500) % 40, np.sin(t), np.nan)}
    )
    with pytest.raises(ChannelError, match="No piece without a gap has 100 samples"):
        split_at_gaps(broken)
    assert [part.n_samples for part in split_at_gaps(broken, shortest=30)][:3] == [
        39,
        39,
        39,
    ]
