"""Delimited text; how it is written is found from the file itself."""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from ..attributes import SCHEMA, Attributes
from ..mapping.words import letter_named
from ..table import (
    MAX_BYTES,
    Table,
    two_columns_of_one_name,
    unreadable,
    without_empty_rows,
)
from .dialect import BLANK, HEAD_BYTES, MISSING, Dialect, Notation, sniff

_OWN_START = f'# {{"schema": "{SCHEMA}"'.encode()  # of a record written here
TAIL_BYTES = 65536  # in which the end of a file is looked at
# Rows above the last one, which show how many decimals are written.
ROWS_ABOVE_END = 50


def read_delimited(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a delimited text file."""
    with open(path, "rb") as file:
        first = file.readline(HEAD_BYTES)
    if first.startswith(_OWN_START):
        return _read_own(path, first)

    dialect = sniff(path)
    cut_number = _number_cut_off(path, dialect)
    frame = _read_frame(path, dialect, without_last_row=bool(cut_number))
    header = dialect.header
    header.require_distinct_channels(path)
    has_time = any(letter_named(name) == "t" for name in header.names)
    frame, notes_on_rows = without_empty_rows(frame, has_time)
    variables, units = _columns(path, frame, dialect)

    notes = [_dialect_in_words(dialect), *header.notes, *notes_on_rows]
    if cut_number:
        notes.append(
            f"the file ends inside a number, {cut_number!r}: its last row is left out;"
            " was it copied completely?"
        )
    return Table(
        path,
        "delimited text",
        variables,
        units,
        tuple(notes),
        decimal=dialect.notation.decimal,
    )


def _read_frame(path: Path, dialect: Dialect, without_last_row: bool) -> pd.DataFrame:
    """The rows of numbers; columns are called by their position."""
    separator = dialect.notation.separator
    read = partial(
        pd.read_csv,
        path,
        sep=r"\s+" if separator == BLANK else separator,
        decimal=dialect.notation.decimal,
        header=None,
        names=list(range(len(dialect.header.names))),
        index_col=False,
        skiprows=dialect.first_row,
        encoding=dialect.encoding,
        skipinitialspace=True,
        comment="#",
        na_values=sorted(MISSING - {"", "inf", "-inf"}),
        low_memory=False,
    )
    try:
        frame = read()
        if without_last_row:
            # read again, since that row may have turned a column into text
            frame = read(nrows=len(frame) - 1)
        return frame
    except (ValueError, UnicodeError) as error:  # pandas' own are ValueErrors
        raise unreadable(path, "delimited text", error) from error


def _columns(
    path: Path, frame: pd.DataFrame, dialect: Dialect
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns and units by name."""
    header = dialect.header
    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for i, column in frame.items():
        # a separator at the end of each line makes an empty column without a name
        if not header.names[i] and column.isna().all():
            continue
        name = header.names[i] or f"c{i + 1}"
        if name in variables:
            raise two_columns_of_one_name(path, name)
        is_numeric = column.dtype.kind in "biuf"
        variables[name] = column.to_numpy(dtype=float if is_numeric else object)
        if header.units[i]:
            units[name] = header.units[i]
    return variables, units


def _dialect_in_words(dialect: Dialect) -> str:
    separator = dialect.notation.separator
    separators = {"\t": "tabs", BLANK: "blanks"}.get(separator, repr(separator))
    mark = "comma" if dialect.notation.decimal == "," else "point"
    text = f"columns separated by {separators}, decimal {mark}"
    if not dialect.header.named:
        text += "; no names in the file, columns are c1, c2, ..."
    return text


def _number_cut_off(path: Path, dialect: Dialect) -> str:
    """The last number of a file that ends inside it, else "".

    Such a file has no line feed at its end, and every number above the last one has
    more decimals.
    """
    start = max(0, path.stat().st_size - TAIL_BYTES)
    with open(path, "rb") as file:
        file.seek(start - start % 4)  # not inside a character of UTF-16
        tail = file.read().decode(dialect.encoding, errors="replace")
    lines = tail.splitlines(keepends=True)
    if len(lines) <= ROWS_ABOVE_END + 1 or lines[-1].endswith(("\n", "\r")):
        return ""

    notation = dialect.notation
    rows = [notation.cells(line.strip()) for line in lines[-ROWS_ABOVE_END - 1 :]]
    last = len(rows[-1]) - 1
    decimals = [_count_decimals(cells, last, notation) for cells in rows]
    return rows[-1][last] if decimals[-1] < min(decimals[:-1]) else ""


def _count_decimals(cells: list[str], column: int, notation: Notation) -> int:
    """Characters behind the decimal mark of a cell, which a short row lacks."""
    if len(cells) <= column:
        return 0
    return len(cells[column].partition(notation.decimal)[2])


def _read_own(path: Path, first: bytes) -> Table:
    """A record written by this package, its attributes in the first line."""
    with open(path, "rb") as file:
        file.seek(-1, 2)
        if file.read() not in b"\r\n":
            raise unreadable(path, "delimited text", "its last line is cut off")

    attributes = Attributes.from_json(first[1:].strip(), path)
    names = ("t",) + attributes.columns
    try:  # exact to the last digit, slower than pandas
        values = np.loadtxt(
            path, delimiter=",", skiprows=2, comments=None, ndmin=2, encoding="utf-8"
        )
    except (ValueError, UnicodeError) as error:
        raise unreadable(path, "delimited text", error) from error

    if values.shape[1] != len(names):
        reason = f"{values.shape[1]} columns where {len(names)} are announced"
        raise unreadable(path, "delimited text", reason)
    return Table(
        path, "CSV", dict(zip(names, values.T)), attributes=attributes, fs=attributes.fs
    )
