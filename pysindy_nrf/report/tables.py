"""Tables apart from how they are written: rows of values below a head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..chain.latex import as_text


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of values (numbers or text) below a head, with a caption."""

    caption: str
    head: list[str]
    rows: Sequence[Sequence[object]]


def table(
    caption: str,
    frame: pd.DataFrame,
    names: Mapping[str, str] | None = None,
    index: str | None = None,
) -> Table:
    """The table of a frame.

    Parameters
    ----------
    caption : str
    frame : DataFrame
    names : mapping of str to str, optional
        Headings of columns in place of their names.
    index : str, optional
        Heading of the index, which then comes first; without it the index is left out.
    """
    names = names or {}
    head = [names.get(str(column), str(column)) for column in frame.columns]
    first = 1
    if index is not None:
        head.insert(0, index)
        first = 0
    rows = [list(row[first:]) for row in frame.itertuples(name=None)]
    return Table(caption, head, rows)


class Cell(NamedTuple):
    """One cell of a table: what is shown, and what it is sorted and copied by."""

    text: str
    value: str
    is_number: bool = False
    faint: bool = False


def cell(value: object) -> Cell:
    """The cell of a number or of text.

    Four digits of a number are shown, all are kept for sorting and copying.
    """
    if isinstance(value, (int, np.integer)):
        return Cell(str(value), str(value), True)
    if isinstance(value, (float, np.floating)):
        exact = repr(float(value)) if np.isfinite(value) else ""
        return Cell(as_text(value), exact, True, getattr(value, "faint", False))
    return Cell(str(value), str(value))


def cells(shown: Table) -> tuple[list[list[Cell]], list[bool]]:
    """Cells of a table, and whether each column holds numbers."""
    rows = [[cell(value) for value in row] for row in shown.rows]
    numeric = []
    for k in range(len(shown.head)):
        numeric.append(any(row[k].is_number for row in rows))
    return rows, numeric


def texts(values: Sequence[object]) -> list[str]:
    """Values as they are shown in cells."""
    return [cell(value).text for value in values]
