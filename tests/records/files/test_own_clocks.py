"""Channels with clocks of their own against the signal that they sampled."""

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.files import describe, inspect_record, read_record

DURATION = 20.0  # s


def motion(t):
    """A motion that is known at every time, below 12 Hz."""
    return np.sin(2 * np.pi * 3.1 * t) + 0.5 * np.sin(2 * np.pi * 11.7 * t + 1.0)


def table(start, fs, name="y", unit=1.0):
    t = start + np.arange(round(DURATION * fs)) / fs
    return pd.DataFrame({"stamp": t * unit, name: motion(t)})


@pytest.fixture
def csv(tmp_path):
    def write(name, content):
        path = tmp_path / name
        content.to_csv(path, index=False)
        return path

    return write


CLOCKS = {
    "one sample early": ((0.0, 100.0), (-0.01, 100.0)),
    "a fraction of a sample": ((0.0, 100.0), (0.0137, 100.0)),
    "another rate": ((0.0, 100.0), (0.004, 250.0)),
    "rates without a simple ratio": ((0.0, 100.0), (0.0, 119.99)),
    "a clock that drifts": ((0.0, 100.0), (0.0, 100.01)),
}


@pytest.mark.parametrize("clocks", CLOCKS.values(), ids=CLOCKS)
def test_files_of_one_test_come_to_one_clock(csv, clocks):
    """Both channels are the same motion at the times of the record."""
    paths = [
        csv(f"{name}.csv", table(*clock)) for name, clock in zip(("ref", "own"), clocks)
    ]
    mapping = {"t": "ref.stamp @ s", "a1": "ref.y @ m/s^2", "a2": "own.y @ m/s^2"}
    record = read_record(paths, mapping=mapping)
    assert record.fs == pytest.approx(100.0)
    inside = slice(40, -40)
    for line in record.acceleration.T:
        np.testing.assert_allclose(line[inside], motion(record.time)[inside], atol=2e-4)


def test_shift_and_overlap_are_said_and_kept(csv):
    paths = [csv("ref.csv", table(0.0, 100.0)), csv("own.csv", table(-0.01, 100.0))]
    mapping = {"t": "ref.stamp @ s", "a1": "ref.y @ m/s^2", "a2": "own.y @ m/s^2"}
    reading = inspect_record(paths, mapping=mapping)
    (shift, overlap) = reading.record.quality
    assert (shift.kind, shift.channel, shift.witness) == ("shifted", "a2", "a1")
    assert shift.size == pytest.approx(-0.01)
    assert overlap.kind == "overlap"
    assert not shift.is_fault
    assert "starts 10 ms" in describe(reading)
    assert "stamp" not in reading.unused


def test_each_file_has_the_time_that_its_own_header_names(csv):
    """Times are found by their names, and their units by the headers."""
    first = table(0.0, 100.0).rename(columns={"stamp": "t", "y": "a1"})
    second = table(0.02, 100.0, unit=1e3).rename(columns={"stamp": "Time [ms]"})
    paths = [csv("one.csv", first), csv("two.csv", second)]
    mapping = {"a1": "one.a1", "a2": "two.y @ m/s^2"}
    record = read_record(paths, mapping=mapping)
    np.testing.assert_allclose(record.acceleration[:, 1], motion(record.time))


def test_times_of_day_in_two_files(csv):
    start = np.datetime64("2024-05-01T10:00:00", "us")
    tables = []
    for late in (0.0, 0.5):
        content = table(late, 100.0)
        content["stamp"] = start + (1e6 * content["stamp"]).round().astype("m8[us]")
        tables.append(content)
    paths = [csv(f"{k}.csv", content) for k, content in enumerate(tables)]
    mapping = {"t": "0.stamp", "a1": "0.y @ m/s^2", "a2": "1.y @ m/s^2"}
    record = read_record(paths, mapping=mapping)
    assert record.n_samples == 1950
    np.testing.assert_allclose(*record.acceleration.T)


def test_lengths_that_differ_by_a_few_rows(csv):
    paths = [csv("one.csv", table(0, 100.0)), csv("two.csv", table(0, 100.0)[:-3])]
    mapping = {"t": "one.stamp @ s", "a1": "one.y @ m/s^2", "a2": "two.y @ m/s^2"}
    record = read_record(paths, mapping=mapping)
    assert record.n_samples == 1997
    assert [note.kind for note in record.quality] == ["overlap"]


def test_files_that_have_nothing_in_common(csv):
    paths = [csv("one.csv", table(0, 100.0)), csv("two.csv", table(3600.0, 100.0))]
    mapping = {"t": "one.stamp @ s", "a1": "one.y @ m/s^2", "a2": "two.y @ m/s^2"}
    with pytest.raises(ChannelError, match="a2 starts at 3600 s"):
        read_record(paths, mapping=mapping)


def test_a_gap_in_a_channel_that_must_be_interpolated(csv):
    broken = table(0.004, 100.0)
    broken.loc[500:510, "y"] = np.nan
    paths = [csv("one.csv", table(0, 100.0)), csv("two.csv", broken)]
    mapping = {"t": "one.stamp @ s", "a1": "one.y @ m/s^2", "a2": "two.y @ m/s^2"}
    with pytest.raises(ChannelError, match="empty cells inside"):
        read_record(paths, mapping=mapping)


@pytest.mark.parametrize("key", ["wf_start_time", "wf_start_offset"])
def test_start_times_of_tdms(tmp_path, key):
    nptdms = pytest.importorskip("nptdms")
    started = np.datetime64("2024-05-01T10:00:00.000")
    channels = []
    for name, late in (("F1", 40), ("a1", 0), ("x1", 0)):
        properties = {"wf_increment": 0.002, "wf_start_offset": 0.0}
        properties["wf_start_time"] = started
        if key == "wf_start_time":
            properties[key] = started + np.timedelta64(late, "ms")
        else:
            properties[key] = late / 1000
        line = motion(late / 1000 + np.arange(1000) / 500)
        channels.append(nptdms.ChannelObject("G", name, line, properties))
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment(channels)

    record = read_record(tmp_path / "a.tdms")
    assert record.n_samples == 980
    np.testing.assert_allclose(record.force, record.displacement, atol=1e-12)


def test_start_times_and_rates_of_uff(uff):
    def history(node, data_type, start, fs):
        t = start + np.arange(round(DURATION * fs)) / fs
        return {
            "type": 58,
            "func_type": 1,
            "binary": 0,
            "id1": "NONE",
            "rsp_node": node,
            "rsp_dir": 3,
            "ref_node": 0,
            "ref_dir": 0,
            "abscissa_spacing": 1,
            "abscissa_spec_data_type": 17,
            "abscissa_min": start,
            "abscissa_inc": 1 / fs,
            "ordinate_spec_data_type": data_type,
            "orddenom_spec_data_type": 0,
            "data": motion(t),
            "x": t,
        }

    path = uff(history(1, 12, 0.0, 100.0), history(2, 12, 0.13, 200.0))
    record = read_record(path)
    assert record.fs == 100
    lines = record.acceleration[40:-40].T
    np.testing.assert_allclose(*lines, atol=1e-4)


def test_a_number_beside_arrays_is_their_rate(tmp_path):
    x = motion(np.arange(500) / 250)
    for name, value in (("fs", 250.0), ("dt", 0.004), ("SampleRate", 250)):
        path = tmp_path / f"{name}.npz"
        np.savez(path, x1=x, F1=x, **{name: value})
        reading = inspect_record(path)
        assert reading.record.fs == 250
        assert "250 Hz" in describe(reading)
