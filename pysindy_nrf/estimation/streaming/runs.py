"""Which pieces make up which record: NaN edges and unknown forces are judged record by record."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...exceptions import ChannelError

Key = tuple[int, int]  # number of the chunk, number of the piece in it


@dataclass
class Run:
    """Consecutive pieces of one record.

    Attributes
    ----------
    name : str
    first, last : (int, int)
        Keys of its first and last piece.
    starts, ends : bool
        Whether a record is known to start, to end here.
    head, tail : bool
        Whether NaN rows lead it, trail it.
    empty : bool
        Whether no row is finite.
    unknown : tuple of int
        DOFs whose force is NaN.
    rows : int
    """

    name: str
    first: Key
    last: Key
    starts: bool
    ends: bool
    head: bool
    tail: bool
    empty: bool
    unknown: tuple[int, ...]
    rows: int

    def follows(self, other: Run) -> bool:
        """Whether it goes on where another run stopped."""
        touching = self.first[0] == other.last[0] + 1 and self.first[1] == 0
        return touching and not self.starts and not other.ends and self.name == other.name

    def join(self, other: Run) -> Run:
        """This run and the one that follows it."""
        if not (self.empty or other.empty):
            if self.tail or other.head:
                raise ChannelError(
                    f"Record {self.name!r} holds NaN about row {self.rows}, between finite rows",
                    "Split the record there, or fill the gap; only leading and trailing NaN rows are masked.",
                )
            if self.unknown != other.unknown:
                j = min(set(self.unknown) ^ set(other.unknown))
                raise ChannelError(
                    f"F{j} of record {self.name!r} is NaN on one side of row {self.rows} and known on the other",
                    "Split the record there (a column record=), or fill the gap.",
                )
        return Run(
            self.name, self.first, other.last, self.starts, other.ends,
            self.empty or self.head, other.empty or other.tail, self.empty and other.empty,
            other.unknown if self.empty else self.unknown, self.rows + other.rows,
        )  # fmt: skip


def joined(runs: Iterable[Run]) -> list[Run]:
    """Runs in order, those that touch made one."""
    out: list[Run] = []
    for run in sorted(runs, key=lambda r: r.first):
        if out and run.follows(out[-1]):
            out[-1] = out[-1].join(run)
        else:
            out.append(run)
    return out


def to_json(run: Run) -> list[Any]:
    """Plain data."""
    return [
        run.name, list(run.first), list(run.last), run.starts, run.ends, run.head, run.tail, run.empty,
        list(run.unknown), run.rows,
    ]  # fmt: skip


def from_json(data: list[Any]) -> Run:
    """A run from plain data."""
    name, first, last, starts, ends, head, tail, empty, unknown, rows = data
    return Run(name, tuple(first), tuple(last), starts, ends, head, tail, empty, tuple(unknown), rows)


def is_empty(x: Any) -> bool:
    """Whether every row of a matrix holds a NaN; looks at the ends first."""
    if hasattr(x, "to_numpy"):
        x = x.to_numpy()
    x = np.asarray(x)
    if x.dtype.kind != "f" or not len(x) or not (np.isnan(x[0]).any() and np.isnan(x[-1]).any()):
        return False
    return bool(np.isnan(x).any(axis=1).all())
