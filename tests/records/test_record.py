"""Records and the arrays they are made of: clocks, gaps, values that stand for "not
measured".
"""

import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import NRFRegressor, Record, laws
from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records.channels import fillers
from pysindy_nrf.records.files import inspect_record, read_record


def test_a_clock_in_the_index_of_a_table(frame):
    record = Record.from_frame(frame)
    stamps = pd.to_datetime("2024-05-01") + pd.to_timedelta(record.time, unit="s")
    again = Record.from_frame(record.to_frame().set_axis(stamps))
    assert again.fs == pytest.approx(500.0)
    np.testing.assert_array_equal(again.acceleration, record.acceleration)


def test_a_record_without_a_clock_serves_an_element_without_mass_only():
    """A spring and a slider along a path that is known by its samples alone."""
    x = 0.01 * np.sin(np.linspace(0.0, 40.0, 2000)) * np.linspace(0.2, 1.0, 2000)
    steps, slider = np.diff(x, prepend=0.0), np.zeros(len(x))
    for i, step in enumerate(steps):
        slider[i] = np.clip(slider[i - 1] + step, -0.002, 0.002)
    record = Record(force=(3e4 * x + 2e5 * slider)[:, None], displacement=x[:, None])
    assert not record.has_clock and "without a clock" in repr(record)
    element = NRFRegressor(
        laws={1: [laws.LinearElastic(), laws.Jenkins()]}, massless=True
    ).fit(record)
    spring, found = element.model_.laws["storey 1"]
    assert (
        record.rows(slice(10, 90)).by_sample().time[0] == 0.0
    )  # a part counts its samples anew
    assert spring.parameters["k"] == pytest.approx(3e4, rel=1e-3)
    assert found.parameters["Fy"] == pytest.approx(400.0, rel=1e-3)
    assert element.masses_ == pytest.approx([0.0])
    for other in (
        NRFRegressor(degree=1, massless=True),
        NRFRegressor(laws={1: [laws.LinearElastic()]}),
    ):
        with pytest.raises(ChannelError, match="has no clock.*massless=True"):
            other.fit(record)
    with pytest.raises(ChannelError, match="no clock"):
        _ = record.time
    with pytest.raises(ChannelError, match="no clock"):
        Record(force=np.zeros((9, 1)), acceleration=np.ones((9, 1)))


@pytest.mark.parametrize(
    "time, words",
    [
        ([-1e308, 0.0, 1e308, 1.2e308], "is not a time in seconds"),
        ([0.0, 1e-320, 2e-320, 3e-320], "is not a time in seconds"),
        ([0.0, 1e-320, 2e-320, 1e308], "the clock is uneven"),
        ([0.0, 0.0, 0.0, 0.0], "stands still"),
    ],
)
def test_times_that_are_not_seconds_are_refused(time, words):
    with warnings.catch_warnings(action="error", category=RuntimeWarning):
        with pytest.raises(ChannelError, match=words):
            Record(displacement=np.sin(np.arange(4.0))[:, None], time=np.array(time))


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


def test_gaps_and_jitter_are_named_and_counted(tmp_path):
    path = tmp_path / "a.csv"
    rng = np.random.default_rng(0)
    t = np.arange(1000) / 256

    def timed(time):
        pd.DataFrame({"t": time, "a1": np.sin(9 * t[: len(time)])}).to_csv(
            path, index=False
        )
        return path

    even = inspect_record(timed(t))
    assert even.record.fs == 256 and even.clock == "256 Hz, from the time 't', even"
    loose = inspect_record(timed(t + rng.uniform(-0.01, 0.01, 1000) / 256))
    assert (
        loose.record.fs == pytest.approx(256, rel=1e-4)
        and "steps vary by up to" in loose.clock
    )
    with pytest.raises(ChannelError, match="2 gaps, about 75 samples are missing"):
        inspect_record(
            timed(np.delete(np.concatenate([t[:300], t[350:]]), slice(600, 625)))
        )
    with pytest.raises(ChannelError, match="jitter, steps of .*resample"):
        inspect_record(timed(t + rng.uniform(-0.3, 0.3, 1000) / 256))
    # a time rounded to milliseconds is not jitter of the clock: the cure says so, and
    # works
    with pytest.raises(ChannelError, match="jitter.*only rounded.*t = 'none'.*fs=256"):
        inspect_record(timed(t.round(3)))
    assert (
        inspect_record(path, mapping={"t": "none"}, fs=256.0).clock
        == "256 Hz, as given"
    )


def test_a_part_of_a_record_keeps_its_times(frame):
    record = Record.from_frame(frame)
    part = record.window(0.1, 0.3)
    assert (
        part.n_samples == 100
        and part.time[0] == pytest.approx(0.1)
        and record.n_samples == 300
    )
    np.testing.assert_array_equal(part.displacement, record.displacement[50:150])
    np.testing.assert_array_equal(record.rows(slice(50, 150)).time, part.time)
    assert part.replace(name="hit").t0 == part.t0
    for rows in (slice(0, 1), slice(0, 10, 2), slice(400, 500)):
        with pytest.raises(ChannelError, match="is not a part of its 300 samples"):
            record.rows(rows)


@pytest.mark.fuzz
@given(
    st.lists(st.floats(-1e5, 1e5, allow_nan=False), min_size=4, max_size=40),
    st.sampled_from([-999.0, -9999.0, 99999.0, -1e30, 9.9e37]),
    st.integers(2, 5),
)
def test_only_values_far_beyond_all_others_are_fillers(line, value, times):
    """A channel that comes near the number by itself, or holds it in half of its rows,
    is left as it is.
    """
    line = np.array(line)
    held = np.insert(line, np.linspace(0, len(line), times).astype(int), value)
    rows, _ = fillers(held)
    if np.abs(line).max() * 5 < abs(value) and 2 * times <= len(held):
        assert rows.tolist() == np.flatnonzero(held == value).tolist()
    elif np.abs(line).max() < abs(value):
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
        assert len(fillers(np.array(line, dtype=float))[0]) == 0
