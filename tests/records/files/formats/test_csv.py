"""Delimited text: the numbers that were measured, or a refusal that names the cell."""

import os
import re
import time
import warnings

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf import Record
from pysindy_nrf.exceptions import ChannelError, FileFormatError
from pysindy_nrf.records.files import read_record, read_table, write_record, write_table

DIALECTS = {
    "comma": "t,a1\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n",
    "semicolon and decimal comma": "t;a1\n0,00;1,5\n0,01;-2,25\n0,02;3e-4\n0,03;1e3\n",
    "tab and decimal comma": "t\ta1\n0,00\t1,5\n0,01\t-2,25\n0,02\t3e-4\n0,03\t1e3\n",
    "blanks": "   t      a1\n  0.00   1.5\n  0.01  -2.25\n 0.02 3e-4\n 0.03 1e3\n",
    "comment lines": (
        "# shaker test\n% channel list below\nt,a1\n0.00,1.5\n#"
        " pause\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n"
    ),
    "names in a comment": "# t, a1\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n",
    "preamble": (
        "Project: bridge,"
        " 2024\nOperator;X\n\nt;a1\n0.00;1.5\n0.01;-2.25\n0.02;3e-4\n0.03;1e3\n"
    ),
    "separator at the end": "t;a1;\n0.00;1.5;\n0.01;-2.25;\n0.02;3e-4;\n0.03;1e3;\n",
    "quoted names": '"t","a1"\n0.00,1.5\n0.01,-2.25\n0.02,3e-4\n0.03,1e3\n',
    "Windows lines and mark": (
        "\ufefft,a1\r\n0.00,1.5\r\n0.01,-2.25\r\n0.02,3e-4\r\n0.03,1e3\r\n"
    ),
}


@pytest.mark.parametrize("text", DIALECTS.values(), ids=DIALECTS.keys())
def test_the_dialect_is_found(written, text):
    variables = read_table(written(text)).variables
    assert list(variables) == ["t", "a1"]
    np.testing.assert_array_equal(variables["t"], [0.0, 0.01, 0.02, 0.03])
    np.testing.assert_array_equal(variables["a1"], [1.5, -2.25, 3e-4, 1e3])


def test_units_in_the_header(written):
    table = read_table(written("t [s];Laser 2 (mm);hammer\n0;1;2\n1;2;3\n"))
    assert table.units == {"t": "s", "Laser 2": "mm"}


def test_units_on_their_own_line(written):
    table = read_table(written("t;x1;F1\ns;mm;kN\n0;1;2\n1;2;3\n"))
    assert table.units == {"t": "s", "x1": "mm", "F1": "kN"}
    np.testing.assert_array_equal(table.variables["F1"], [2, 3])


def test_brackets_that_number_a_floor_stay_in_the_name(written):
    table = read_table(written("t,a (floor 1),a (floor 2)\n0,1,2\n1,2,3\n"))
    assert list(table.variables) == ["t", "a (floor 1)", "a (floor 2)"]


def test_brackets_that_name_a_direction_stay_in_the_name(written):
    """(N) and (S) of one name are not a force and a time."""
    path = written("t [s],acc (N),acc (S),laser (mm)\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    mapping = {"a1": "acc (N)", "a2": "acc (S)", "x1": "laser"}
    record = read_record(path, mapping=mapping)
    np.testing.assert_array_equal(record.acceleration, [[1, 2], [2, 3], [3, 4]])
    np.testing.assert_allclose(record.displacement[:, 0], [3e-3, 4e-3, 5e-3])


@pytest.mark.parametrize(
    "name",
    ["(" * 40_000, "a" + "[" * 40_000, "a (" * 13_000, "a [" + " " * 40_000 + "x]"],
    ids=len,
)
def test_a_header_of_brackets_is_a_name_like_any_other(written, name):
    """It takes a moment, and no message drowns in it."""
    path = written(f"t,{name}\n0,1\n1,2\n")
    start = time.perf_counter()
    with pytest.raises(FileFormatError, match="no column .* motion") as error:
        read_record(path)
    assert time.perf_counter() - start < 1.0
    assert len(str(error.value)) < 400


@pytest.mark.parametrize("cell", ["1.5,", "1.5"])
def test_a_text_of_one_line_is_refused_by_its_first_part(written, cell):
    with pytest.raises(FileFormatError, match="first line is longer"):
        read_table(written(cell * 5_000_000))


def test_a_name_that_is_no_text_is_written_as_its_code(frame, tmp_path):
    path = tmp_path / os.fsdecode(b"test \xff.csv")
    frame.to_csv(path, index=False)
    record = read_record(path)
    assert record.name == r"test \udcff"
    again = read_record(write_record(record, tmp_path / "own.csv"))
    assert again.name == record.name


def test_cells_that_a_spreadsheet_would_run_are_quoted(tmp_path):
    cells = ["=cmd", "+1", "-2", "@x", "m1\r=1"]
    table = pd.DataFrame({"=1+1": cells, "value": range(5)})
    lines = write_table(table, tmp_path / "a.csv").read_text().splitlines()
    quoted = ["'=1+1,value", "'=cmd,0", "'+1,1", "'-2,2", "'@x,3", "m1 =1,4"]
    assert lines == quoted  # a row is a line


def test_names_that_a_spreadsheet_would_run_come_back(frame, tmp_path):
    record = Record.from_frame(frame.assign(**{"=volt": 1.0}))
    path = write_record(record, tmp_path / "b.csv")
    assert ",'=volt" in path.read_text().splitlines()[1]
    assert list(read_record(path).covariates) == ["=volt"]


def test_columns_without_names_are_numbered(written):
    table = read_table(written("0 1\n1 2\n2 3\n", "test.dat"))
    assert list(table.variables) == ["c1", "c2"]
    assert "no names" in table.notes[0]


def test_a_comma_between_columns_is_not_a_decimal_comma(written):
    table = read_table(written("1,5\n2,6\n3,7\n"))
    np.testing.assert_array_equal(table.variables["c2"], [5, 6, 7])


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_encodings(written, encoding):
    table = read_table(written("Zeit;Größe\n0;1\n1;2\n", encoding=encoding))
    assert list(table.variables) == ["Zeit", "Größe"]


T = np.arange(200) / 200.0
X = 1.2e-3 * np.sin(20 * T)  # m
A = -400 * X  # m/s^2, of the same motion
F = 1500 * np.cos(20 * T) + 3  # N


def with_point(values):
    return [f"{value:.9g}" for value in values]


def with_comma(values):
    return [text.replace(".", ",") for text in with_point(values)]


def in_thousands(values, mark, form=",.0f"):
    return [format(value, form).replace(",", mark) for value in values]


def test_a_point_of_thousands_beside_a_decimal_comma(columns_file):
    """ "1.503" is 1503 N, not 1.503 N; the other columns can still be read."""
    forces = in_thousands(F, ".")
    path = columns_file("t;x1;F1", [with_comma(T), with_comma(X), forces])
    words = r"F1 .*'1\.503' in data row 1, .* decimal comma.* thousands"
    with pytest.raises(FileFormatError, match=words):
        read_record(path)
    record = read_record(path, mapping={"F1": "none"})
    np.testing.assert_allclose(record.displacement[:, 0], X, atol=1e-11)


def test_a_point_of_thousands_in_one_of_several_files(columns_file):
    columns = [with_comma(T), with_comma(X), in_thousands(F, ".")]
    paths = [
        columns_file("t;x1;F1", columns),
        columns_file("t;volt;Shaker", columns, name="b.csv"),
    ]
    with pytest.raises(FileFormatError, match=r"F1 .*'1\.503'"):
        read_record(paths, mapping={"x1": "own.x1", "F1": "b.Shaker"})


@pytest.mark.parametrize("mark", [",", "'", "\u202f"])
def test_marks_of_thousands_are_named_with_the_cure(columns_file, mark):
    forces = in_thousands(F, mark, ",.3f")
    path = columns_file("t;x1;F1", [with_point(T), with_point(X), forces])
    words = "F1 .*in data row 1.*without marks of thousands"
    with pytest.raises(FileFormatError, match=words):
        read_record(path)


@pytest.mark.parametrize(
    "head",
    [
        "t;x1;a1;F1\ns;mm;g;kN",
        "s;mm;g;kN\nt;x1;a1;F1",
        "Rig 7\n[s];[mm];[g];[kN]\nt;x1;a1;F1",
    ],
)
def test_a_row_of_units_below_or_above_the_names(columns_file, head):
    columns = [T, 1e3 * X, A / 9.80665, F / 1e3]
    record = read_record(columns_file(head, [with_point(line) for line in columns]))
    np.testing.assert_allclose(record.displacement[:, 0], X, atol=1e-11)
    np.testing.assert_allclose(record.acceleration[:, 0], A, atol=1e-9)
    np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


@pytest.fixture
def laser_file(columns_file):
    """A laser in mm, whose path is halved, and a load cell in volts."""
    columns = [with_point(T), with_point(500 * X), with_point(F / 35)]
    return columns_file("t;Laser [mm];Cell", columns)


def test_a_factor_beside_a_unit_asks_for_the_unit_of_the_product(laser_file):
    words = r"'Laser \* 2' .* in mm.*'Laser \* 2 @ mm' or 'Laser \* 2 @ m'"
    with pytest.raises(ChannelError, match=words):
        read_record(laser_file, mapping={"x1": "Laser * 2"})


@pytest.mark.parametrize(
    ("text", "size"),
    [("Laser * 2 @ mm", 1.0), ("Laser * 0.002 @ m", 1.0), ("-Laser", -0.5)],
)
def test_a_factor_with_the_unit_of_the_product(laser_file, text, size):
    """One for volts makes newtons of them."""
    record = read_record(laser_file, mapping={"x1": text, "F1": "Cell * 35"})
    np.testing.assert_allclose(record.displacement[:, 0], size * X, atol=1e-11)
    np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


@pytest.mark.parametrize("tail", ["Max;1;2\n", "End of test\n", "% end\n"])
def test_a_footer_is_named(columns_file, tail):
    columns = [with_point(T), with_point(X), with_point(F)]
    path = columns_file("t;x1;F1", columns, tail=tail)
    first_cell = tail.split(";")[0].strip()
    with pytest.raises(FileFormatError, match=f"'{first_cell}' in data row 201"):
        read_record(path)


def test_times_of_day_are_a_clock(columns_file):
    seconds = 59 + T
    of_day = [f"12:{int(s // 60):02d}:{s % 60:06.3f}" for s in seconds]
    path = columns_file("Time;x1;F1", [of_day, with_point(X), with_point(F)])
    with warnings.catch_warnings(action="error"):
        assert read_record(path).fs == pytest.approx(200.0, rel=1e-12)


def test_time_stamps_are_a_clock(written):
    rows = [f"2024-05-01T12:00:00.{k},{k}\n" for k in ("00", "25", "50")]
    assert read_record(written("time,a1\n" + "".join(rows))).fs == pytest.approx(4.0)


def test_a_word_among_numbers_is_located(written):
    rows = [f"{i / 100},{i}\n" for i in range(200)]
    path = written("t,a1\n" + "".join(rows) + "2.00,overload\n2.01,3\n")
    with pytest.raises(FileFormatError, match="'overload' in data row 201"):
        read_record(path)


def spoilt_file(frame, folder, column, value, rows):
    """The frame as a logger writes it, with a value in some rows of a column."""
    spoilt = frame.copy()
    spoilt.loc[rows, column] = value
    path = folder / "logger.csv"
    spoilt.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("column", "value", "rows", "unit"),
    [
        ("a1", -9999.0, [100, 101, 102], "g"),
        ("F2", -9999.0, [50, 200], "kN"),
        ("x2", -999.25, [299], "mm"),
        ("v1", 1e30, [7, 8], "mm/s"),
        ("x1", 99999.0, [0, 1], "mm"),
    ],
)
def test_numbers_for_not_measured_are_refused(
    frame, tmp_path, column, value, rows, unit
):
    """They are named as they are written, whatever the unit."""
    path = spoilt_file(frame, tmp_path, column, value, rows)
    number = re.escape(f"{value:g}")
    words = rf"{column} = '{column}' of .*{number} in rows? {rows[0]}.*split_at_gaps"
    with pytest.raises(FileFormatError, match=words):
        read_record(path)
    with pytest.raises(FileFormatError, match=f"holds {number} in"):
        read_record(path, units={column[0]: unit})


def test_empty_cells_at_the_start_are_not_measured(frame, tmp_path):
    path = spoilt_file(frame, tmp_path, "x1", np.nan, [0, 1])
    assert read_record(path).n_samples == len(frame)


@pytest.mark.parametrize("form", ["%.9f", "%.6e", "%+.5f"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_file_that_ends_inside_a_number_loses_its_last_row(
    frame, tmp_path, form, separator
):
    """0.000123 is not 0.0: every number that is read is one that was written."""
    path = tmp_path / "copied.csv"
    frame.to_csv(path, index=False, sep=separator, float_format=form)
    text = path.read_text()
    truth = pd.read_csv(path, sep=separator)
    last_number = text.splitlines()[-1].split(separator)[-1]
    # the line feed and some digits are lost
    for n_lost in range(2, len(last_number) + 1):
        path.write_text(text[:-n_lost])
        table = read_table(path)
        assert "ends inside a number" in " ".join(table.notes), n_lost
        for name in truth:
            expected = truth[name][:299]
            np.testing.assert_allclose(table.variables[name], expected, rtol=1e-12)


def test_a_last_line_without_its_line_feed_is_complete(frame, tmp_path):
    path = tmp_path / "copied.csv"
    frame.to_csv(path, index=False, float_format="%.9f")
    path.write_text(path.read_text()[:-1])
    table = read_table(path)
    assert len(table.variables["t"]) == 300
    assert "inside" not in " ".join(table.notes)


def test_a_file_of_this_package_that_is_cut_is_refused(frame, tmp_path):
    path = write_record(Record.from_frame(frame), tmp_path / "own.csv")
    content = path.read_bytes()
    path.write_bytes(content[:-3])
    with pytest.raises(FileFormatError, match="last line is cut off"):
        read_record(path)
    path.write_bytes(b"".join(content.splitlines(keepends=True)[:100]))
    with pytest.raises(FileFormatError, match="had 300 samples, 98 of"):
        read_record(path)
