"""-9999 for "not measured" and a time in ms: refused or said, in files and tables, and never where it is honest."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Record, io
from pysindy_nrf.data.channels import fillers
from pysindy_nrf.exceptions import FileFormatError
from pysindy_nrf.signals import plausibility
from pysindy_nrf.signals.channel_checks import check_channels


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """Two storeys with a Duffing spring each, by LSODA; all motions, one force."""
    from scipy.integrate import solve_ivp

    m, c, k, k3 = np.array([8.0, 5.0]), np.array([60.0, 40.0]), np.array([4e4, 3e4]), np.array([5e8, 2e8])
    t = np.arange(4000) / 500.0
    rng = np.random.default_rng(5)
    omega, phase = 2 * np.pi * rng.uniform(2, 30, 12), rng.uniform(0, 6, 12)

    def force(t):
        return 40.0 * np.sin(np.multiply.outer(t, omega) + phase).sum(axis=-1)

    def rates(t, y):
        s, v = np.diff(y[:2], prepend=0.0), np.diff(y[2:], prepend=0.0)
        R = c * v + k * s + k3 * s**3
        return np.r_[y[2:], (np.r_[0.0, force(t)] - R + np.r_[R[1], 0.0]) / m]

    y = solve_ivp(rates, (0, t[-1]), np.zeros(4), "LSODA", t, rtol=1e-9, atol=1e-12).y
    a = np.array([rates(ti, yi)[2:] for ti, yi in zip(t, y.T)])
    return pd.DataFrame({
        "t": t, "F1": 0.0 * t, "F2": force(t), "a1": a[:, 0], "a2": a[:, 1],
        "v1": y[2], "v2": y[3], "x1": y[0], "x2": y[1],
    })  # fmt: skip


@pytest.mark.parametrize(
    ("column", "value", "rows"),
    [("a1", -9999.0, [100, 101, 102]), ("F2", -9999.0, [500, 2000]), ("x2", -999.25, [3000]), ("v1", 1e30, [7, 8]), ("x1", 99999.0, [0, 1])],
)
def test_a_file_with_numbers_for_not_measured_is_refused(table, tmp_path, column, value, rows):
    """With column, rows and cure; the same table with empty cells at its start is read."""
    bad = table.copy()
    bad.loc[rows, column] = value
    path = tmp_path / "logger.csv"
    bad.to_csv(path, index=False)
    where = rf"hannel {column} = '{column}' of .*logger.csv holds {re.escape(f'{value:g}')} in rows? {rows[0]}"
    with pytest.raises(FileFormatError, match=where) as error:
        io.read_record(path)
    assert "split_at_gaps" in str(error.value) and "not measured" in str(error.value)
    units = {column[0]: {"a": "g", "F": "kN", "x": "mm", "v": "mm/s"}[column[0]]}
    with pytest.raises(FileFormatError, match=re.escape(f"holds {value:g} in")):  # as it is written, whatever the unit
        io.read_record(path, units=units)
    if rows[0] == 0:
        bad.loc[rows, column] = np.nan
        bad.to_csv(path, index=False)
        assert io.read_record(path).n_samples == len(table)


def test_a_record_from_a_table_says_so(table):
    bad = table.copy()
    bad.loc[[500, 2000], "F2"] = -9999.0
    record = Record.from_frame(bad)
    found = check_channels(record)
    assert found[["channel", "problem"]].to_numpy().tolist() == [["F2", "filled"]]
    assert found["share"].iloc[0] == pytest.approx(2 / len(table))
    assert "rows 500, 2000" in found["message"].iloc[0]
    assert found["message"].iloc[0] in plausibility.doubts(record)


@given(
    st.lists(st.floats(-1e5, 1e5, allow_nan=False), min_size=4, max_size=40),
    st.sampled_from([-999.0, -9999.0, 99999.0, -1e30, 9.9e37]),
    st.integers(2, 5),
)
def test_only_what_lies_far_beyond_all_others_stands_for_nothing(line, value, times):
    """A channel that comes near the number by itself, or holds it as often as anything, is as it is."""
    line = np.array(line)
    at = np.linspace(0, len(line), times).astype(int)
    held = np.insert(line, at, value)
    rows, _ = fillers(held)
    far = np.abs(line).max() * 5 < abs(value)
    if far and 2 * times <= len(held):
        assert rows.tolist() == np.flatnonzero(held == value).tolist()
    elif np.abs(line).max() < abs(value):
        assert not len(rows)


@pytest.mark.parametrize(
    "line",
    [[0.0, 999.0, 0.0, 1.0], [np.nan] * 4, [np.inf, 1.0, 2.0, 3.0], [0.0] * 4, [-9999.0] * 4, [9999.0, -9999.0, 9999.0, 1.0], []],
    ids=str,
)
def test_honest_lines_are_left_alone(line):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(fillers(np.array(line, dtype=float))[0]) == 0


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_a_time_in_other_units_is_asked_for(table, tmp_path, unit):
    """Three kinds of motion leave one explanation; two leave two; accelerations alone are slow."""
    factor = {"ms": 1e3, "us": 1e6}[unit]
    shown = {"ms": "ms", "us": "µs"}[unit]
    path = tmp_path / "scope.csv"
    late = table.assign(t=table["t"] * factor)
    late.to_csv(path, index=False)
    (said,) = plausibility.doubts(io.read_record(path))
    assert f"as if the time were in {shown}" in said and f"--unit t={shown}" in said
    assert plausibility.doubts(io.read_record(path, units={"t": shown})) == []
    assert plausibility.doubts(io.read_record(path, units={"t": unit})) == []
    late.drop(columns=["v1", "v2"]).to_csv(path, index=False)
    said = plausibility.doubts(io.read_record(path))
    if unit == "ms":  # it may as well be the accelerations
        assert len(said) == 2 and all("is the time in ms?" in text and "in µm?" in text for text in said)
    else:
        assert len(said) == 1 and "as if the time were in µs" in said[0]
    late[["t", "F1", "F2", "a1", "a2"]].to_csv(path, index=False)
    (said,) = plausibility.doubts(io.read_record(path))
    assert "Hz: is the unit of the time declared?" in said
    assert plausibility.doubts(io.read_record(path, units={"t": unit})) == []


def test_a_right_clock_and_slow_displacements_are_not_doubted(table):
    """Towers are measured by satellite once a second."""
    assert plausibility.doubts(Record.from_frame(table)) == []
    slow = table[["t", "F1", "F2", "x1", "x2"]].assign(t=table["t"] * 500)
    assert plausibility.doubts(Record.from_frame(slow)) == []
    one = table.assign(v1=table["v1"] * 1e-3, v2=table["v2"] * 1e-3)  # one kind in another unit is no clock
    assert not any("the time" in text for text in plausibility.doubts(Record.from_frame(one)))


@pytest.mark.parametrize("form", ["%.9f", "%.6e", "%+.5f"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_file_that_ends_inside_a_number_loses_its_last_row_and_no_more(table, tmp_path, form, separator):
    """0.000123 is not 0.0: whatever is cut off, every number that is read is one that was written."""
    path = tmp_path / "copied.csv"
    some = table.iloc[:300]
    some.to_csv(path, index=False, sep=separator, float_format=form)
    whole = path.read_text()
    truth = pd.read_csv(path, sep=separator)
    widths = len(whole.splitlines()[-1].split(separator)[-1])
    for lost in range(2, widths + 1):  # the line feed and some digits
        path.write_text(whole[:-lost])
        read = io.read_table(path)
        assert "ends inside a number" in " ".join(read.notes) and "last row is left out" in " ".join(read.notes), lost
        for name in truth:
            np.testing.assert_allclose(read.variables[name], truth[name][:299], rtol=1e-12)
    path.write_text(whole[:-1])  # a last line without its feed is whole
    read = io.read_table(path)
    assert len(read.variables["t"]) == 300 and "inside" not in " ".join(read.notes)


def test_a_file_of_this_package_that_is_cut_is_refused(table, tmp_path):
    path = io.write_record(Record.from_frame(table), tmp_path / "own.csv")
    whole = path.read_bytes()
    assert io.read_record(path).n_samples == len(table)
    path.write_bytes(whole[:-3])
    with pytest.raises(FileFormatError, match=r"own.csv cannot be read as delimited text: its last line is cut off"):
        io.read_record(path)
