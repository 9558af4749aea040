"""Spreadsheets as people and programs write them: nothing is lost in silence."""

import zipfile

import numpy as np
import pandas as pd
import pytest

from pysindy_nrf.records.files import read_record, read_table

openpyxl = pytest.importorskip("openpyxl")
T = np.arange(400) / 100
LINES = np.random.default_rng(0).standard_normal((400, 3))


@pytest.fixture
def workbook(tmp_path):
    """Function that writes rows above the numbers and the numbers themselves."""

    def write(heads, numbers, **sheets):
        book = openpyxl.Workbook()
        contents = {"Data": (heads, numbers), **sheets}
        for title, (above, below) in contents.items():
            sheet = book.active if title == "Data" else book.create_sheet(title)
            for row in [*above, *np.asarray(below, dtype=object).tolist()]:
                sheet.append(row)
        book.active.title = "Data"
        path = tmp_path / "own.xlsx"
        book.save(path)
        return path

    return write


def test_columns_of_one_name_are_all_there(workbook):
    head = ["Time [s]", "Force [N]", "Acc [g]", "Acc [g]"]
    table = read_table(workbook([head], np.c_[T, LINES]))
    assert [*table.variables] == ["Time", "Force", "Acc (column C)", "Acc (column D)"]
    assert table.units["Acc (column D)"] == "g"
    column = table.variables["Acc (column C)"]
    np.testing.assert_allclose(column, LINES[:, 1], rtol=1e-12)
    assert "several columns are named 'Acc'" in table.in_words


def test_three_rows_of_point_quantity_and_unit(workbook):
    heads = [
        ["Point", "F:TOP", "ACC:1", "ACC:2"],
        ["Quantity", "Force", "Acceleration", "Acceleration"],
        ["s", "N", "g", "g"],
    ]
    table = read_table(workbook(heads, np.c_[T, LINES]))
    assert [*table.variables][2:] == ["ACC:1 Acceleration", "ACC:2 Acceleration"]
    assert table.units["ACC:2 Acceleration"] == "g"


def test_groups_above_names_that_repeat(workbook):
    """A cell that is merged over several columns is written once."""
    heads = [
        [None, "Floor 1", None, "Floor 2", None],
        ["t", "acc", "disp", "acc", "disp"],
        ["s", "g", "mm", "g", "mm"],
    ]
    table = read_table(workbook(heads, np.c_[T, LINES, LINES[:, 0]]))
    assert [*table.variables][1:3] == ["Floor 1 acc", "Floor 1 disp"]
    assert table.units["Floor 2 disp"] == "mm"


@pytest.mark.parametrize("stale", ["A1", "A1:B401", "A1:D31"])
def test_a_stale_range_loses_nothing(workbook, tmp_path, stale):
    path = workbook([["t", "F1", "x1", "x2"]], np.c_[T, LINES])
    other = tmp_path / "stale.xlsx"
    with zipfile.ZipFile(path) as book, zipfile.ZipFile(other, "w") as written:
        for item in book.infolist():
            content = book.read(item.filename)
            if item.filename.endswith("sheet1.xml"):
                assert b'ref="A1:D401"' in content
                content = content.replace(b"A1:D401", stale.encode())
            written.writestr(item.filename, content)
    record = read_record(other)
    assert record.n_samples == 400
    np.testing.assert_allclose(record.displacement, LINES[:, 1:], rtol=1e-12)


def test_blank_rows_are_dropped_and_said(workbook):
    blank = [[None] * 4] * 30
    numbers = [*np.c_[T, LINES].tolist(), *blank]
    numbers[200:200] = blank[:2]
    path = workbook([["t", "F1", "x1", "x2"]], numbers)
    assert "32 empty rows left out" in read_table(path).in_words
    assert read_record(path).n_samples == 400


def test_blank_rows_inside_without_a_time_are_kept(workbook):
    """Where no time shows what is missing there, rows are not joined."""
    numbers = LINES.tolist()
    numbers[200:200] = [[None] * 3] * 2
    table = read_table(workbook([["F1", "x1", "x2"]], numbers))
    assert np.isnan(table.variables["x1"]).sum() == 2


def test_a_blank_tail_of_a_text(written):
    rows = [f"{t},{np.sin(t)},{np.cos(t)}" for t in T]
    text = "\n".join(["t,F1,x1", *rows, *[",,"] * 50]) + "\n"
    path = written(text)
    assert read_record(path).n_samples == 400
    assert "50 empty rows left out" in read_table(path).in_words


def test_a_force_on_another_sheet_is_mentioned(workbook):
    load = ([["Time [s]", "Load [kN]"]], np.c_[T[:300], LINES[:300, 0]])
    path = workbook([["t", "x1", "x2", "x3"]], np.c_[T, LINES], Jack=load)
    words = read_table(path).in_words
    assert "it seems to hold a force" in words
    assert "'Jack'" in words


def test_stamps_and_remarks_in_columns_of_text(workbook):
    stamps = pd.date_range("2024-05-01", periods=400, freq="10ms").to_pydatetime()
    numbers = [[s, *row, "ok"] for s, row in zip(stamps, LINES.tolist())]
    path = workbook([["Time", "F1", "x1", "x2", "remark"]], numbers)
    assert read_record(path).fs == pytest.approx(100)


def test_columns_of_one_name_in_a_text(written):
    text = "t,acc [g],acc [g]\n" + "".join(f"{k / 9},{k},{-k}\n" for k in range(9))
    table = read_table(written(text))
    assert [*table.variables] == ["t", "acc (column B)", "acc (column C)"]
    assert table.units["acc (column C)"] == "g"
