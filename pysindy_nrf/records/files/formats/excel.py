"""Excel files (.xlsx)."""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ....common.lazy import require
from ....exceptions import FileFormatError
from ..mapping.words import letter_named
from ..table import (
    MAX_BYTES,
    Table,
    check_size,
    reading_as,
    two_columns_of_one_name,
    without_empty_rows,
)
from .dialect import Header, header_of

MAX_NAMES_SHOWN = 6
Row = Sequence[object]  # cells, None where nothing is written


def read_excel(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the longest sheet of an Excel file.

    It has up to three rows of names and units, and rows of numbers.
    """
    sheets = _sheets(path, max_bytes)
    title = max(sheets, key=lambda title: len(sheets[title]))
    rows = sheets[title]
    start = _first_row_of_numbers(rows)
    if start is None:
        raise FileFormatError(
            f"{path}: the sheet {title!r} holds no rows of numbers",
            "Give numbers, one row per sample; a decimal comma that Excel took for text"
            " is no number.",
        )

    width = max(map(_width, rows[start:]))
    header = header_of([_texts(row, width) for row in rows[:start]], width)
    header.require_distinct_channels(path)
    has_time = any(letter_named(name) == "t" for name in header.names)
    frame = pd.DataFrame([_cells(row, width) for row in rows[start:]])
    frame, notes_on_rows = without_empty_rows(frame, has_time)

    variables, units = _variables(path, header, frame)
    notes = [f"sheet {title!r}", *header.notes, *notes_on_rows]
    notes += _notes_on_others(sheets, title)
    return Table(path, "Excel", variables, units, tuple(notes))


def _variables(
    path: Path, header: Header, frame: pd.DataFrame
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Values and units of the columns by name; empty ones without a name are none."""
    variables: dict[str, np.ndarray] = {}
    units = {}
    for k in range(frame.shape[1]):
        if not header.names[k] and frame[k].isna().all():
            continue
        name = header.names[k] or f"c{k + 1}"
        if name in variables:
            raise two_columns_of_one_name(path, name)
        is_numeric = frame[k].dtype.kind in "biuf"
        variables[name] = frame[k].to_numpy(dtype=float if is_numeric else None)
        if header.units[k]:
            units[name] = header.units[k]
    return variables, units


def _sheets(path: Path, max_bytes: int) -> dict[str, list[Row]]:
    """Rows of each sheet by its title."""
    openpyxl = require("openpyxl", "files", "Reading Excel sheets")
    with reading_as(path, "Excel"):
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(item.file_size for item in archive.infolist())
        check_size(path, unpacked, max_bytes)

        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = {}
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # some programs write a range that is too small
            sheets[sheet.title] = list(sheet.iter_rows(values_only=True))
    if not sheets:
        raise FileFormatError(
            f"{path} has no sheet of cells", "Save the channels on a sheet of cells."
        )
    return sheets


def _notes_on_others(sheets: Mapping[str, Sequence[Row]], title: str) -> list[str]:
    """What the sheets beside the one that is read hold."""
    notes = [_note_on(other, sheets[other]) for other in sheets if other != title]
    return [note for note in notes if note]


def _note_on(title: str, rows: Sequence[Row]) -> str:
    """What another sheet holds; empty if it holds no rows of numbers."""
    start = _first_row_of_numbers(rows)
    if start is None or len(rows) - start < 2:
        return ""
    width = max(map(_width, rows[start:]))
    header = header_of([_texts(row, width) for row in rows[:start]], width)
    names = [name for name in header.names if name]
    has_force = any(letter_named(name) == "F" for name in [title, *names])
    care = "take care, it seems to hold a force: " if has_force else ""
    return (
        f"{care}the sheet {title!r} with {', '.join(names[:MAX_NAMES_SHOWN])} is not"
        " read; save it as a file of its own and join the two (together = true)"
    )


def _width(row: Row) -> int:
    """Number of cells up to the last that is filled."""
    width = len(row)
    while width and row[width - 1] is None:
        width -= 1
    return width


def _cells(row: Row, width: int) -> list[object]:
    """Cells of a row in this width; blanks alone are an empty cell."""
    cells = [*row[:width], *[None] * (width - len(row))]
    return [None if isinstance(c, str) and not c.strip() else c for c in cells]


def _first_row_of_numbers(rows: Sequence[Row]) -> int | None:
    """Position of the first row with two numbers or more.

    It has no text among them; if there is no such row, more numbers than texts.
    """
    for strict in (True, False):
        for position, row in enumerate(rows):
            filled = [cell for cell in row if cell is not None]
            n_texts = sum(isinstance(cell, str) for cell in filled)
            n_numbers = len(filled) - n_texts
            if n_numbers > 1 and n_texts < (1 if strict else n_numbers):
                return position
    return None


def _texts(row: Row, width: int) -> list[str]:
    """Cells as texts, empty where nothing is written."""
    cells = _cells(row, width)
    return ["" if cell is None else str(cell).strip() for cell in cells]
