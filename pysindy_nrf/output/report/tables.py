"""Tables of the page: what is shown in a cell, and what it is sorted by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from .equations import as_text


@dataclass
class Cell:
    """One cell.

    Attributes
    ----------
    text : str
        Shown; escaped by the template.
    value : str
        What it is sorted and copied by.
    number : bool
    """

    text: str
    value: str
    number: bool = False


@dataclass
class Table:
    """A table with a caption.

    Attributes
    ----------
    caption : str
    head : list of str
    rows : list of list of Cell
    """

    caption: str
    head: list[str]
    rows: list[list[Cell]]

    @property
    def numeric(self) -> list[bool]:
        """Whether each column holds numbers."""
        return [any(row[k].number for row in self.rows) for k in range(len(self.head))]


def cell(value: Any, digits: int = 4) -> Cell:
    """A cell of a number or of text."""
    if isinstance(value, (bool, np.bool_)):
        return Cell("yes" if value else "", "1" if value else "0")
    if isinstance(value, (int, np.integer)):
        return Cell(str(value), str(value), True)
    if isinstance(value, (float, np.floating)):
        return Cell(as_text(value, digits), repr(float(value)) if np.isfinite(value) else "", True)
    return Cell(str(value), str(value))


def table(
    caption: str, frame: pd.DataFrame, names: Mapping[str, str] | None = None, index: str | None = None, digits: int = 4
) -> Table:
    """A table of a frame."""
    known = dict(names or {})
    head = [*([index] if index is not None else []), *(known.get(str(c), str(c)) for c in frame.columns)]
    rows = []
    for name, *values in frame.itertuples(name=None):
        lead = [cell(name, digits)] if index is not None else []
        rows.append([*lead, *(cell(x, digits) for x in values)])
    return Table(caption, head, rows)


def rows_table(caption: str, head: Sequence[str], rows: Sequence[Sequence[Any]], digits: int = 4) -> Table:
    """A table of rows of values."""
    return Table(caption, list(head), [[cell(x, digits) for x in row] for row in rows])
