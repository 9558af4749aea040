"""How a delimited text is written: encoding, separator, decimal mark, header, units."""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ....exceptions import FileFormatError
from ...channels import channel_of
from ..mapping.words import EASTERN_WORDS
from ..table import two_columns_of_one_name, unreadable
from ..units import is_unit, split_unit

HEAD_BYTES = 65536  # from which the dialect is found
ROWS_TRIED = 200  # below the first row of numbers
MIN_EVEN_SHARE = 0.8  # of these rows, which must have one width
MIN_SHARE_WITH_TEXT = 0.5  # of the cells of a row, where some columns are texts
LINES_COMPARED = 400  # to find the notation under which most cells are numbers
MAX_ROWS_OF_NAMES = 2  # above the last one
BLANK = " "  # separator that stands for any run of blanks

_COMMENTS = ("#", "%", "//")
MISSING = {"", "nan", "na", "n/a", "null", "none", "-nan", "inf", "-inf"}
_NUMBERS = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?"),
}
_TIMESTAMP = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d([.,]\d+)?)?Z?)?")
_COMPLEX = re.compile(r"\d[+-]\s*[\d.]+(e[+-]?\d+)?[ij]\b", re.IGNORECASE)


@dataclass(frozen=True)
class Notation:
    """What separates cells, and what marks decimals."""

    separator: str
    decimal: str

    def cells(self, line: str) -> list[str]:
        """Cells of a line."""
        if self.separator == BLANK:
            return line.split()
        if '"' not in line:
            return [cell.strip() for cell in line.split(self.separator)]
        reader = csv.reader([line], delimiter=self.separator, skipinitialspace=True)
        return [cell.strip() for cell in next(reader)]

    def share_of_numbers(self, cells: Sequence[str]) -> float:
        """Numbers and time stamps as a share of the filled cells."""
        number = _NUMBERS[self.decimal]
        n_filled = n_numbers = 0
        for cell in cells:
            if cell.lower() not in MISSING:
                n_filled += 1
                is_number = number.fullmatch(cell) or _TIMESTAMP.fullmatch(cell)
                n_numbers += bool(is_number)
        return n_numbers / n_filled if n_filled else 0.0


# In the order in which they are tried: the least likely to stand in numbers first.
NOTATIONS = [
    Notation(separator, decimal)
    for separator in (";", "\t", ",", "|", BLANK)
    for decimal in (".", ",")
    if separator != decimal
]


@dataclass(frozen=True)
class Header:
    """Names of the columns and their units, ``""`` where none is written."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    named: bool  # by the file; otherwise the names are c1, c2, ...
    repeated: tuple[str, ...] = ()  # names of more than one column

    def require_distinct_channels(self, path: Path) -> None:
        """Refuse two columns that are one channel by their name."""
        for name in self.repeated:
            if channel_of(name):
                raise two_columns_of_one_name(path, name)

    @property
    def notes(self) -> list[str]:
        """What is said of names that repeat."""
        return [
            f"several columns are named {name!r}: they are called '{name} (column A)'"
            " and so on, by the letters of a spreadsheet"
            for name in self.repeated
        ]


@dataclass(frozen=True)
class Dialect:
    """Form of a delimited text."""

    notation: Notation
    header: Header
    first_row: int  # lines above the first row of numbers
    encoding: str


@dataclass(frozen=True)
class _Text:
    """Lines of the head of a file, and the numbers of those that are no comments."""

    lines: list[str]
    content: list[int]
    encoding: str

    def cells(self, notation: Notation, start: int, stop: int) -> list[list[str]]:
        """Cells of some of the lines with content."""
        return [notation.cells(self.lines[i]) for i in self.content[start:stop]]


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith(_COMMENTS)


def sniff(path: Path) -> Dialect:
    """Find how a delimited text is written.

    Raises
    ------
    FileFormatError
        If the file holds no rows of numbers.
    """
    with open(path, "rb") as file:
        raw = file.read(HEAD_BYTES)
        is_complete = not file.read(1)
    encoding, head = _decode(raw, path)

    # splitlines() also splits at characters that pandas keeps
    lines = re.split(r"\r\n|\n|\r", head)
    if not lines[-1] or not is_complete:
        lines.pop()  # empty, or probably cut
    if not lines:
        reason = f"its first line is longer than {HEAD_BYTES // 1024} KB"
        raise unreadable(path, "delimited text", reason)

    content = [i for i, line in enumerate(lines) if not _is_comment(line)]
    text = _Text(lines, content, encoding)
    for notation in NOTATIONS:
        dialect = _dialect(text, notation, strict=True)
        if dialect is not None:
            return dialect

    # under no notation are all cells numbers, so a column holds text
    dialect = _dialect(text, _likeliest_notation(text), strict=False)
    if dialect is None:
        raise _no_numbers(path, text)
    return dialect


# Nearly any bytes decode as these; the text must also hold a word for a channel.
_EASTERN_ENCODINGS = ("cp932", "gb18030")


def _decode(raw: bytes, path: Path) -> tuple[str, str]:
    """Encoding and text of the head of a file, which may end inside a character."""
    has_mark = raw[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    if b"\x00" in raw and not has_mark:
        raise unreadable(path, "delimited text", "it holds binary data")

    encodings = ["utf-8-sig", *_EASTERN_ENCODINGS, "latin-1"]
    for encoding in ["utf-16"] if has_mark else encodings:
        try:
            text = codecs.getincrementaldecoder(encoding)().decode(raw)
        except UnicodeError:
            continue
        is_eastern = encoding in _EASTERN_ENCODINGS
        if not is_eastern or any(word in text for word in EASTERN_WORDS):
            return encoding, text
    raise unreadable(
        path, "delimited text", "its characters are neither UTF-8 nor UTF-16"
    )


def _dialect(text: _Text, notation: Notation, strict: bool) -> Dialect | None:
    """The dialect, if a notation gives even rows of numbers.

    Strict: every cell of a row is a number; otherwise more than half of them are.
    """
    start = _first_row_of_numbers(text, notation, strict)
    if start is None:
        return None
    body = text.cells(notation, start, start + ROWS_TRIED)
    if not _is_even(body, notation, strict):
        return None

    width = len(body[0])
    first_row = text.content[start]
    rows_above = text.cells(notation, 0, start)
    above = [cells for cells in rows_above if len(cells) == width]
    if not above:
        above = _names_in_comment(text.lines[:first_row], notation, width)
    return Dialect(notation, header_of(above, width), first_row, text.encoding)


def _first_row_of_numbers(text: _Text, notation: Notation, strict: bool) -> int | None:
    """Position of the first row of numbers among the lines with content."""
    for position, i in enumerate(text.content):
        if _is_row_of_numbers(notation.cells(text.lines[i]), notation, strict):
            return position
    return None


def _is_even(body: list[list[str]], notation: Notation, strict: bool) -> bool:
    """Whether most rows are numbers in columns, with commas if these mark decimals."""
    width = len(body[0])
    n_even = 0
    n_commas = 0
    for cells in body:
        is_even = len(cells) == width and _is_row_of_numbers(cells, notation, strict)
        n_even += is_even
        n_commas += "".join(cells).count(",")
    if notation.decimal == "," and not n_commas:
        return False
    return n_even >= MIN_EVEN_SHARE * len(body)


def _is_row_of_numbers(cells: list[str], notation: Notation, strict: bool) -> bool:
    """Whether enough cells of a line are numbers.

    A single column has no separator; it is found once, in the strict trial of commas.
    """
    share = notation.share_of_numbers(cells)
    if not strict:
        return len(cells) > 1 and share > MIN_SHARE_WITH_TEXT
    return share == 1.0 and (len(cells) > 1 or notation.separator == ",")


def _names_in_comment(
    lines: Sequence[str], notation: Notation, width: int
) -> list[list[str]]:
    """Names that stand in the last comment above the numbers: ``# t, a1, a2``."""
    comments = [line.lstrip().lstrip("#%/").strip() for line in lines if line.strip()]
    if not comments or width < 2:
        return []
    cells = notation.cells(comments[-1])
    return [cells] if len(cells) == width else []


def _likeliest_notation(text: _Text) -> Notation:
    """The notation under which most cells are numbers."""
    n_shown = sum(i < LINES_COMPARED for i in text.content)

    def count_of_numbers(notation: Notation) -> float:
        count = 0.0
        for cells in text.cells(notation, 0, n_shown):
            if len(cells) > 1:
                count += len(cells) * notation.share_of_numbers(cells)
        return count

    return max(NOTATIONS, key=count_of_numbers)


def _no_numbers(path: Path, text: _Text) -> FileFormatError:
    """Error for a text without a table of numbers."""
    if _COMPLEX.search(text.lines[-1]):
        return FileFormatError(
            f"{path} holds complex numbers, so it is a frequency response, not a"
            " record",
            "Read it with read_frf (--frf).",
        )
    first = text.lines[text.content[0]] if text.content else ""
    return FileFormatError(
        f"{path} holds no rows of numbers separated by ';', ',', tab, '|' or blanks (it"
        f" starts with {first[:60]!r})",
        "Give a table of numbers: one row per sample, one column per channel.",
    )


def header_of(above: Sequence[Sequence[str]], width: int) -> Header:
    """Names and units from the rows above the first row of numbers.

    Parameters
    ----------
    above : sequence of rows of ``width`` cells
        The last one names the columns. A row of units stands below the names, as a
        rule; some programs write it above them. Where names repeat, the rows above them
        say more: a point, a floor, a group.
    width : int
        Number of columns.
    """
    rows = list(above)
    units = _pop_units(rows, width)
    if not rows:
        names = [f"c{i}" for i in range(1, width + 1)]
        return Header(tuple(names), tuple(units), named=False)

    split = [split_unit(cell.strip('"')) for cell in rows[-1]]
    names = [cell.strip('"') for cell in rows[-1]]
    brackets: dict[str, set[str | None]] = {}
    for bare, unit in split:
        brackets.setdefault(bare, set()).add(unit)

    for i, (bare, unit) in enumerate(split):
        if unit is None:
            names[i] = bare
        # "acc (N)" and "acc (S)" are two directions of one name, not a force and a time
        elif len(brackets[bare]) == 1 and is_unit(unit):
            names[i] = bare
            units[i] = unit

    names, repeated = _distinct(names, rows[:-1])
    return Header(tuple(names), tuple(units), named=True, repeated=repeated)


def _distinct(
    names: list[str], rows_above: Sequence[Sequence[str]]
) -> tuple[list[str], tuple[str, ...]]:
    """Names that differ: by the rows above them, else by the letter of their column.

    Returns
    -------
    names : list of str
    repeated : tuple of str
        Those that only the letter of the column distinguishes.
    """
    for row in reversed(rows_above[-MAX_ROWS_OF_NAMES:]):
        if not _repeated(names):
            break
        groups = _with_blanks_filled(row)
        names = [f"{group} {name}".strip() for group, name in zip(groups, names)]

    repeated = _repeated(names)
    distinct = [
        f"{name} (column {_letter(i)})" if name in repeated else name
        for i, name in enumerate(names)
    ]
    return distinct, tuple(repeated)


def _repeated(names: Sequence[str]) -> list[str]:
    """Names that stand above more than one column."""
    return [name for name, count in Counter(names).items() if name and count > 1]


def _with_blanks_filled(row: Sequence[str]) -> list[str]:
    """Cells of a row; an empty one belongs to the group that began before it."""
    cells = []
    group = ""
    for cell in row:
        group = cell.strip('"') or group
        cells.append(group)
    return cells


def _letter(i: int) -> str:
    """Letters of a column of a spreadsheet, counted from 0: A, B, ..., AA."""
    letters = ""
    i += 1
    while i:
        i, digit = divmod(i - 1, 26)
        letters = chr(ord("A") + digit) + letters
    return letters


def _pop_units(rows: list[Sequence[str]], width: int) -> list[str]:
    """Units of the columns; their row is taken out of those above the numbers."""
    for position in (-1, -2):
        if len(rows) > 1 and _is_row_of_units(rows[position]):
            return [cell.strip("[]()- ") for cell in rows.pop(position)]
    return [""] * width


def _is_row_of_units(cells: Sequence[str]) -> bool:
    """Whether the filled cells are units, or dashes where there is none."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and all(
        is_unit(cell) or not cell.strip("[]()-") for cell in filled
    )
