"""Columns of a file with the channels proposed for them, as a table to be corrected."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...drawing.thinning import thinned
from ...records.files import read_table
from ...records.files.mapping import Proposal, mapping_text, parse, propose
from ...records.files.mapping.expression import as_name
from ...records.files.table import Table

# Points of a small plot, and columns of a file that are listed: more are mapped by a
# mapping file.
SMALL_PLOT_POINTS, MAX_COLUMNS = 160, 200
# Floors that may be chosen beyond those proposed, and at least.
SPARE_FLOORS, LEAST_FLOORS = 2, 4
NOT_USED = "not used"


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file, and what it is taken to be.

    Parameters
    ----------
    text : str
        Its mapping, ``"Shaker" @ kN``.
    channel : str
        ``"F2"``; ``NOT_USED`` if it is none.
    doubts : tuple of str
        What is not sure about it.
    line : ndarray of shape (n_points,)
        Its samples with few points, for a small plot; empty if it holds no numbers.
    """

    text: str
    channel: str = NOT_USED
    doubts: tuple[str, ...] = ()
    line: np.ndarray = field(default_factory=lambda: np.zeros(0))


def columns_of(files: Sequence[Path]) -> list[Column]:
    """Columns of a file, or of the files of one test; those that are channels first.

    Raises
    ------
    NRFError
        If a file cannot be read; the error says why.
    """
    table = read_table([*files] if len(files) > 1 else files[0])
    proposals = propose(table)
    columns = []
    for proposal in proposals:
        line = _line(table, proposal.text, proposal.channel)
        columns.append(
            Column(proposal.text, proposal.channel, tuple(proposal.doubts), line)
        )

    used = [parse(proposal.text, table, "t") for proposal in proposals]
    names = {(expression.name, expression.column) for expression in used}
    for name, values in table.variables.items():
        for text, column in _texts_of(name, values):
            if (name, column) not in names and len(columns) < MAX_COLUMNS:
                columns.append(Column(text, line=_line(table, text, "t")))
    return columns


def _texts_of(name: str, values: np.ndarray) -> list[tuple[str, int | None]]:
    """Mappings of a variable, or of each column of a matrix."""
    if values.ndim == 1 and len(values) > 1:
        return [(as_name(name), None)]
    if values.ndim != 2:
        return []
    n_columns = values.shape[1]
    return [(f"{as_name(name)}[:, {k}]", k) for k in range(min(n_columns, MAX_COLUMNS))]


def _line(table: Table, text: str, channel: str) -> np.ndarray:
    """Samples of a column with few points; empty if they are no numbers."""
    expression = parse(text, table, channel)
    values = table.variables.get(expression.name, np.zeros(0))
    if expression.column is not None and values.ndim == 2:
        values = values[:, expression.column]
    if values.ndim != 1 or values.dtype.kind not in "iuf" or len(values) < 2:
        return np.zeros(0)
    numbers = np.nan_to_num(values.astype(float))
    return thinned(np.arange(len(numbers)), numbers, SMALL_PLOT_POINTS)[1]


def channels_to_choose(columns: Sequence[Column]) -> list[str]:
    """Channels that a column may be."""
    highest = 0
    for column in columns:
        number = column.channel[1:]
        highest = max(highest, int(number) if number.isdigit() else 0)
    floors = range(1, max(LEAST_FLOORS, highest + SPARE_FLOORS) + 1)
    names = [NOT_USED, "t"]
    for kind in "Favx":
        names += [f"{kind}{j}" for j in floors]
    return [*names, "ag", "vg", "xg"]


def mapping_file_text(
    files: Sequence[Path], columns: Sequence[Column], settings: Mapping[str, object]
) -> str:
    """The mapping file (TOML) of a corrected table.

    Parameters
    ----------
    files : sequence of Path
    columns : sequence of Column
    settings : mapping of str to object
        ``together``, ``fs``, ``coordinates``; those that are None are left out.
    """
    proposals = []
    for column in columns:
        if column.channel != NOT_USED:
            proposals.append(Proposal(column.channel, column.text))
    first, rest = mapping_text(files, proposals).split("\n", 1)
    lines = [first]
    for name, value in settings.items():
        if value is not None:
            lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join([*lines, rest])
