"""Pieces of one record that follow each other: where a record may have NaN edges."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ...exceptions import ChannelError

# Number of the chunk, number of the piece in it.
PieceKey = tuple[int, int]


@dataclass(frozen=True)
class Run:
    """Consecutive pieces of one record.

    NaN edges and unknown forces are checked record by record, so runs are joined where
    a record goes on from one piece to the next.

    Attributes
    ----------
    name : str
    first, last : tuple of int
        Keys of the first and the last piece.
    starts, ends : bool
        Whether a record is known to start here, to end here.
    head, tail : bool
        Whether NaN rows lead it, trail it.
    empty : bool
        Whether no row is finite.
    unknown : tuple of int
        DOFs whose force is NaN.
    n_rows : int
    """

    name: str
    first: PieceKey
    last: PieceKey
    starts: bool
    ends: bool
    head: bool
    tail: bool
    empty: bool
    unknown: tuple[int, ...]
    n_rows: int

    def follows(self, other: Run) -> bool:
        """Whether it continues where another run stopped."""
        next_chunk = self.first == (other.last[0] + 1, 0)
        cut = self.starts or other.ends
        return next_chunk and not cut and self.name == other.name

    def join(self, other: Run) -> Run:
        """This run and the one that follows it.

        Raises
        ------
        ChannelError
            If NaN rows lie between finite ones, or a force becomes unknown.
        """
        if not self.empty and not other.empty:
            self._require_no_gap(other)
            self._require_same_forces(other)
        return Run(
            name=self.name,
            first=self.first,
            last=other.last,
            starts=self.starts,
            ends=other.ends,
            head=self.empty or self.head,
            tail=other.empty or other.tail,
            empty=self.empty and other.empty,
            unknown=other.unknown if self.empty else self.unknown,
            n_rows=self.n_rows + other.n_rows,
        )

    def _require_no_gap(self, other: Run) -> None:
        if self.tail or other.head:
            raise ChannelError(
                f"Record {self.name!r} holds NaN about row {self.n_rows}, between"
                " finite rows",
                "Split the record there, or fill the gap; only leading and trailing"
                " NaN rows are masked.",
            )

    def _require_same_forces(self, other: Run) -> None:
        changed = set(self.unknown) ^ set(other.unknown)
        if changed:
            raise ChannelError(
                f"F{min(changed)} of record {self.name!r} is NaN on one side of row"
                f" {self.n_rows} and known on the other",
                "Split the record there (a column record=), or fill the gap.",
            )


def joined(runs: Iterable[Run]) -> list[Run]:
    """Runs in order; those that continue a record are joined."""
    out: list[Run] = []
    for run in sorted(runs, key=lambda run: run.first):
        append(out, run)
    return out


def append(runs: list[Run], run: Run) -> bool:
    """Append a run; whether it continues the last one."""
    if runs and run.follows(runs[-1]):
        runs[-1] = runs[-1].join(run)
        return True
    runs.append(run)
    return False
