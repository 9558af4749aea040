"""Tables apart from how they are written: rows of values below a head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd


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
