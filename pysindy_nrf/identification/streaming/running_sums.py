"""Sums of one pass over chunks: balances by blocks, channel ranges, sample windows.

Sums of different chunks of the same data add, in any order.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import clone

from ...chain.identifiability import SolveOrder
from ...chain.layout import Group, LawLayout, block_size
from ...equations.accumulation import ProductSums
from ...equations.balances import States, blocks_of_segment
from ...equations.chain_solve import groups_of
from ...equations.normal_equations import NormalEquations
from ...exceptions import ChainError, ChannelError, NRFError
from ...laws import ForceLaw
from ...records.dataset import Dataset, Segment
from ...records.extent import Extent
from ...records.input_arrays import InputSettings, as_dataset
from ...records.record import plain_times
from ..problem import Problem, law_list
from .chunks import Chunk, ColumnReader, seconds_since
from .runs import PieceKey, Run, append, joined

if TYPE_CHECKING:
    from ..regressor import NRFRegressor

# Blocks that are kept at least, for intervals; at most twice as many.
N_BLOCKS = 64
_SMALLEST_BLOCK = 64
# Windows of raw samples that are kept at most, for diagnosis, and their bytes together.
N_WINDOWS = 64
_WINDOW_BYTES = 2**24
_WINDOW_SAMPLES = 64, 1024
# One window is offered in each stretch of so many: enough to choose from, little to
# copy.
_WINDOWS_IN_STRETCH = 8

# With the number of the block, or of the first sample, in the piece.
Key = tuple[int, int, int]


# -- what is summed up ---------------------------------------------------------------


@dataclass(frozen=True)
class StreamSettings:
    """How data are read and summed up in pieces.

    Attributes
    ----------
    estimator : NRFRegressor
        Not fitted; it defines the problem once the number of DOFs is known.
    """

    estimator: NRFRegressor

    @classmethod
    def of_estimator(cls, estimator: NRFRegressor) -> StreamSettings:
        """The settings of an estimator.

        Raises
        ------
        ChainError
            If a setting needs complete records in memory.
        """
        cure = "Give Records, or arrays that fit in memory."
        if estimator.estimation not in ("auto", "ls"):
            raise ChainError(
                f"estimation={estimator.estimation!r} needs whole records", cure
            )
        if estimator.band is not None:
            raise ChainError(
                "band= filters whole records and cannot be applied to pieces of them",
                f"Filter them before. {cure}",
            )
        settings = cls(clone(estimator))
        for law in settings.laws:
            if law.free_shape:
                raise ChainError(
                    f"{type(law).__name__} has no value for {law.free_shape[0]}; its"
                    " estimation needs many passes",
                    "Estimate it on one record, then give the value.",
                )
        return settings

    @property
    def laws(self) -> list[ForceLaw]:
        """The laws that were declared."""
        return law_list(self.estimator.laws)

    @property
    def reader(self) -> ColumnReader:
        """Reads named columns."""
        covariates = {name for law in self.laws for name in law.covariates}
        return ColumnReader(tuple(sorted(covariates)), self.estimator.coordinates)

    def in_words(self) -> dict[str, str]:
        """Every setting in all its digits."""
        parameters = self.estimator.get_params(deep=False)
        return {name: _exact(value) for name, value in parameters.items()}


def _exact(value: object) -> str:
    """A setting in all its digits; a law prints fewer."""
    if isinstance(value, Mapping):
        items = [f"{key!s}: {_exact(item)}" for key, item in value.items()]
        return ", ".join(sorted(items))
    if isinstance(value, (list, tuple, np.ndarray)):
        return f"[{', '.join(map(_exact, value))}]"
    if hasattr(value, "to_dict"):
        return _exact(value.to_dict())
    return repr(value)


class SummedProblem:
    """A problem and the balances that are summed up for it."""

    def __init__(self, settings: StreamSettings, n_dof: int) -> None:
        self.problem: Problem = settings.estimator.problem(n_dof)
        self.layout: LawLayout = self.problem.layout
        self.known_masses = dict(self.problem.known_masses)
        self.groups: list[Group] = []
        for j in range(1, self.n_dof + 1):
            self.groups.append(self.layout.group((j,)))
        # under base excitation storeys follow from the inertia of all floors above
        for j in range(1, self.n_dof):
            above = tuple(range(j, self.n_dof + 1))
            if self.known_masses.keys() >= set(above):
                self.groups.append(self.layout.group(above))

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.problem.chain.n_dof


# -- blocks --------------------------------------------------------------------------


@dataclass(frozen=True)
class Block:
    """Sums of the balances over consecutive samples of one record."""

    key: Key
    record: str
    sums: NormalEquations

    @property
    def n_samples(self) -> float:
        """Samples, by their weights."""
        return float(self.sums.n_samples)

    def merge(self, other: Block) -> Block:
        """Both; of the first record."""
        return replace(self, sums=self.sums.merge(other.sums))


def packed(blocks: Iterable[Block], n_rows: int, across: bool = False) -> list[Block]:
    """Neighbours merged up to a number of rows; of different records if ``across``."""
    out: list[Block] = []
    for block in blocks:
        fits = bool(out) and out[-1].n_samples + block.n_samples <= n_rows
        if fits and (across or out[-1].record == block.record):
            out[-1] = out[-1].merge(block)
        else:
            out.append(block)
    return out


# -- windows -------------------------------------------------------------------------


@dataclass
class Windows:
    """Raw samples, evenly spread over what was offered.

    Attributes
    ----------
    chosen : list of (key, Segment)
    every : int
        One of so many that are offered is chosen.
    n_offered : int
    """

    chosen: list[tuple[Key, Segment]] = field(default_factory=list)
    every: int = 1
    n_offered: int = 0

    def offer(self, piece: PieceKey, segment: Segment) -> None:
        """Offer windows of a segment."""
        bytes_in_sample = 4 * 8 * segment.n_dof
        by_memory = _WINDOW_BYTES // (N_WINDOWS * bytes_in_sample)
        size = int(np.clip(by_memory, *_WINDOW_SAMPLES))
        inside = segment.valid
        last_start = max(inside.stop - size // 2, inside.start + 1)
        for start in range(inside.start, last_start, _WINDOWS_IN_STRETCH * size):
            if self.n_offered % self.every == 0:
                stop = min(start + size, inside.stop)
                key = (*piece, start - inside.start)
                self.chosen.append((key, copied(segment, start, stop)))
            self.n_offered += 1
            if len(self.chosen) > N_WINDOWS:
                self.chosen = self.chosen[::2]
                self.every *= 2

    def copy(self) -> Windows:
        """A copy to which windows can be offered."""
        return replace(self, chosen=list(self.chosen))

    def merge(self, other: Windows) -> None:
        """Take the windows of other chunks, too."""
        together = [*self.chosen, *other.chosen]
        self.chosen = sorted(together, key=lambda window: window[0])
        while len(self.chosen) > N_WINDOWS:
            self.chosen = self.chosen[::2]


def copied(segment: Segment, start: int, stop: int) -> Segment:
    """Some samples of a segment, copied."""
    window = segment.cut(slice(start, stop), 0)
    covariates = {
        name: np.array(line, dtype=float) for name, line in window.covariates.items()
    }
    return replace(
        window,
        a=np.array(window.a, dtype=float),
        v=np.array(window.v, dtype=float),
        s=np.array(window.s, dtype=float),
        F=np.array(window.F, dtype=float),
        t=_copied_line(window.t),
        ag=_copied_line(window.ag),
        covariates=covariates,
    )


def _copied_line(line: np.ndarray | None) -> np.ndarray | None:
    return None if line is None else np.array(line, dtype=float)


# -- the pass ------------------------------------------------------------------------


@dataclass(frozen=True)
class Carry:
    """What the next piece of a record needs of the last one.

    Attributes
    ----------
    end : float
        Time of the last sample, s.
    states : dict
        States of the laws that remember the path.
    last : Segment or None
        The last sample.
    """

    end: float
    states: States
    last: Segment | None


@dataclass
class RunningSums:
    """Sums of one pass over chunks; what an interrupted pass needs to go on.

    Parameters
    ----------
    settings : StreamSettings
    kind : {"gram", "root"}
        Gram matrices, or triangular factors, which lose no digits.
    block_rows : int
        Samples of a block.
    problem : SummedProblem, optional
        Known from the first sample on.
    blocks : list of Block
    runs : list of Run
    windows : Windows
    extent : Extent, optional
        Range of every channel.
    n_samples, n_chunks : int
        That were added.
    origin : datetime64 or float, optional
        First time stamp; times are counted from it.
    carry : Carry, optional
        What the next piece needs of the last one.
    """

    settings: StreamSettings
    kind: str = "gram"
    block_rows: int = _SMALLEST_BLOCK
    problem: SummedProblem | None = None
    blocks: list[Block] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)
    windows: Windows = field(default_factory=Windows)
    extent: Extent | None = None
    n_samples: int = 0
    n_chunks: int = 0
    origin: np.generic | float | None = None
    carry: Carry | None = None
    # the plan of products that all blocks share
    _products: ProductSums | None = field(default=None, repr=False)

    @classmethod
    def of_length(
        cls, settings: StreamSettings, kind: str, n_samples: int | None
    ) -> RunningSums:
        """Empty sums, with blocks of a size that suits a pass of so many samples.

        Parameters
        ----------
        settings : StreamSettings
        kind : {"gram", "root"}
        n_samples : int or None
            None if it is not known before.
        """
        rows = -(-(n_samples or 0) // N_BLOCKS)
        return cls(settings, kind, block_rows=max(_SMALLEST_BLOCK, rows))

    # -- adding ----------------------------------------------------------------------

    def add(self, chunk: Chunk, number: int) -> None:
        """Add the chunk of this number."""
        pieces = chunk.records()
        place = 0
        for i, piece in enumerate(pieces):
            is_last = i == len(pieces) - 1
            place = self._add((number, place), piece, ends=not is_last)
        self.n_samples += chunk.n_samples
        self.n_chunks = number + 1

    def copy(self) -> RunningSums:
        """A copy to which records can be added; this one does not change."""
        return replace(
            self,
            blocks=list(self.blocks),
            runs=list(self.runs),
            windows=self.windows.copy(),
        )

    def merge(self, other: RunningSums) -> None:
        """Add the sums of other chunks of the same data."""
        if other.problem is not None:
            if self.problem is None:
                self.problem = other.problem
            self._require_same_chain(other.problem)
            self.block_rows = max(self.block_rows, other.block_rows)
            self.blocks = sorted(
                [*self.blocks, *other.blocks], key=lambda block: block.key
            )
            self._limit_blocks()
            self.windows.merge(other.windows)
            self._widen(other.extent)
        self.runs = joined([*self.runs, *other.runs])
        self.n_samples += other.n_samples

    def _require_same_chain(self, other: SummedProblem) -> None:
        n_dof = self.require_problem().n_dof
        if n_dof != other.n_dof:
            raise ChannelError(
                f"One part of the data has {n_dof} DOFs, another {other.n_dof}",
                "Give records of one chain.",
            )

    def _add(self, key: PieceKey, chunk: Chunk, ends: bool) -> int:
        """Add samples of one record; the number of the next piece."""
        if has_no_finite_row(chunk.samples.X):
            empty = Run(
                name=chunk.name,
                first=key,
                last=key,
                starts=chunk.first,
                ends=ends,
                head=True,
                tail=True,
                empty=True,
                unknown=(),
                n_rows=chunk.n_samples,
            )
            append(self.runs, empty)
            return key[1] + 1

        # more than one segment where the clock has gaps
        segments = self._segments(chunk)
        for i, segment in enumerate(segments):
            piece = (key[0], key[1] + i)
            run = Run(
                name=chunk.name,
                first=piece,
                last=piece,
                starts=chunk.first or i > 0,
                ends=ends or i < len(segments) - 1,
                head=segment.valid.start > 0,
                tail=segment.valid.stop < segment.n_samples,
                empty=False,
                unknown=segment.unknown,
                n_rows=segment.n_samples,
            )
            goes_on = append(self.runs, run)
            self._widen(segment.extent)
            carry = self.carry if goes_on else None
            timed = self._on_one_clock(segment, carry)
            self._sum_up(timed, piece, carry)
            self.windows.offer(piece, timed)
        return key[1] + len(segments)

    def _segments(self, chunk: Chunk) -> list[Segment]:
        """The samples of a chunk, checked."""
        samples = chunk.samples
        estimator = self.settings.estimator
        if samples.time is not None and len(samples.time):
            time = plain_times(samples.time)
            if self.origin is None:
                self.origin = time[0]
            samples = replace(samples, time=seconds_since(time, self.origin))
        settings = InputSettings(
            coordinates=chunk.coordinates or estimator.coordinates,
            dt=estimator.dt,
            n_dof=None if self.problem is None else self.problem.n_dof,
            has_memory=any(law.has_memory for law in self.settings.laws),
            # a short piece may go on in the next chunk
            every_row=True,
        )
        data = as_dataset(samples, settings)
        if self.problem is None:
            self.problem = SummedProblem(self.settings, data.n_dof)
        return [replace(segment, name=chunk.name) for segment in data.segments]

    def _widen(self, extent: Extent | None) -> None:
        if self.extent is None or extent is None:
            self.extent = self.extent or extent
        else:
            self.extent = self.extent.merge(extent)

    def _sum_up(self, segment: Segment, piece: PieceKey, carry: Carry | None) -> None:
        """Sum up the balances of a segment, block by block."""
        layout = self.require_problem().layout
        end = 0.0 if segment.t is None else float(segment.t[-1])
        states: States = {}
        if layout.has_memory and carry is not None and carry.last is not None:
            states = carry.states
            segment = _behind(carry.last, segment)

        size = min(block_size(layout), self.block_rows)
        parts = blocks_of_segment(segment, layout, size, states=states)
        sums = self.empty_sums()
        n_closed = 0
        for _, block, products in sums.multiplied(enumerate(parts)):
            sums.add(block, products=products)
            if sums.n_samples >= self.block_rows:
                self._close((*piece, n_closed), segment.name, sums)
                n_closed += 1
                sums = self.empty_sums()
        if sums.n_samples:
            self._close((*piece, n_closed), segment.name, sums)
        self._limit_blocks()

        end_row = segment.valid.stop
        last = copied(segment, end_row - 1, end_row) if layout.has_memory else None
        self.carry = Carry(end, states, last)

    def _on_one_clock(self, segment: Segment, carry: Carry | None) -> Segment:
        """The segment with times that go on from the piece before it."""
        if segment.t is None or carry is None:
            return segment
        if self.origin is None:
            # dt counts from the start of each chunk
            dt = self.settings.estimator.dt
            assert dt is not None
            time = segment.t + (carry.end + dt)
            segment = replace(segment, t=time)
        assert segment.t is not None
        if segment.t[0] <= carry.end:
            raise ChannelError(
                f"The time of record {segment.name!r} does not increase from one piece"
                " to the next",
                "Give the pieces in order.",
            )
        return segment

    def empty_sums(self) -> ProductSums:
        """Running sums of an empty block; all blocks share one plan of products."""
        summed = self.require_problem()
        if self._products is None:
            self._products = ProductSums(
                summed.layout, summed.groups, summed.known_masses, self.kind
            )
        return self._products.empty(None)

    def _close(self, key: Key, record: str, sums: ProductSums) -> None:
        self.blocks.append(Block(key, record, sums.total()))

    def _limit_blocks(self) -> None:
        """Merge neighbours until there are at most twice as many as are needed."""
        self.blocks = packed(self.blocks, self.block_rows)
        while len(self.blocks) > 2 * N_BLOCKS:
            self.block_rows *= 2
            self.blocks = packed(self.blocks, self.block_rows)
            if len(self.blocks) > 2 * N_BLOCKS:
                self.blocks = packed(self.blocks, self.block_rows, across=True)

    # -- reading ---------------------------------------------------------------------

    def require_problem(self) -> SummedProblem:
        """The problem, known from the first sample on; a ChannelError before."""
        if self.problem is None:
            raise ChannelError(
                "There are no samples", "The source is empty, or holds only NaN."
            )
        return self.problem

    def pieces(self) -> NormalEquations:
        """Sums of all blocks, with the numbers of their records."""
        if not self.blocks:
            raise NRFError("There are no samples", "Check the source.")
        records, _ = pd.factorize(np.array([block.record for block in self.blocks]))
        sums = [block.sums for block in self.blocks]
        return NormalEquations.stack(sums, records.tolist())

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs with a force that is not zero somewhere."""
        return self.shown().forced

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown in every record."""
        unknown = set(self.unknown_somewhere)
        for run in self.runs:
            if not run.empty:
                unknown &= set(run.unknown)
        return tuple(sorted(unknown))

    @property
    def unknown_somewhere(self) -> list[int]:
        """DOFs whose force is unknown in a record."""
        unknown: set[int] = set()
        for run in self.runs:
            unknown.update(run.unknown)
        return sorted(unknown)

    def solve_order(self) -> SolveOrder:
        """The order of the solve that these data allow."""
        summed = self.require_problem()
        order = summed.problem.solve_order(self.forced, self.unknown)
        available = [group.dofs for group in summed.groups]
        for group in groups_of(summed.layout, order):
            if group.dofs not in available:
                raise NRFError(
                    "These data need sums of balances that were not accumulated",
                    "Give them as arrays that fit in memory.",
                )
        return order

    def shown(self) -> Dataset:
        """The windows that were chosen, with the range of all samples."""
        if not self.windows.chosen or self.extent is None:
            raise ChannelError(
                "There are no samples", "The source is empty, or holds only NaN."
            )
        segments: list[Segment] = []
        first_row = 0
        for _, window in self.windows.chosen:
            rows = slice(first_row, first_row + window.n_samples)
            segments.append(replace(window, rows=rows, known_extent=self.extent))
            first_row = rows.stop
        return Dataset(segments, first_row)

    def judged(self) -> Dataset:
        """Windows on which missing laws are looked for.

        If a law remembers the path, they are those at the start of a record, where its
        state is known.
        """
        everything = self.shown()
        if not self.require_problem().layout.has_memory:
            return everything
        starts = [(*run.first, 0) for run in self.runs]
        keys = [key for key, _ in self.windows.chosen]
        at_start = [
            segment for key, segment in zip(keys, everything.segments) if key in starts
        ]
        return replace(everything, segments=at_start or everything.segments[:1])


def has_no_finite_row(X: ArrayLike) -> bool:
    """Whether every row of a matrix holds a NaN; the ends are looked at first."""
    matrix = np.asarray(X.to_numpy() if hasattr(X, "to_numpy") else X)
    if matrix.dtype.kind != "f" or not len(matrix):
        return False
    if not np.isnan(matrix[0]).any() or not np.isnan(matrix[-1]).any():
        return False
    return bool(np.isnan(matrix).any(axis=1).all())


def _behind(last: Segment, segment: Segment) -> Segment:
    """A segment with the sample before it in front, which is not one of its own."""
    covariates = {}
    for name, line in segment.covariates.items():
        covariates[name] = np.concatenate([last.covariates[name], line])
    valid = slice(segment.valid.start + 1, segment.valid.stop + 1)
    return replace(
        segment,
        a=np.concatenate([last.a, segment.a]),
        v=np.concatenate([last.v, segment.v]),
        s=np.concatenate([last.s, segment.s]),
        F=np.concatenate([last.F, segment.F]),
        t=_joined_lines(last.t, segment.t),
        ag=_joined_lines(last.ag, segment.ag),
        covariates=covariates,
        valid=valid,
    )


def _joined_lines(
    before: np.ndarray | None, after: np.ndarray | None
) -> np.ndarray | None:
    if before is None or after is None:
        return None
    return np.concatenate([before, after])
