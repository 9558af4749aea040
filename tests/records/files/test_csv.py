"""Delimited text as people and programs write it: the numbers that were measured, or a
refusal that names the cell.
"""

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


def test_units_in_a_header_or_on_their_own_line(written):
    assert read_table(written("t [s];Laser 2 (mm);hammer\n0;1;2\n1;2;3\n")).units == {
        "t": "s",
        "Laser 2": "mm",
    }
    table = read_table(written("t;x1;F1\ns;mm;kN\n0;1;2\n1;2;3\n"))
    assert table.units == {"t": "s", "x1": "mm", "F1": "kN"}
    np.testing.assert_array_equal(table.variables["F1"], [2, 3])


def test_brackets_that_hold_no_unit_stay_in_the_name(written):
    """Numbers of floors and compass directions; (N) and (S) of one name are not a force
    and a time.
    """
    table = read_table(written("t,a (floor 1),a (floor 2)\n0,1,2\n1,2,3\n"))
    assert list(table.variables) == ["t", "a (floor 1)", "a (floor 2)"]
    path = written("t [s],acc (N),acc (S),laser (mm)\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    rec = read_record(path, mapping={"a1": "acc (N)", "a2": "acc (S)", "x1": "laser"})
    np.testing.assert_array_equal(rec.acceleration, [[1, 2], [2, 3], [3, 4]])
    np.testing.assert_allclose(rec.displacement[:, 0], [3e-3, 4e-3, 5e-3])


@pytest.mark.parametrize(
    "name",
    ["(" * 40_000, "a" + "[" * 40_000, "a (" * 13_000, "a [" + " " * 40_000 + "x]"],
    ids=len,
)
def test_a_header_of_brackets_is_a_name_like_any_other(written, name):
    """In a moment; and no message drowns in it."""
    start = time.perf_counter()
    with pytest.raises(
        FileFormatError, match="no column is known to be a motion"
    ) as error:
        read_record(written(f"t,{name}\n0,1\n1,2\n"))
    assert time.perf_counter() - start < 1.0 and len(str(error.value)) < 400


@pytest.mark.parametrize("cell", ["1.5,", "1.5"])
def test_a_text_of_one_line_is_refused_by_its_first_part(written, cell):
    with pytest.raises(FileFormatError, match="first line is longer than 64 KB"):
        read_table(written(cell * 5_000_000))


def test_a_name_that_is_no_text_is_written_as_its_code(frame, tmp_path):
    path = tmp_path / os.fsdecode(b"test \xff.csv")
    frame.to_csv(path, index=False)
    record = read_record(path)
    assert record.name == r"test \udcff"
    assert read_record(write_record(record, tmp_path / "own.csv")).name == record.name


def test_cells_that_a_spreadsheet_would_run_are_quoted(frame, tmp_path):
    table = pd.DataFrame(
        {
            "=1+1": ["=cmd", "+1", "-2", "@x", "m1\r=1"],
            "value": [-1.5, 2.0, 3.0, 4.0, 5.0],
        }
    )
    lines = write_table(table, tmp_path / "a.csv").read_text().splitlines()
    assert lines == [
        "'=1+1,value",
        "'=cmd,-1.5",
        "'+1,2.0",
        "'-2,3.0",
        "'@x,4.0",
        "m1 =1,5.0",
    ]  # a row is a line
    record = Record.from_frame(frame.assign(**{"=volt": 1.0}))
    path = write_record(record, tmp_path / "b.csv")
    assert ",'=volt" in path.read_text().splitlines()[1] and list(
        read_record(path).covariates
    ) == ["=volt"]


def test_columns_without_names_are_numbered(written):
    table = read_table(written("0 1\n1 2\n2 3\n", "test.dat"))
    assert list(table.variables) == ["c1", "c2"] and "no names" in table.notes[0]
    # a comma between columns is not a decimal comma
    np.testing.assert_array_equal(
        read_table(written("1,5\n2,6\n3,7\n")).variables["c2"], [5, 6, 7]
    )


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_encodings(written, encoding):
    assert list(
        read_table(written("Zeit;Größe\n0;1\n1;2\n", encoding=encoding)).variables
    ) == ["Zeit", "Größe"]


T = np.arange(200) / 200.0
X = 1.2e-3 * np.sin(20 * T)  # m
A = -400 * X  # m/s^2, of the same motion
F = 1500 * np.cos(20 * T) + 3  # N


def point(values):
    return [f"{v:.9g}" for v in values]


def comma(values):
    return [text.replace(".", ",") for text in point(values)]


def thousands(values, mark):
    return [f"{v:,.0f}".replace(",", mark) for v in values]


def test_a_point_of_thousands_beside_a_decimal_comma_is_not_a_decimal_point(
    columns_file,
):
    """ "1.503" is 1503 N; the other columns of the file can still be read."""
    path = columns_file("t;x1;F1", [comma(T), comma(X), thousands(F, ".")])
    words = r"F1 .*'1\.503' in data row 1, in a file with a decimal comma.* thousands"
    with pytest.raises(FileFormatError, match=words):
        read_record(path)
    np.testing.assert_allclose(
        read_record(path, mapping={"F1": "none"}).displacement[:, 0], X, atol=1e-11
    )
    other = columns_file(
        "t;volt;Shaker", [comma(T), comma(X), thousands(F, ".")], name="b.csv"
    )
    with pytest.raises(FileFormatError, match=r"F1 .*'1\.503'"):
        read_record([path, other], mapping={"x1": "own.x1", "F1": "b.Shaker"})


@pytest.mark.parametrize("mark", [",", "'", "\u202f"])
def test_marks_of_thousands_are_named_with_the_cure(columns_file, mark):
    path = columns_file(
        "t;x1;F1", [point(T), point(X), [f"{v:,.3f}".replace(",", mark) for v in F]]
    )
    with pytest.raises(
        FileFormatError, match="F1 .*in data row 1.*without marks of thousands"
    ):
        read_record(path)


@pytest.mark.parametrize(
    "head",
    [
        "t;x1;a1;F1\ns;mm;g;kN",
        "s;mm;g;kN\nt;x1;a1;F1",
        "Rig 7\n[s];[mm];[g];[kN]\nt;x1;a1;F1",
    ],
)
def test_a_row_of_units_counts_below_and_above_the_names(columns_file, head):
    record = read_record(
        columns_file(
            head, [point(T), point(1e3 * X), point(A / 9.80665), point(F / 1e3)]
        )
    )
    np.testing.assert_allclose(record.displacement[:, 0], X, atol=1e-11)
    np.testing.assert_allclose(record.acceleration[:, 0], A, atol=1e-9)
    np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


def test_a_factor_beside_a_unit_in_the_header_asks_for_the_unit_of_the_product(
    columns_file,
):
    path = columns_file("t;Laser [mm];Cell", [point(T), point(500 * X), point(F / 35)])
    with pytest.raises(
        ChannelError,
        match=r"x1 = 'Laser \* 2' .* in mm.*'Laser \* 2 @ mm' or 'Laser \* 2 @ m'",
    ):
        read_record(path, mapping={"x1": "Laser * 2"})
    for text, size in (
        ("Laser * 2 @ mm", 1.0),
        ("Laser * 0.002 @ m", 1.0),
        ("-Laser", -0.5),
    ):
        record = read_record(
            path, mapping={"x1": text, "F1": "Cell * 35"}
        )  # volts become newtons
        np.testing.assert_allclose(record.displacement[:, 0], size * X, atol=1e-11)
        np.testing.assert_allclose(record.force[:, 0], F, rtol=1e-8)


@pytest.mark.parametrize("tail", ["Max;1;2\n", "End of test\n", "% end\n"])
def test_a_footer_is_named(columns_file, tail):
    path = columns_file("t;x1;F1", [point(T), point(X), point(F)], tail=tail)
    with pytest.raises(
        FileFormatError,
        match=rf"time holds the text '{tail.split(';')[0].strip()}' in data row 201",
    ):
        read_record(path)


def test_times_of_day_and_timestamps_are_a_clock(columns_file, written):
    of_day = [f"12:00:{59 + t:06.3f}" if t < 1 else f"12:01:{t - 1:06.3f}" for t in T]
    path = columns_file("Time;x1;F1", [of_day, point(X), point(F)])
    with warnings.catch_warnings(action="error"):
        assert read_record(path).fs == pytest.approx(200.0, rel=1e-12)
    stamps = "".join(f"2024-05-01T12:00:00.{k},{k}\n" for k in ("00", "25", "50"))
    assert read_record(written("time,a1\n" + stamps)).fs == pytest.approx(4.0)


def test_a_word_among_numbers_is_located(written):
    rows = "".join(f"{i / 100},{i}\n" for i in range(200))
    with pytest.raises(FileFormatError, match="'overload' in data row 201"):
        read_record(written(f"t,a1\n{rows}2.00,overload\n2.01,3\n"))


@pytest.mark.parametrize(
    ("column", "value", "rows"),
    [
        ("a1", -9999.0, [100, 101, 102]),
        ("F2", -9999.0, [50, 200]),
        ("x2", -999.25, [299]),
        ("v1", 1e30, [7, 8]),
        ("x1", 99999.0, [0, 1]),
    ],
)
def test_a_file_with_numbers_for_not_measured_is_refused(
    frame, tmp_path, column, value, rows
):
    """With column, rows and cure; the same table with empty cells at its start is
    read.
    """
    bad = frame.copy()
    bad.loc[rows, column] = value
    path = tmp_path / "logger.csv"
    bad.to_csv(path, index=False)
    where = (
        rf"hannel {column} = '{column}' of .*logger.csv holds {re.escape(f'{value:g}')}"
        rf" in rows? {rows[0]}"
    )
    with pytest.raises(FileFormatError, match=where) as error:
        read_record(path)
    assert "split_at_gaps" in str(error.value) and "not measured" in str(error.value)
    units = {column[0]: {"a": "g", "F": "kN", "x": "mm", "v": "mm/s"}[column[0]]}
    with pytest.raises(
        FileFormatError, match=re.escape(f"holds {value:g} in")
    ):  # as it is written, whatever the unit
        read_record(path, units=units)
    if rows[0] == 0:
        bad.loc[rows, column] = np.nan
        bad.to_csv(path, index=False)
        assert read_record(path).n_samples == len(frame)


@pytest.mark.parametrize("form", ["%.9f", "%.6e", "%+.5f"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_file_that_ends_inside_a_number_loses_its_last_row_and_no_more(
    frame, tmp_path, form, separator
):
    """0.000123 is not 0.0: every number that is read is one that was written."""
    path = tmp_path / "copied.csv"
    frame.to_csv(path, index=False, sep=separator, float_format=form)
    whole = path.read_text()
    truth = pd.read_csv(path, sep=separator)
    for lost in range(
        2, len(whole.splitlines()[-1].split(separator)[-1]) + 1
    ):  # the line feed and some digits
        path.write_text(whole[:-lost])
        read = read_table(path)
        assert "ends inside a number" in " ".join(
            read.notes
        ) and "last row is left out" in " ".join(read.notes), lost
        for name in truth:
            np.testing.assert_allclose(
                read.variables[name], truth[name][:299], rtol=1e-12
            )
    path.write_text(whole[:-1])  # a last line without its line feed is complete
    read = read_table(path)
    assert len(read.variables["t"]) == 300 and "inside" not in " ".join(read.notes)


def test_a_file_of_this_package_that_is_cut_is_refused(frame, tmp_path):
    path = write_record(Record.from_frame(frame), tmp_path / "own.csv")
    whole = path.read_bytes()
    path.write_bytes(whole[:-3])
    with pytest.raises(
        FileFormatError,
        match=r"own.csv cannot be read as delimited text: its last line is cut off",
    ):
        read_record(path)
    path.write_bytes(b"".join(whole.splitlines(keepends=True)[:100]))
    with pytest.raises(FileFormatError, match="had 300 samples, 98 of"):
        read_record(path)
