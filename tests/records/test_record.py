"""Records: clocks, gaps, parts, and values that stand for "not measured"."""

import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import NRFRegressor, Record, laws
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import fillers
from pysindy_nrf.records.files import inspect_record, read_record


def test_a_clock_in_the_index_of_a_table(frame):
    record = Record.from_frame(frame)
    stamps = pd.to_datetime("2024-05-01") + pd.to_timedelta(record.time, unit="s")
    again = Record.from_frame(record.to_frame().set_axis(stamps))
    assert again.fs == pytest.approx(500.0)
    np.testing.assert_array_equal(again.acceleration, record.acceleration)


@pytest.fixture(scope="module")
def quasi_static():
    """A spring and a slider (400 N) along a path that is known by its samples alone."""
    x = 0.01 * np.sin(np.linspace(0.0, 40.0, 2000)) * np.linspace(0.2, 1.0, 2000)
    slip = 0.0
    force = []
    for step in np.diff(x, prepend=0.0):
        slip = np.clip(slip + step, -0.002, 0.002)
        force.append(2e5 * slip)
    force = 3e4 * x + np.array(force)
    return Record(force=force[:, None], displacement=x[:, None])


def test_a_record_without_a_clock_counts_its_samples(quasi_static):
    assert not quasi_static.has_clock
    assert "without a clock" in repr(quasi_static)
    window = quasi_static.rows(slice(10, 90)).by_sample()
    assert window.time[0] == 0.0
    with pytest.raises(ChannelError, match="no clock"):
        _ = quasi_static.time


def test_a_record_without_a_clock_serves_an_element_without_mass(quasi_static):
    model = NRFRegressor(
        laws={1: [laws.LinearElastic(), laws.Jenkins()]}, massless=True
    ).fit(quasi_static)
    spring, slider = model.model_.laws["storey 1"]
    assert spring.parameters["k"] == pytest.approx(3e4, rel=1e-3)
    assert slider.parameters["Fy"] == pytest.approx(400.0, rel=1e-3)
    assert model.masses_ == pytest.approx([0.0])


@pytest.mark.parametrize(
    "options",
    [{"degree": 1, "massless": True}, {"laws": {1: [laws.LinearElastic()]}}],
    ids=["damper", "mass"],
)
def test_dampers_and_masses_need_a_clock(quasi_static, options):
    with pytest.raises(ChannelError, match="has no clock.*massless=True"):
        NRFRegressor(**options).fit(quasi_static)


def test_accelerations_need_a_clock():
    with pytest.raises(ChannelError, match="no clock"):
        Record(force=np.zeros((9, 1)), acceleration=np.ones((9, 1)))


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ([-1e308, 0.0, 1e308, 1.2e308], "not a time in seconds"),
        ([0.0, 1e-320, 2e-320, 3e-320], "not a time in seconds"),
        ([0.0, 1e-320, 2e-320, 1e308], "clock is uneven"),
        ([0.0, 0.0, 0.0, 0.0], "stands still"),
    ],
)
def test_times_that_are_not_seconds_are_refused(time, words):
    displacement = np.sin(np.arange(4.0))[:, None]
    with warnings.catch_warnings(action="error", category=RuntimeWarning):
        with pytest.raises(ChannelError, match=words):
            Record(displacement=displacement, time=np.array(time))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,a1\n0,1\n0.01,\n0.02,3\n0.03,4\n", "a1.*NaN in row 1"),
        ("t,a1\n0,1\n0.01,2\n0.02,3\n0.30,4\n", "clock is uneven"),
        ("a1,x1\n0,1\n0.01,2\n0.02,3\n", "no time column"),
    ],
)
def test_gaps_and_clocks_are_refused(written, text, words):
    with pytest.raises(ChannelError, match=words):
        read_record(written(text))


T = np.arange(1000) / 256


@pytest.fixture
def timed(tmp_path):
    """Function that writes a record with some times and returns the path."""

    def write(time):
        path = tmp_path / "a.csv"
        columns = {"t": time, "a1": np.sin(9 * T[: len(time)])}
        pd.DataFrame(columns).to_csv(path, index=False)
        return path

    return write


def jitter(share):
    """Deviations of the times by up to a share of a step."""
    return np.random.default_rng(0).uniform(-share, share, len(T)) / 256


def test_an_even_clock_is_described(timed):
    reading = inspect_record(timed(T))
    assert reading.record.fs == 256
    assert reading.clock == "256 Hz, from the time 't', even"


def test_small_jitter_is_described(timed):
    reading = inspect_record(timed(T + jitter(0.01)))
    assert reading.record.fs == pytest.approx(256, rel=1e-4)
    assert "steps vary by up to" in reading.clock


def test_large_jitter_is_refused(timed):
    path = timed(T + jitter(0.3))
    with pytest.raises(ChannelError, match="jitter, steps of .*resample"):
        inspect_record(path)


def test_gaps_are_counted(timed):
    is_kept = np.ones(len(T), dtype=bool)
    is_kept[300:350] = is_kept[650:675] = False
    path = timed(T[is_kept])
    with pytest.raises(ChannelError, match="2 gaps, about 75 samples"):
        inspect_record(path)


def test_a_time_rounded_to_milliseconds_has_a_cure_that_works(timed):
    path = timed(T.round(3))
    with pytest.raises(ChannelError, match="only rounded.*t = 'none'.*fs=256"):
        inspect_record(path)
    reading = inspect_record(path, mapping={"t": "none"}, fs=256.0)
    assert reading.clock == "256 Hz, as given"


def test_a_part_of_a_record_keeps_its_times(frame):
    record = Record.from_frame(frame)
    window = record.window(0.1, 0.3)
    assert window.n_samples == 100
    assert window.time[0] == pytest.approx(0.1)
    np.testing.assert_array_equal(window.displacement, record.displacement[50:150])
    np.testing.assert_array_equal(record.rows(slice(50, 150)).time, window.time)
    assert window.replace(name="hit").t0 == window.t0
    assert record.n_samples == 300


@pytest.mark.parametrize("rows", [slice(0, 1), slice(0, 10, 2), slice(400, 500)])
def test_a_part_of_a_record_has_consecutive_rows(frame, rows):
    with pytest.raises(ChannelError, match="not a part of its 300"):
        Record.from_frame(frame).rows(rows)


def test_a_record_may_start_at_another_time(small):
    record = small()
    later = record.starting_at(7.0)
    np.testing.assert_allclose(later.time, record.time + 7.0)
    assert record.t0 == 0.0


@pytest.mark.fuzz
@given(
    st.lists(st.floats(-1e5, 1e5, allow_nan=False), min_size=4, max_size=40),
    st.sampled_from([-999.0, -9999.0, 99999.0, -1e30, 9.9e37]),
    st.integers(2, 5),
)
def test_only_values_far_beyond_all_others_are_fillers(line, value, times):
    """A channel that comes near the number, or mostly holds it, is left as it is."""
    line = np.array(line)
    places = np.linspace(0, len(line), times).astype(int)
    filled = np.insert(line, places, value)
    rows, _ = fillers(filled)
    largest = np.abs(line).max()
    if largest * 5 < abs(value) and 2 * times <= len(filled):
        assert rows.tolist() == np.flatnonzero(filled == value).tolist()
    elif largest < abs(value):
        assert not len(rows)


@pytest.mark.parametrize(
    "line",
    [
        [0.0, 999.0, 0.0, 1.0],
        [np.nan] * 4,
        [np.inf, 1.0, 2.0, 3.0],
        [0.0] * 4,
        [-9999.0] * 4,
        [9999.0, -9999.0, 9999.0, 1.0],
        [],
    ],
    ids=str,
)
def test_honest_channels_are_left_alone(line):
    with warnings.catch_warnings(action="error"):
        rows, _ = fillers(np.array(line, dtype=float))
    assert len(rows) == 0


def test_columns_of_a_table_are_taken_by_their_names():
    motion = np.random.default_rng(0).standard_normal((50, 3))
    names = ["F3", "F1", "F2"]
    force = pd.DataFrame(np.eye(50, 3), columns=names)
    record = Record(force=force, acceleration=motion, fs=100.0)
    np.testing.assert_array_equal(record.force, force[["F1", "F2", "F3"]])


def test_tables_of_different_times_are_refused():
    time = np.arange(50) / 100
    force = pd.DataFrame(np.ones((50, 1)), index=time)
    late = pd.DataFrame(np.ones((50, 1)), index=time + 1.0)
    with pytest.raises(ChannelError, match="times"):
        Record(force=force, acceleration=late, fs=100.0)
