"""Cells of tables: what is shown, and what is sorted and copied."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..chain.latex import as_text
from ..drawing.tables import Table


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
