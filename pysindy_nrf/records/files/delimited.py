"""Delimited text: separator, decimal mark, comments, header and units are found from
the file itself.
"""

import csv
import re
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...common.lazy import require
from ...exceptions import FileFormatError
from .mapping import EASTERN_WORDS
from .table import (
    MAX_BYTES,
    SCHEMA,
    Attributes,
    Table,
    check_size,
    reading_as,
    unreadable,
)
from .units import is_unit

_HEAD_BYTES = _TAIL_BYTES = 65536
_ABOVE = 50  # rows above the last one that show how numbers are written
_OWN = b'# {"schema": "' + SCHEMA.encode() + b'"'
_SEPARATORS = {";": ";", "tab": "\t", ",": ",", "|": "|", "blank": r"\s+"}
_COMMENTS = ("#", "%", "//")
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-nan", "inf", "-inf"}
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?")
_TIMESTAMP = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?Z?)?")


@dataclass(frozen=True)
class Dialect:
    """Form of a delimited file."""

    separator: str  # a key of _SEPARATORS
    decimal: str
    header: tuple[str, ...]  # names of the columns, c1, c2.. where the file names none
    units: tuple[str, ...]  # "" where none is written
    first_row: int  # lines above the first row of numbers
    encoding: str
    named: bool  # the file names its columns


def read_delimited(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a delimited text file."""
    with open(path, "rb") as file:
        first = file.readline(_HEAD_BYTES)
    if first.startswith(_OWN):
        return _own(path, first)
    dialect = sniff(path)
    options: dict[str, Any] = dict(
        sep=_SEPARATORS[dialect.separator],
        decimal=dialect.decimal,
        header=None,
        names=list(range(len(dialect.header))),
        index_col=False,
        skiprows=dialect.first_row,
        encoding=dialect.encoding,
        skipinitialspace=True,
        comment="#",
        na_values=sorted(_MISSING - {"", "inf", "-inf"}),
        low_memory=False,
    )
    cut = _ends_inside_a_number(path, dialect)
    try:
        frame = pd.read_csv(path, **options)
        if (
            cut
        ):  # read again without the last row, which may have turned a column into text
            frame = pd.read_csv(path, nrows=len(frame) - 1, **options)
    except (
        pd.errors.ParserError,
        pd.errors.EmptyDataError,
        UnicodeError,
        ValueError,
    ) as error:
        raise unreadable(path, "delimited text", error) from error
    variables, units = {}, {}
    for i, name in enumerate(dialect.header):
        column = frame[i]
        if not name and column.isna().all():  # a separator at the end of each line
            continue
        label = name or f"c{i + 1}"
        if label in variables:
            raise FileFormatError(
                f"{path} has two columns named {label!r}", "Rename one."
            )
        variables[label] = column.to_numpy(
            dtype=float if column.dtype.kind in "biuf" else object
        )
        if dialect.units[i]:
            units[label] = dialect.units[i]
    mark = "decimal comma" if dialect.decimal == "," else "decimal point"
    separator = {"tab": "tabs", "blank": "blanks"}.get(
        dialect.separator, repr(dialect.separator)
    )
    unnamed = "" if dialect.named else "; no names in the file, columns are c1, c2, ..."
    notes = [f"columns separated by {separator}, {mark}{unnamed}"]
    if cut:
        notes.append(
            f"the file ends inside a number, {cut!r}: its last row is left out; was it"
            " copied completely?"
        )
    return Table(
        path, "delimited text", variables, units, notes, decimal=dialect.decimal
    )


def read_excel(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the longest sheet of an Excel file (.xlsx): a row of names, one of units if
    there is any, numbers.
    """
    openpyxl = require("openpyxl", "files", "Reading Excel sheets")
    with reading_as(path, "Excel"):
        with zipfile.ZipFile(path) as archive:
            check_size(
                path, sum(item.file_size for item in archive.infolist()), max_bytes
            )
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheet, rows = max(
            ((one.title, list(one.iter_rows(values_only=True))) for one in book),
            key=lambda x: len(x[1]),
        )

    def numeric(row: Sequence[Any]) -> bool:
        filled = [c for c in row if c is not None]
        return len(filled) > 1 and not any(isinstance(c, str) for c in filled)

    start = next((k for k, row in enumerate(rows) if numeric(row)), None)
    if start is None:
        cure = (
            "Give numbers, one row per sample; a decimal comma that Excel took for text"
            " is no number."
        )
        raise FileFormatError(
            f"{path}: the sheet {sheet!r} holds no rows of numbers", cure
        )
    width = max(k for k, c in enumerate(rows[start], 1) if c is not None)
    above = [
        (k, ["" if c is None else str(c).strip() for c in row[:width]])
        for k, row in enumerate(rows[: start + 1])
    ]
    header, units, _ = _header([], above, start, width, "tab")
    variables = {}
    for k, name in enumerate(header):
        column = pd.Series([row[k] for row in rows[start:]])
        variables[name or f"c{k + 1}"] = column.to_numpy(
            dtype=float if column.dtype.kind in "biuf" else None
        )
    known = {name: unit for name, unit in zip(header, units) if unit}
    return Table(path, "Excel", variables, known, [f"sheet {sheet!r}"])


def _ends_inside_a_number(path: Path, dialect: Dialect) -> str:
    """The last number, if the file ends without a line feed and every number above it
    has more decimals; or "".
    """
    start = max(0, path.stat().st_size - _TAIL_BYTES)
    with open(path, "rb") as file:
        file.seek(start - start % 4)  # not inside a character of UTF-16
        lines = (
            file.read()
            .decode(dialect.encoding, errors="replace")
            .splitlines(keepends=True)
        )
    if len(lines) <= _ABOVE + 1 or lines[-1].endswith(("\n", "\r")):
        return ""
    *above, last = (
        _cells(line.strip(), dialect.separator) for line in lines[-_ABOVE - 1 :]
    )

    def behind(row: list[str]) -> int:
        return (
            len(row[len(last) - 1].partition(dialect.decimal)[2])
            if len(row) >= len(last)
            else 0
        )

    return last[-1] if behind(last) < min(behind(row) for row in above) else ""


def _own(path: Path, first: bytes) -> Table:
    """A record written by this package, its attributes in the first line."""
    with open(path, "rb") as file:
        file.seek(-1, 2)
        if file.read() not in b"\r\n":
            raise unreadable(path, "delimited text", "its last line is cut off")
    attributes = Attributes.from_json(first[1:].strip(), path)
    names = ["t", *attributes.columns]
    try:  # exact to the last digit, slower than pandas
        values = np.loadtxt(
            path, delimiter=",", skiprows=2, comments=None, ndmin=2, encoding="utf-8"
        )
    except (ValueError, UnicodeError) as error:
        raise unreadable(path, "delimited text", error) from error
    if values.shape[1] != len(names):
        raise unreadable(
            path,
            "delimited text",
            f"{values.shape[1]} columns where {len(names)} are announced",
        )
    return Table(
        path, "CSV", dict(zip(names, values.T)), attributes=attributes, fs=attributes.fs
    )


def sniff(path: Path) -> Dialect:
    """Find how a delimited file is written."""
    with open(path, "rb") as file:
        raw = file.read(_HEAD_BYTES)
        whole = not file.read(1)
    if b"\x00" in raw and raw[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        raise unreadable(path, "delimited text", "it holds binary data")
    encoding, text = _decode(raw, path)
    lines = re.split(
        r"\r\n|\n|\r", text
    )  # splitlines() also splits at characters that pandas keeps
    if not lines[-1] or not whole:
        lines.pop()  # empty, or probably cut
    if not lines:
        raise unreadable(
            path,
            "delimited text",
            f"its first line is longer than {_HEAD_BYTES // 1024} KB",
        )
    trials = [(sep, mark) for sep in _SEPARATORS for mark in (".", ",") if sep != mark]
    found = next(
        filter(None, (_try(lines, *trial, encoding, 1.0) for trial in trials)), None
    )
    if (
        found is None
    ):  # a column holds text: take the reading under which most cells are numbers
        kept = [line for line in lines[:400] if not _is_comment(line)]
        rows = {
            sep: [cells for line in kept if len(cells := _cells(line, sep)) > 1]
            for sep, _ in trials
        }
        best = max(
            trials,
            key=lambda trial: sum(
                len(cells) * _share(cells, trial[1]) for cells in rows[trial[0]]
            ),
        )
        found = _try(lines, *best, encoding, 0.5)
    if found is not None:
        return found
    first = next((line for line in lines if not _is_comment(line)), "")
    if re.search(
        r"\d[+-]\s*[\d.]+(e[+-]?\d+)?[ij]\b", lines[-1] if lines else "", re.IGNORECASE
    ):
        cure = "Read it with read_frf (--frf)."
        raise FileFormatError(
            f"{path} holds complex numbers, so it is a frequency response, not a"
            " record",
            cure,
        )
    what = (
        f"{path} holds no rows of numbers separated by ';', ',', tab, '|' or blanks (it"
        f" starts with {first[:60]!r})"
    )
    raise FileFormatError(
        what, "Give a table of numbers: one row per sample, one column per channel."
    )


_EASTERN = (
    "cp932",
    "gb18030",
)  # nearly any bytes are a text in them: one that speaks of channels is


def _decode(raw: bytes, path: Path) -> tuple[str, str]:
    marked = raw[:2] in (b"\xff\xfe", b"\xfe\xff")
    for encoding in ("utf-16",) if marked else ("utf-8-sig", *_EASTERN, "latin-1"):
        for cut in range(4):  # the head may end inside a character
            with suppress(UnicodeError):
                text = raw[: len(raw) - cut].decode(encoding)
                if encoding not in _EASTERN or any(
                    word in text for word in EASTERN_WORDS
                ):
                    return encoding, text
    raise unreadable(
        path, "delimited text", "its characters are neither UTF-8 nor UTF-16"
    )


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(_COMMENTS)


def _cells(line: str, separator: str) -> list[str]:
    if separator == "blank":
        return line.split()
    mark = _SEPARATORS[separator]
    if '"' not in line:
        return [cell.strip() for cell in line.split(mark)]
    return [
        cell.strip()
        for cell in next(csv.reader([line], delimiter=mark, skipinitialspace=True))
    ]


def _share(cells: list[str], decimal: str) -> float:
    """Numbers as a share of the filled cells."""
    number = _POINT if decimal == "." else _COMMA
    filled = [c for c in cells if c.lower() not in _MISSING]
    good = sum(bool(number.fullmatch(c) or _TIMESTAMP.fullmatch(c)) for c in filled)
    return good / len(filled) if filled else 0.0


def _try(
    lines: list[str], separator: str, decimal: str, encoding: str, share: float
) -> Dialect | None:
    """The dialect, if this separator and decimal mark give consecutive rows of numbers;
    or None.
    """

    def is_row(cells: list[str]) -> bool:
        return (
            _share(cells, decimal) >= share
            if share == 1.0
            else _share(cells, decimal) > share
        )

    rows = [
        (i, _cells(line, separator))
        for i, line in enumerate(lines)
        if not _is_comment(line)
    ]
    least = 1 if separator == "," and share == 1.0 else 2
    start = next(
        (
            k
            for k, (_, cells) in enumerate(rows)
            if len(cells) >= least and is_row(cells)
        ),
        None,
    )
    if start is None:
        return None
    width = len(rows[start][1])
    body = rows[start : start + 200]
    even = sum(len(cells) == width and is_row(cells) for _, cells in body)
    if (
        even < 0.8 * len(body)
        or decimal == ","
        and not any("," in cell for _, cells in body for cell in cells)
    ):
        return None
    header, units, named = _header(lines, rows, start, width, separator)
    return Dialect(separator, decimal, header, units, rows[start][0], encoding, named)


def split_unit(column: str) -> tuple[str, str | None]:
    """Name of a column and the unit written behind it, ``"a1 [mm]"``, ``"a1 (g)"`` or
    in brackets of full width.
    """
    text = column.strip()
    opening = text.rfind(
        {"]": "[", ")": "(", "）": "（", "］": "［", "】": "【"}.get(text[-1:], "\n")
    )
    name = text[: max(opening, 0)].strip()
    return (name, text[opening + 1 : -1].strip() or None) if name else (text, None)


def _header(
    lines: list[str],
    rows: list[tuple[int, list[str]]],
    start: int,
    width: int,
    separator: str,
) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    above = [cells for _, cells in rows[:start] if len(cells) == width]
    if not above:
        # names may stand in the last comment line: "# t, a1, a2"
        comments = [
            line.lstrip().lstrip("#%/").strip()
            for line in lines[: rows[start][0]]
            if line.strip()
        ]
        cells = _cells(comments[-1], separator) if comments else []
        if len(cells) == width and width > 1:
            above = [cells]
    units = [""] * width
    for row in (-1, -2):  # below the names, as a rule; some programs write them above
        if (
            len(above) > 1
            and any(above[row])
            and all(not c or is_unit(c) or not c.strip("[]()-") for c in above[row])
        ):
            units = [c.strip("[]()- ") for c in above.pop(row)]
            break
    if not above:
        return tuple(f"c{i + 1}" for i in range(width)), tuple(units), False
    cells = [cell.strip('"') for cell in above[-1]]
    split = [split_unit(cell) for cell in cells]
    bare = [name for name, _ in split]
    names = []
    for i, (name, unit) in enumerate(split):
        # "acc (N)" and "acc (S)" are two directions of one name, not a force and a time
        measured = unit is not None and bare.count(name) == 1 and is_unit(unit)
        names.append(name if unit is None or measured else cells[i])
        units[i] = unit if measured and unit else units[i]
    return tuple(names), tuple(units), True
