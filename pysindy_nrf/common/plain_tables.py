"""Tables of pandas and mappings as plain lists, for files that hold no code.

``skops`` writes arrays, lists, numbers and attributes; not the inside of pandas, nor
keys that are no text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd


@dataclass(frozen=True)
class PlainTable:
    """A table of pandas as lists.

    Attributes
    ----------
    columns : list of list
        Values, column by column.
    names : list
        Of the columns.
    types : list of str
        Of the columns.
    index : list
    index_names : list
    is_series : bool
    """

    columns: list[list[Any]]
    names: list[Any]
    types: list[str]
    index: list[Any]
    index_names: list[Any]
    is_series: bool

    @classmethod
    def of(cls, table: pd.DataFrame | pd.Series) -> PlainTable:
        """The lists of a table."""
        frame = table.to_frame() if isinstance(table, pd.Series) else table
        columns = [frame.iloc[:, i].tolist() for i in range(frame.shape[1])]
        return cls(
            columns,
            frame.columns.tolist(),
            [str(kind) for kind in frame.dtypes],
            frame.index.tolist(),
            list(frame.index.names),
            isinstance(table, pd.Series),
        )

    def table(self) -> pd.DataFrame | pd.Series:
        """The table of the lists."""
        index = pd.Index(self.index)
        if len(self.index_names) > 1:
            index = pd.MultiIndex.from_tuples(self.index)
        index = index.set_names(self.index_names)
        parts = []
        for name, values, kind in zip(self.names, self.columns, self.types):
            parts.append(pd.Series(values, index=index, name=name, dtype=kind))
        if self.is_series:
            return parts[0]
        frame = pd.DataFrame(dict(enumerate(parts)), index=index)
        return frame.set_axis(pd.Index(self.names), axis=1)


@dataclass(frozen=True)
class PlainMapping:
    """A mapping whose keys are no text, as lists."""

    keys: list[Any]
    values: list[Any]


def plain(value: Any) -> Any:
    """Tables and mappings as lists; anything else as it is."""
    if isinstance(value, (pd.DataFrame, pd.Series)):
        return PlainTable.of(value)
    if isinstance(value, Mapping) and not all(isinstance(key, str) for key in value):
        return PlainMapping(list(value), [plain(element) for element in value.values()])
    if isinstance(value, list):
        return [plain(element) for element in value]
    return value


def restored(value: Any) -> Any:
    """The inverse of :func:`plain`."""
    if isinstance(value, PlainTable):
        return value.table()
    if isinstance(value, PlainMapping):
        return dict(zip(value.keys, map(restored, value.values)))
    if isinstance(value, list):
        return [restored(element) for element in value]
    return value


class PlainState:
    """Objects whose saved attributes are plain lists, numbers and arrays."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: plain(value) for name, value in vars(self).items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, restored(value))
