"""Excel files (.xlsx)."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ....common.lazy import require
from ....exceptions import FileFormatError
from ..table import MAX_BYTES, Table, check_size, reading_as
from .dialect import header_of

Row = Sequence[object]  # cells, None where nothing is written


def read_excel(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the longest sheet of an Excel file.

    It has a row of names, one of units if there is any, and rows of numbers.
    """
    title, rows = _longest_sheet(path, max_bytes)
    start = _first_row_of_numbers(rows)
    if start is None:
        raise FileFormatError(
            f"{path}: the sheet {title!r} holds no rows of numbers",
            "Give numbers, one row per sample; a decimal comma that Excel took for text"
            " is no number.",
        )

    width = len(rows[start])
    while rows[start][width - 1] is None:
        width -= 1
    columns = pd.DataFrame(rows[start:])
    header = header_of([_texts(row[:width]) for row in rows[:start]], width)

    variables, units = {}, {}
    for k in range(width):
        name = header.names[k] or f"c{k + 1}"
        is_numeric = columns[k].dtype.kind in "biuf"
        variables[name] = columns[k].to_numpy(dtype=float if is_numeric else None)
        if header.units[k]:
            units[name] = header.units[k]
    return Table(path, "Excel", variables, units, (f"sheet {title!r}",))


def _longest_sheet(path: Path, max_bytes: int) -> tuple[str, list[Row]]:
    """Title and rows of the sheet with the most rows."""
    openpyxl = require("openpyxl", "files", "Reading Excel sheets")
    with reading_as(path, "Excel"):
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        check_size(path, unpacked, max_bytes)

        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        title = ""
        rows: list[Row] = []
        for sheet in book:
            rows_of_sheet = list(sheet.iter_rows(values_only=True))
            if not title or len(rows_of_sheet) > len(rows):
                title, rows = sheet.title, rows_of_sheet
    return title, rows


def _first_row_of_numbers(rows: Sequence[Row]) -> int | None:
    """Position of the first row with two cells or more and no text among them."""
    for position, row in enumerate(rows):
        filled = [cell for cell in row if cell is not None]
        if len(filled) > 1 and not any(isinstance(cell, str) for cell in filled):
            return position
    return None


def _texts(row: Row) -> list[str]:
    """Cells as texts, empty where nothing is written."""
    return ["" if cell is None else str(cell).strip() for cell in row]
