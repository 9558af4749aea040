"""Accumulated sums of one pass over chunks: Gram matrices of blocks, channel ranges and
sample windows; sums add.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...chain.identifiability import SolveOrder
from ...chain.layout import Group, LawLayout, block_size
from ...equations.accumulation import GramPass
from ...equations.balances import blocks_of_segment
from ...equations.chain_solve import groups_of
from ...equations.normal_equations import NormalEquations
from ...exceptions import ChainError, ChannelError, NRFError
from ...records.dataset import Segment
from ...records.extent import Extent
from ...records.input_arrays import from_arrays
from ...records.record import plain_times
from ..problem import LEAST_SQUARES, Problem, law_list
from .sources import Chunk, seconds_since

Key = tuple[int, int]  # number of the chunk, number of the piece in it
Key3 = tuple[
    int, int, int
]  # with the number of the block, or of the first sample, in the piece
LINES = ("a", "v", "s", "F", "t", "ag")
N_BLOCKS = 64  # kept at least; at most twice as many
N_WINDOWS = 64  # at most
_WINDOW_BYTES = 2**24  # of all windows together


@dataclass
class Run:
    """Consecutive pieces of one record; NaN edges and unknown forces are checked record
    by record.
    """

    name: str
    first: Key  # keys of the first and the last piece
    last: Key
    starts: bool  # a record is known to start here, to end here
    ends: bool
    head: bool  # NaN rows lead it, trail it
    tail: bool
    empty: bool  # no row is finite
    unknown: tuple[int, ...]  # DOFs whose force is NaN
    rows: int

    def follows(self, other: Run) -> bool:
        """True if it continues where another run stopped."""
        touching = self.first[0] == other.last[0] + 1 and self.first[1] == 0
        return (
            touching and not self.starts and not other.ends and self.name == other.name
        )

    def join(self, other: Run) -> Run:
        """This run and the one that follows it."""
        if not (self.empty or other.empty):
            if self.tail or other.head:
                cure = (
                    "Split the record there, or fill the gap; only leading and trailing"
                    " NaN rows are masked."
                )
                raise ChannelError(
                    f"Record {self.name!r} holds NaN about row {self.rows}, between"
                    " finite rows",
                    cure,
                )
            if self.unknown != other.unknown:
                j = min(set(self.unknown) ^ set(other.unknown))
                what = (
                    f"F{j} of record {self.name!r} is NaN on one side of row"
                    f" {self.rows} and known on the other"
                )
                raise ChannelError(
                    what, "Split the record there (a column record=), or fill the gap."
                )
        return Run(
            self.name,
            self.first,
            other.last,
            self.starts,
            other.ends,
            self.empty or self.head,
            other.empty or other.tail,
            self.empty and other.empty,
            other.unknown if self.empty else self.unknown,
            self.rows + other.rows,
        )


def joined(runs: Iterable[Run]) -> list[Run]:
    """Runs in order; adjacent ones of a record are joined."""
    out: list[Run] = []
    for run in sorted(runs, key=lambda r: r.first):
        _append(out, run)
    return out


def _append(runs: list[Run], run: Run) -> bool:
    """Append a run; True if it continues the last one."""
    if runs and run.follows(runs[-1]):
        runs[-1] = runs[-1].join(run)
        return True
    runs.append(run)
    return False


def is_empty(x: Any) -> bool:
    """True if every row of a matrix holds a NaN; the ends are checked first."""
    if hasattr(x, "to_numpy"):
        x = x.to_numpy()
    x = np.asarray(x)
    if (
        x.dtype.kind != "f"
        or not len(x)
        or not (np.isnan(x[0]).any() and np.isnan(x[-1]).any())
    ):
        return False
    return bool(np.isnan(x).any(axis=1).all())


@dataclass
class BlockEntry:
    """Gram matrices (a sum) of consecutive samples of one record."""

    key: Key3
    record: str
    grams: NormalEquations


class Model:
    """Chain, laws, columns and the balances to accumulate, from the parameters of an
    estimator.
    """

    def __init__(self, estimator: Any, n_dof: int) -> None:
        self.problem: Problem = estimator.problem(n_dof)
        self.chain, self.layout = self.problem.chain, self.problem.layout
        self.known_masses = dict(self.problem.known_masses)
        require_streamable(estimator, self.layout)
        n = self.chain.n_dof
        singles = [(j,) for j in range(1, n + 1)]
        # for base excitation, see plan_solve_order
        sums = [
            tuple(range(i, n + 1))
            for i in range(1, n)
            if all(j in self.known_masses for j in range(i, n + 1))
        ]
        self.groups: list[Group] = [self.layout.group(dofs) for dofs in singles + sums]


def require_streamable(estimator: Any, layout: LawLayout) -> None:
    """Raise a ChainError for settings that need whole records in memory."""
    cure = "Give Records, or arrays that fit in memory."
    if estimator.estimation not in LEAST_SQUARES:
        raise ChainError(
            f"estimation={estimator.estimation!r} needs whole records", cure
        )
    if estimator.band is not None:
        what = "band= filters whole records and cannot be applied to pieces of them"
        raise ChainError(what, f"Filter them before. {cure}")
    for site, held in layout.laws.items():
        for law in held:
            if law.free_shape:
                raise ChainError(
                    f"{site}: {type(law).__name__} has no value for"
                    f" {law.free_shape[0]}; its estimation needs many passes",
                    "Estimate it on one record, then give the value.",
                )


class Accumulator:
    """One pass over chunks; accumulators of different chunks of the same data add."""

    def __init__(
        self, estimator: Any, kind: str = "gram", n_samples: int | None = None
    ) -> None:
        self.estimator, self.kind = estimator, kind
        self.block_rows = (
            64 if n_samples is None else max(64, -(-n_samples // N_BLOCKS))
        )
        self.model: Model | None = None
        self.blocks: list[BlockEntry] = []  # in the order of time after close()
        self.runs: list[Run] = []
        self.windows: list[
            tuple[Key3, Segment]
        ] = []  # some raw samples, evenly spread, for diagnosis
        self.window_every, self._offered = 1, 0
        self.extent: Extent | None = None  # of all channels a, v, s, F
        self.n_samples = 0  # NaN edges included
        self.origin: Any = None  # of time
        self.settings: dict[
            str, str
        ] = {}  # of the estimator, between calls of partial_fit
        self._open: tuple[Key3, str, GramPass] | None = (
            None  # key, record and sums of the last block
        )
        self._pass: GramPass | None = None  # its plan of products is that of all blocks
        self._carry: dict[str, Any] | None = (
            None  # end of the last run: states, last sample, its time
        )

    def add(self, chunk: Chunk, number: int) -> None:
        """Add the chunk of this number."""
        pieces, at = chunk.records(), 0
        for i, piece in enumerate(pieces):
            at = self._add((number, at), piece, ends=i < len(pieces) - 1)
        self.n_samples += chunk.n_samples

    def _add(self, key: Key, chunk: Chunk, ends: bool) -> int:
        """Add samples of one record and return the number of the next piece."""
        if is_empty(chunk.X):
            _append(
                self.runs,
                Run(
                    chunk.record,
                    key,
                    key,
                    chunk.first,
                    ends,
                    True,
                    True,
                    True,
                    (),
                    chunk.n_samples,
                ),
            )
            return key[1] + 1
        segments = self._segments(chunk)
        for i, segment in enumerate(segments):  # more than one where the clock has gaps
            here, size, inside = (key[0], key[1] + i), segment.n_samples, segment.valid
            unknown = tuple(
                j + 1
                for j in range(segment.n_dof)
                if np.isnan(segment.F[inside.start, j])
            )
            trimmed = inside.start > 0, inside.stop < size
            starts, stops = chunk.first or i > 0, ends or i < len(segments) - 1
            run = Run(
                chunk.record, here, here, starts, stops, *trimmed, False, unknown, size
            )
            goes_on = _append(self.runs, run)
            self.extent = (
                segment.extent
                if self.extent is None
                else self.extent.merge(segment.extent)
            )
            self._accumulate(segment, here, goes_on)
            self._offer_windows(here, segment)
        return key[1] + len(segments)

    def _segments(self, chunk: Chunk) -> list[Segment]:
        model, time = self.model, chunk.time
        if time is not None and len(time):
            time = plain_times(time)
            if self.origin is None:
                self.origin = time[0]
            time = seconds_since(time, self.origin)
        data = from_arrays(
            chunk.X,
            chunk.F,
            time=time,
            base_acceleration=chunk.base_acceleration,
            covariates=chunk.covariates,
            coordinates=chunk.coordinates or self.estimator.coordinates,
            dt=self.estimator.dt,
            n_dof=None if model is None else model.chain.n_dof,
            has_memory=any(law.has_memory for law in law_list(self.estimator.laws)),
            every_row=True,  # a piece may go on in the next chunk
        )
        if model is None:
            self.model = Model(self.estimator, data.n_dof)
        return [
            replace(segment, name=chunk.record, resolved=None)
            for segment in data.segments
        ]

    def _accumulate(self, segment: Segment, key: Key, goes_on: bool) -> None:
        layout = self.require_model().layout
        carry = self._carry if goes_on else None
        end = 0.0
        if segment.t is not None:
            if (
                carry is not None and self.origin is None
            ):  # dt counts from the start of each chunk
                time = segment.t + (carry["end"] + self.estimator.dt)
                segment = replace(segment, t=time)
            assert segment.t is not None
            end = float(segment.t[-1])
            if carry is not None and segment.t[0] <= carry["end"]:
                what = (
                    f"The time of record {segment.name!r} does not increase from one"
                    " piece to the next"
                )
                raise ChannelError(what, "Give the pieces in order.")
        states: dict = {}
        if layout.has_memory and carry is not None:
            states = carry["states"]
            segment = _behind(carry["last"], segment)
        if self._open is not None and not goes_on:
            self._shut()
        size = min(block_size(layout), self.block_rows)
        numbered = enumerate(blocks_of_segment(segment, layout, size, states=states))
        for i, block, products in self.sums().multiplied(numbered):
            if self._open is None:
                self._open = (*key, i), segment.name, self.sums()
            sums = self._open[2].add(block, products=products)
            if sums.n_samples >= self.block_rows:
                self._shut()
        end_row = segment.valid.stop
        last = _copied(segment, end_row - 1, end_row) if layout.has_memory else None
        self._carry = {"states": states, "last": last, "end": end}

    def sums(self, before: NormalEquations | None = None) -> GramPass:
        """Running sums of an empty block, or of one that continues a total."""
        model = self.require_model()
        if self._pass is None:
            self._pass = GramPass(
                model.layout, model.groups, model.known_masses, self.kind
            )
        return self._pass.empty(before)

    def _shut(self) -> None:
        """Close the block being filled; if there are many blocks, neighbours are
        merged.
        """
        if self._open is not None:
            self.blocks.append(self.open_entry())
            self._open = None
        if len(self.blocks) > 2 * N_BLOCKS:
            self.block_rows *= 2
            self.blocks = _halved(self.blocks)

    def open_entry(self) -> BlockEntry:
        """The block being filled, in its present state."""
        assert self._open is not None
        key, record, sums = self._open
        return BlockEntry(key, record, sums.total())

    @property
    def entries(self) -> list[BlockEntry]:
        """All blocks, the one being filled included."""
        return [*self.blocks, *([self.open_entry()] if self._open else [])]

    def _offer_windows(self, key: Key, segment: Segment) -> None:
        n = segment.n_dof
        size = int(np.clip(_WINDOW_BYTES // (N_WINDOWS * 32 * n), 64, 1024))
        inside = segment.valid
        # one window in each stretch of eight: enough to choose from, little to copy
        for start in range(
            inside.start, max(inside.stop - size // 2, inside.start + 1), 8 * size
        ):
            if self._offered % self.window_every == 0:
                stop = min(start + size, inside.stop)
                self.windows.append(
                    ((*key, start - inside.start), _copied(segment, start, stop))
                )
                if len(self.windows) > N_WINDOWS:
                    self.windows = self.windows[::2]
                    self.window_every *= 2
            self._offered += 1

    def copy(self) -> Accumulator:
        """A copy to which records can be added; this one does not change."""
        out = copy(self)
        out.blocks, out.runs, out.windows = (
            list(self.blocks),
            list(self.runs),
            list(self.windows),
        )
        out._shut()  # what follows is another record
        return out

    def close(self) -> Accumulator:
        """End the pass: no chunk follows."""
        self._shut()
        self.blocks.sort(key=lambda b: b.key)
        return self

    def merge(self, other: Accumulator) -> Accumulator:
        """Add the chunks of another accumulator of the same data; both closed."""
        if self.model is None and other.model is not None:
            for name, value in vars(other).items():
                if name not in ("runs", "n_samples"):
                    setattr(self, name, value)
        elif self.model is not None and other.model is not None:
            if self.model.chain.n_dof != other.model.chain.n_dof:
                what = (
                    f"One part of the data has {self.model.chain.n_dof} DOFs, another"
                    f" {other.model.chain.n_dof}"
                )
                raise ChannelError(what, "Give records of one chain.")
            self.blocks = sorted([*self.blocks, *other.blocks], key=lambda b: b.key)
            while len(self.blocks) > 2 * N_BLOCKS:
                self.blocks = _halved(self.blocks)
            self.windows = sorted([*self.windows, *other.windows], key=lambda w: w[0])
            while len(self.windows) > N_WINDOWS:
                self.windows = self.windows[::2]
            if other.extent is not None:
                self.extent = (
                    other.extent
                    if self.extent is None
                    else self.extent.merge(other.extent)
                )
        self.runs = joined([*self.runs, *other.runs])
        self.n_samples += other.n_samples
        return self

    def require_model(self) -> Model:
        """The model, known from the first sample on; before, a ChannelError is
        raised.
        """
        if self.model is None:
            raise ChannelError(
                "There are no samples", "The source is empty, or holds only NaN."
            )
        return self.model

    def grams(self) -> NormalEquations:
        """Gram matrices of all blocks, with the numbers of their records."""
        entries = self.entries
        if not entries:
            raise NRFError("There are no samples", "Check the source.")
        names = {
            name: i for i, name in enumerate(dict.fromkeys(e.record for e in entries))
        }
        return NormalEquations.stack(
            [e.grams for e in entries], [names[e.record] for e in entries]
        )

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs forced somewhere."""
        n, extent = self.require_model().chain.n_dof, self.extent
        return tuple(
            j + 1 for j in range(n) if extent is not None and extent.moves(3 * n + j)
        )

    @property
    def unknown(self) -> tuple[int, ...]:
        """DOFs whose force is unknown in every record."""
        masks = [set(run.unknown) for run in self.runs if not run.empty]
        return tuple(sorted(set.intersection(*masks))) if masks else ()

    def solve_order(self) -> SolveOrder:
        """The order of the solve that these data allow."""
        model = self.require_model()
        solve_order = model.problem.solve_order(self.forced, self.unknown)
        held = {g.dofs for g in model.groups}
        if any(g.dofs not in held for g in groups_of(model.layout, solve_order)):
            cure = "Give them as arrays that fit in memory."
            raise NRFError(
                "These data need sums of balances that were not accumulated", cure
            )
        return solve_order


def _halved(blocks: list[BlockEntry]) -> list[BlockEntry]:
    """Blocks merged in pairs; within records if that reduces their number enough."""
    out = _paired(blocks, across=False)
    return out if len(out) <= 0.75 * len(blocks) else _paired(out, across=True)


def _paired(blocks: list[BlockEntry], across: bool) -> list[BlockEntry]:
    """Blocks merged in pairs of neighbours; of different records too if ``across``."""
    out: list[BlockEntry] = []
    alone = True
    for entry in blocks:
        if out and alone and (across or out[-1].record == entry.record):
            out[-1] = replace(out[-1], grams=out[-1].grams.merge(entry.grams))
            alone = False
        else:
            out.append(entry)
            alone = True
    return out


def _behind(last: Segment, segment: Segment) -> Segment:
    """A segment with the sample before it in front; its own samples stay the valid
    ones.
    """
    joint: dict[str, Any] = {}
    for k in LINES:
        pair = getattr(last, k), getattr(segment, k)
        joint[k] = None if pair[0] is None or pair[1] is None else np.concatenate(pair)
    covariates = {
        k: np.concatenate([last.covariates[k], c])
        for k, c in segment.covariates.items()
    }
    valid = slice(segment.valid.start + 1, segment.valid.stop + 1)
    return replace(segment, **joint, covariates=covariates, valid=valid)


def _copied(segment: Segment, start: int, stop: int) -> Segment:
    """Some samples of a segment, copied."""
    rows, whole = slice(start, stop), slice(0, stop - start)
    lines: dict[str, Any] = {
        k: np.array(getattr(segment, k)[rows], dtype=float)
        for k in ("a", "v", "s", "F")
    }
    lines |= {
        k: None if getattr(segment, k) is None else np.array(getattr(segment, k)[rows])
        for k in ("t", "ag")
    }
    covariates = {
        k: np.array(c[rows], dtype=float) for k, c in segment.covariates.items()
    }
    return replace(segment, rows=whole, **lines, covariates=covariates, valid=whole)
