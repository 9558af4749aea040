"""Proposed channels for the columns of a file, from their units, numbers and words."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

import numpy as np

from ...channels import channel_of
from ..table import Table
from ..units import kind_of_unit, si_unit, split_suffix
from .expression import as_name
from .words import WORDS_OF_BASE, WORDS_OF_TOP, letter_named, names_one_of

# Numbers in names count floors if none is larger than this many times the columns.
MAX_FLOORS_PER_COLUMN = 2


@dataclass(frozen=True)
class Proposal:
    """What a column is taken to be.

    Parameters
    ----------
    channel, text : str
        The channel and its mapping.
    doubts : tuple of str
        What is not sure about it.
    """

    channel: str
    text: str
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Column:
    """A column that is a channel of a known kind, on a floor to be found."""

    letter: str
    name: str  # without its unit
    text: str  # its mapping
    doubts: tuple[str, ...]
    floor: int = 0  # 0 for the base

    @property
    def channel(self) -> str:
        if self.letter == "t":
            return "t"
        return f"{self.letter}{self.floor}" if self.floor else f"{self.letter}g"

    @property
    def numbers(self) -> list[int]:
        """Numbers in the name."""
        return [int(digits) for digits in re.findall(r"\d+", self.name)]

    @property
    def is_of_base(self) -> bool:
        return names_one_of(self.name, WORDS_OF_BASE)

    @property
    def is_of_top(self) -> bool:
        return names_one_of(self.name, WORDS_OF_TOP)

    def on_floor(self, floor: int, *doubts: str) -> _Column:
        """The same on a floor, with further doubts."""
        return replace(self, floor=floor, doubts=self.doubts + doubts)


def propose(table: Table) -> list[Proposal]:
    """Channels of the columns of a file, with what is not sure about them."""
    by_letter = defaultdict(list)
    for column in _without_input_numbers(_channel_columns(table)):
        by_letter[column.letter].append(column)

    placed = by_letter["t"][:1]
    for letter in "axv":
        placed += _motions_on_floors(by_letter[letter])
    n_floors = max([column.floor for column in placed], default=0)
    placed += _forces_on_floors(by_letter["F"], max(n_floors, 1))

    proposals: dict[str, Proposal] = {}
    for column in placed:
        proposal = Proposal(column.channel, column.text, column.doubts)
        proposals.setdefault(column.channel, proposal)
    return list(proposals.values())


def _channel_columns(table: Table) -> list[_Column]:
    """Columns that may be channels, of the longest variables."""
    lengths = [len(values) for values in table.variables.values() if values.ndim]
    longest = max(lengths, default=0)
    columns: list[_Column] = []
    for name, values in table.variables.items():
        if values.ndim in (1, 2) and len(values) == longest:
            columns += _columns_of_variable(name, values, table.units.get(name))
    return columns


def _columns_of_variable(
    name: str, values: np.ndarray, unit: str | None
) -> Iterator[_Column]:
    """A variable as a channel, or each column of a matrix as one."""
    bare, suffix = split_suffix(name)
    unit = unit or suffix
    letter = _letter_of(bare, unit)
    if letter is None:
        return

    doubts = _doubts(bare, unit, letter)
    text = as_name(name)
    if values.ndim == 1:
        yield _Column(letter, bare, text, doubts)
        return
    for k in range(values.shape[1]):
        yield _Column(letter, f"{bare} {k + 1}", f"{text}[:, {k}]", doubts)


def _letter_of(name: str, unit: str | None) -> str | None:
    """Letter of the channel of a column: by its unit, its name or its words."""
    channel = channel_of(name)
    words = letter_named(name)
    if words == "" and channel is None:
        return None  # a temperature, a counter
    if kind_of_unit(unit):
        return kind_of_unit(unit)
    return channel[0] if channel else words


def _doubts(name: str, unit: str | None, letter: str) -> tuple[str, ...]:
    """What is not sure about the kind of a column."""
    if channel_of(name) is not None:
        return ()
    if not unit:
        taken = si_unit("t" if letter == "t" else f"{letter}1")
        return (f"no unit: {taken} taken",)
    words = letter_named(name)
    if words and kind_of_unit(unit) and kind_of_unit(unit) != words:
        return (f"its unit {unit} is not that of its name",)
    return ()


def _without_input_numbers(columns: list[_Column]) -> list[_Column]:
    """Names without the numbers that count the inputs of a logger.

    These run through channels of all kinds: ``AI 1/Shaker top``, ``AI 2/Acc 1``.
    """
    counted = defaultdict(list)  # letter and number, by the text before the number
    for column in columns:
        if column.letter == "t":
            continue
        for number in re.finditer(r"\d+", column.name):
            before = column.name[: number.start()]
            counted[before].append((column.letter, number[0]))

    for before in sorted(counted, key=len, reverse=True):
        letters, numbers = map(set, zip(*counted[before]))
        if len(letters) > 1 and len(numbers) == len(counted[before]):
            columns = [_without_number(column, before) for column in columns]
    return columns


def _without_number(column: _Column, before: str) -> _Column:
    """A name without the number behind some text at its beginning."""
    match = re.match(rf"{re.escape(before)}\d+", column.name)
    if match is None:
        return column
    return replace(column, name=before + column.name[match.end() :])


def _motions_on_floors(columns: Sequence[_Column]) -> list[_Column]:
    """Motions of one kind on floors: by their numbers, else in their order."""
    base = [column for column in columns if column.is_of_base]
    above = [column for column in columns if not column.is_of_base]
    for position in (-1, 0):
        floors = _distinct_floors(above, position)
        if floors:
            return base + list(map(_Column.on_floor, above, floors))

    doubt = "which floor? counted in the order of the columns"
    in_order = sorted(above, key=attrgetter("is_of_top"))
    return base + [
        column.on_floor(floor, doubt) for floor, column in enumerate(in_order, 1)
    ]


def _distinct_floors(columns: Sequence[_Column], position: int) -> list[int]:
    """The last or first number of each name, if these can be floors; else none."""
    floors = []
    for column in columns:
        if not column.numbers:
            return []
        floors.append(column.numbers[position])
    are_distinct = len(set(floors)) == len(floors)
    are_few = max(floors, default=0) <= MAX_FLOORS_PER_COLUMN * len(floors)
    return floors if are_distinct and are_few else []


def _forces_on_floors(columns: Sequence[_Column], n_floors: int) -> list[_Column]:
    """Forces on floors: by the last number of their names, else on the top."""
    doubt = f"on which floor? the top is taken of F1 to F{n_floors}"
    placed = []
    for column in columns:
        if column.is_of_base:
            continue
        if column.numbers and 0 < column.numbers[-1] <= n_floors:
            placed.append(column.on_floor(column.numbers[-1]))
        elif column.is_of_top and not column.numbers:
            placed.append(column.on_floor(n_floors))
        else:
            placed.append(column.on_floor(n_floors, doubt))
    return placed


def mapping_text(files: Sequence[Path], proposals: Sequence[Proposal]) -> str:
    """A mapping file (TOML) of proposals; doubts stand behind a question mark."""
    names = ", ".join(_quoted(path.name) for path in files)
    lines = [f"files = [{names}]", "", "[channels]"]
    for proposal in proposals:
        line = f"{proposal.channel} = {_quoted(proposal.text)}"
        if proposal.doubts:
            line += f"   # ? {'; '.join(proposal.doubts)}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
