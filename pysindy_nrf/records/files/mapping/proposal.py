"""Proposed channels for the columns of a file, from their units, numbers and words."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

import numpy as np

from ...channels import channel_of
from ..table import Table
from ..units import is_unit, kind_of_unit, si_unit, split_suffix, split_unit
from .column_facts import ColumnFacts, column_facts, unit_of_ticks
from .column_words import words_of_columns
from .expression import as_name
from .words import (
    MOTION_LETTERS,
    VERTICAL,
    WORDS_OF_BASE,
    WORDS_OF_TOP,
    axis_of,
    letter_named,
    names_one_of,
    notation_of,
)

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
    unit: str = ""  # in brackets behind its name, where the reader leaves it there

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


def propose(table: Table, facts: Sequence[ColumnFacts] | None = None) -> list[Proposal]:
    """Channels of the columns of a file, with what is not sure about them.

    Parameters
    ----------
    table : Table
    facts : sequence of ColumnFacts, optional
        As :func:`column_facts` finds them.
    """
    facts = column_facts(table) if facts is None else facts
    columns = _without_input_numbers(_channel_columns(table, facts))
    by_letter = defaultdict(list)
    for column in _in_one_direction(columns, facts):
        by_letter[column.letter].append(column)

    placed = by_letter["t"][:1]
    if by_letter["a"]:  # other motions may be sampled slowly
        placed = [_with_unit_of_ticks(column, facts) for column in placed]
    for letter in "axv":
        placed += _motions_on_floors(by_letter[letter])
    n_floors = max([column.floor for column in placed], default=0)
    placed += _forces_on_floors(by_letter["F"], max(n_floors, 1))

    proposals: dict[str, Proposal] = {}
    for column in placed:
        text = f"{column.text} @ {column.unit}" if column.unit else column.text
        proposal = Proposal(column.channel, text, column.doubts)
        proposals.setdefault(column.channel, proposal)
    return list(proposals.values())


def _with_unit_of_ticks(time: _Column, facts: Sequence[ColumnFacts]) -> _Column:
    """A time without a unit, in that of its ticks if seconds would be far too slow."""
    step = next((fact.step for fact in facts if fact.text == time.text), np.nan)
    is_unsaid = any(doubt.startswith("no unit") for doubt in time.doubts)
    unit = unit_of_ticks(step)
    if not is_unsaid or unit == "s":
        return time
    doubt = f"no unit: {unit} taken, since s would be {1 / step:.2g} Hz"
    return replace(time, text=f"{time.text} @ {unit}", doubts=(doubt,))


def _channel_columns(table: Table, facts: Sequence[ColumnFacts]) -> list[_Column]:
    """Columns that may be channels: by their names and units, else by their shape."""
    columns: list[_Column] = []
    for fact in facts:
        column = _named_column(fact, table)
        if column is not None:
            columns.append(column)
    return columns + _columns_by_shape(columns, facts)


def _named_column(fact: ColumnFacts, table: Table) -> _Column | None:
    """A column whose name or unit says which kind of channel it is."""
    name, in_brackets = _unit_in_brackets(fact.variable)
    bare, suffix = split_suffix(_without_prefix(name, table))
    unit = table.units.get(fact.variable) or in_brackets or suffix
    notation = notation_of(bare)
    letter = _letter_of(bare, unit)
    if bare in AXES_OF_A_GRAPH <= table.variables.keys() and not unit:
        letter = None
    if letter is None:
        return None

    doubts = _doubts(bare, unit, letter)
    is_known = channel_of(bare) is not None
    if notation is not None and notation.letter == letter and not is_known:
        bare = f"{notation.letter} {notation.place}"
    if fact.text != as_name(fact.variable):  # a column of a matrix
        bare = f"{bare} {_number_of_column(fact)}"
    return _Column(letter, bare, fact.text, doubts, unit=in_brackets)


def _unit_in_brackets(name: str) -> tuple[str, str]:
    """Name and unit of ``F2 [kN]``; no unit where the brackets hold another thing."""
    bare, unit = split_unit(name)
    return (bare, unit) if unit and is_unit(unit) else (name, "")


def _number_of_column(fact: ColumnFacts) -> int:
    """Number of a column or row of a matrix, counted from 1."""
    (number,) = re.findall(r"\d+", fact.text.rpartition("[")[2])
    return int(number) + 1


def _without_prefix(name: str, table: Table) -> str:
    """Name without the structure, group or file that it stands in: ``data.F2``.

    Of joined files only channels that one of them has: two loggers may both call
    theirs ``a1``.
    """
    last = _last_part(name)
    if table.files:
        n_alike = sum(_last_part(other) == last for other in table.variables)
        return last if channel_of(last) and n_alike == 1 else name
    is_telling = channel_of(last) or notation_of(last) or letter_named(last) is not None
    return last if is_telling else name


def _last_part(name: str) -> str:
    return name.rpartition(".")[2].strip()


SINGLE_LETTERS = {"x": "x", "v": "v", "a": "a", "f": "F", "F": "F"}
AXES_OF_A_GRAPH = {"x", "y"}


def _letter_of(name: str, unit: str | None) -> str | None:
    """Letter of the channel of a column: by its unit, its name or its words."""
    channel = channel_of(name)
    words = letter_named(name)
    if words == "" and channel is None:
        return None  # a temperature, a counter
    if kind_of_unit(unit):
        return kind_of_unit(unit)
    if channel:
        return channel[0]
    notation = notation_of(name)
    if notation is not None:
        return notation.letter
    return words or SINGLE_LETTERS.get(name.strip())


def _columns_by_shape(
    named: Sequence[_Column], facts: Sequence[ColumnFacts]
) -> list[_Column]:
    """Columns without a meaningful name: the time, and pairs of a motion and its
    derivative.
    """
    letters = {column.text: column.letter for column in named}
    unnamed = [fact for fact in facts if fact.text not in letters]

    columns = []
    if "t" not in letters.values():
        columns += _rising_time(facts, letters)
    for fact in unnamed:
        for column in _pair_of_motions(fact, letters):
            if column.text not in letters:
                letters[column.text] = column.letter
                columns.append(column)
    return columns


def _rising_time(
    facts: Sequence[ColumnFacts], letters: Mapping[str, str]
) -> list[_Column]:
    """The first column, if it rises like a time and has no other meaning."""
    for first in facts[:1]:
        if first.is_time and first.text not in letters:
            doubt = "rises in even steps; s taken"
            return [_Column("t", first.text, first.text, (doubt,))]
    return []


def _pair_of_motions(fact: ColumnFacts, letters: Mapping[str, str]) -> list[_Column]:
    """A column that is the derivative of another, and that one; else none."""
    relation = fact.relation
    if relation is None:
        return []
    lower = letters.get(relation.of, "x")
    if lower not in "xv":
        return []

    order = relation.order + "xv".index(lower)
    words = "second derivative" if relation.order == 2 else "derivative"
    doubt = f"no name and no unit; looks like the {words} of {relation.of}"
    return [
        _Column(lower, "", relation.of, (doubt,)),
        _Column("xva"[min(order, 2)], "", fact.text, (doubt,)),
    ]


def _in_one_direction(
    columns: Sequence[_Column], facts: Sequence[ColumnFacts]
) -> list[_Column]:
    """Columns without the other directions of sensors that measure several.

    The direction that moves most is taken, of those that are not vertical.
    """
    sensors = _directions_of_sensors(columns)
    if not sensors:
        return list(columns)

    activity = _activity_of_directions(sensors, facts)
    level = [axis for axis in activity if axis not in VERTICAL] or list(activity)
    taken = max(level, key=lambda axis: activity[axis])
    others: set[_Column] = set()
    for by_axis in sensors:
        others.update(column for axis, column in by_axis.items() if axis != taken)

    doubt = f"{taken} of {', '.join(activity)}: is it the direction of the chain?"
    remaining = []
    for column in columns:
        stem, axis = axis_of(column.name)
        if column in others:
            continue
        if axis == taken and column.letter in MOTION_LETTERS:
            column = replace(column, name=stem, doubts=(*column.doubts, doubt))
        remaining.append(column)
    return remaining


def _directions_of_sensors(columns: Sequence[_Column]) -> list[dict[str, _Column]]:
    """Columns by direction, of each sensor that measures several."""
    sensors: dict[tuple[str, str], dict[str, _Column]] = defaultdict(dict)
    for column in columns:
        stem, axis = axis_of(column.name)
        if axis is not None and column.letter in MOTION_LETTERS:
            sensors[column.letter, stem][axis] = column
    return [by_axis for by_axis in sensors.values() if len(by_axis) > 1]


def _activity_of_directions(
    sensors: Sequence[Mapping[str, _Column]], facts: Sequence[ColumnFacts]
) -> dict[str, float]:
    """Sum of the variances of all sensors by direction."""
    variance = {fact.text: _variance(fact) for fact in facts}
    activity: dict[str, float] = defaultdict(float)
    for by_axis in sensors:
        for axis, column in by_axis.items():
            activity[axis] += variance[column.text]
    return activity


def _variance(fact: ColumnFacts) -> float:
    return 0.0 if fact.values is None else float(np.nanvar(fact.values))


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


def mapping_text(
    files: Sequence[Path],
    proposals: Sequence[Proposal],
    table: Table | None = None,
    facts: Sequence[ColumnFacts] = (),
) -> str:
    """A mapping file (TOML) of proposals; doubts stand behind a question mark.

    Parameters
    ----------
    files : sequence of Path
    proposals : sequence of Proposal
    table : Table, optional
        Its columns are listed as comments, with what they look like.
    facts : sequence of ColumnFacts
    """
    names = ", ".join(_quoted(path.name) for path in files)
    lines = [f"files = [{names}]"]
    if table is not None and table.files:
        lines.append("together = true")
    if table is not None:
        used = {
            proposal.text.partition(" @ ")[0]: proposal.channel
            for proposal in proposals
        }
        lines += ["", "# Columns of the file, and what they look like:"]
        lines += [f"#   {words}" for words in words_of_columns(table, facts, used)]
        if lacks_clock(proposals, table):
            lines += ["", "# fs = 100.0   # ? the file has no time: its rate in Hz"]

    lines += ["", "[channels]"]
    for proposal in proposals:
        line = f"{proposal.channel} = {_quoted(proposal.text)}"
        if proposal.doubts:
            line += f"   # ? {'; '.join(proposal.doubts)}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def is_element_alone(proposals: Sequence[Proposal]) -> bool:
    """Whether a test of one element is proposed: a force, its drift, and no mass."""
    motions = {proposal.channel for proposal in proposals} - {"t", "F1"}
    has_force = any(proposal.channel == "F1" for proposal in proposals)
    return has_force and bool(motions) and motions <= {"x1", "v1"}


def is_over_frequency(facts: Sequence[ColumnFacts]) -> bool:
    """Whether the first column is a frequency: responses or spectra, no record."""
    for first in facts[:1]:
        if first.values is None or not re.search(r"freq|\bhz\b", first.variable, re.I):
            return False
        return bool((np.diff(first.values) > 0).all())
    return False


def lacks_clock(proposals: Sequence[Proposal], table: Table) -> bool:
    """Whether neither a time is proposed nor a rate stated in the file."""
    has_time = any(proposal.channel == "t" for proposal in proposals)
    return not has_time and table.fs is None and not table.clocks and not table.files


def lacks_motion(proposals: Sequence[Proposal]) -> bool:
    """Whether no motion of the structure is proposed, so that nothing can be read."""
    channels = {proposal.channel for proposal in proposals}
    return not any(re.fullmatch(r"[avx]\d+", channel) for channel in channels)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
