"""Sums of products over the samples: blocks in, normal equations out, on all cores."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Protocol

import numpy as np

from ..chain.layout import Block, Group, LawLayout, Layout, cut_at
from ..common.threads import in_threads
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter
from .balances import BalanceEquations, rows_of, whole_block
from .compiled_sums import ProductPlan
from .normal_equations import Dofs, NormalEquations, width_of
from .triangular import root_of

__all__ = [
    "ProductSums",
    "pieces_of",
    "rows_of",
    "total_products",
    "whole_block",
]

# Pieces into which all records are cut.
N_PIECES = 64
# Blocks that a thread takes at once.
BLOCKS_PER_THREAD = 4


class Whitener(Protocol):
    """A zero-phase filter of the rows of one equation of motion."""

    def apply(self, rows: np.ndarray, dt: float) -> np.ndarray:
        """Rows (n_rows, n_samples) of one record, filtered."""


def total_products(
    layout: Layout,
    groups: Sequence[Group],
    blocks: Iterable[Block],
    known_masses: Mapping[int, float] | None = None,
    kind: str = "gram",
) -> NormalEquations:
    """Sums over all samples of some blocks; ``kind`` as for :class:`ProductSums`."""
    sums = ProductSums(layout, groups, known_masses, kind)
    return sums.add_each((0, block) for block in blocks).total()


class ProductSums:
    """Running sums of products, of numbered blocks of samples.

    Parameters
    ----------
    layout : Layout
    groups : sequence of Group
        Equations of motion, or several summed.
    known_masses : mapping of int to float, optional
        kg; those of sums of equations are needed.
    kind : {"gram", "root"}
        Sums of products, or triangular factors, which keep all digits (a streamed QR).
    n_blocks : int
        Numbers that exist from the start.
    before : NormalEquations, optional
        A total behind which the sums go on.
    plan : ProductPlan, optional
        That of sums of the same columns.
    """

    def __init__(
        self,
        layout: Layout,
        groups: Sequence[Group],
        known_masses: Mapping[int, float] | None = None,
        kind: str = "gram",
        n_blocks: int = 0,
        before: NormalEquations | None = None,
        plan: ProductPlan | None = None,
    ) -> None:
        self.layout = layout
        self.groups = {group.dofs: group for group in groups}
        self.known_masses = dict(known_masses or {})
        self.kind = kind
        self.counts: list[float] = []
        self._sums: list[_Products | _Roots] = []
        self._before = before
        self._plan = plan
        self._open(n_blocks - 1)

    @property
    def plan(self) -> ProductPlan:
        """Which products are taken; shared by all sums that :meth:`empty` makes."""
        if self._plan is None:
            groups = list(self.groups.values())
            self._plan = ProductPlan(self.layout, groups, self.known_masses)
        return self._plan

    def empty(self, before: NormalEquations | None = None) -> ProductSums:
        """Sums of the same columns that start from zero, or that continue a total."""
        return ProductSums(
            self.layout,
            list(self.groups.values()),
            self.known_masses,
            self.kind,
            before=before,
            plan=self.plan if self.kind == "gram" else None,
        )

    @property
    def n_samples(self) -> int:
        """Samples of all numbers, by their weights."""
        total = float(sum(self.counts))
        if self._before is not None:
            total += float(self._before.n_samples)
        return int(total)

    def add(
        self, block: Block, number: int = 0, products: np.ndarray | None = None
    ) -> ProductSums:
        """Add samples to a number, or their products if these are known; self."""
        self._open(number)
        self.counts[number] += block.weight
        self._sums[number].add(block, products)
        return self

    def add_each(self, blocks: Iterable[tuple[int, Block]]) -> ProductSums:
        """Add numbered blocks, on all cores; self."""
        for number, block, products in self.multiplied(blocks):
            self.add(block, number, products)
        return self

    def multiplied(
        self, blocks: Iterable[tuple[int, Block]]
    ) -> Iterator[tuple[int, Block, np.ndarray | None]]:
        """Numbered blocks with their products, which are found on all cores.

        Roots have no products.
        """
        if self.kind == "root":
            return ((number, block, None) for number, block in blocks)

        plan = self.plan  # made before the threads ask for it

        def products_of(
            share: list[tuple[int, Block]],
        ) -> list[tuple[int, Block, np.ndarray | None]]:
            products: list[tuple[int, Block, np.ndarray | None]] = []
            for number, block in share:
                store = np.zeros(plan.size)
                plan.multiply(block.weighted, store)
                products.append((number, block, store))
            return products

        shares = _shares(blocks, BLOCKS_PER_THREAD)
        return chain.from_iterable(in_threads(products_of, shares))

    def grams(self) -> NormalEquations:
        """The sums of each number."""
        matrices = {}
        sizes = {}
        for dofs, group in self.groups.items():
            p = width_of(self.layout, group)
            matrices[dofs] = np.zeros((len(self.counts), p, p))
            sizes[dofs] = np.zeros(len(self.counts))
            for number, sums in enumerate(self._sums):
                matrices[dofs][number], sizes[dofs][number] = sums.of_group(dofs)
        return NormalEquations(
            self.layout,
            self.groups,
            matrices,
            sizes,
            np.array(self.counts, dtype=float),
            self.known_masses,
            self.kind,
        )

    def total(self) -> NormalEquations:
        """The sums of all that was added under the number 0."""
        self._open(0)
        total = self.grams()[0]
        return total if self._before is None else self._before.merge(total)

    def _open(self, number: int) -> None:
        """Let all numbers up to this one exist."""
        while len(self.counts) <= number:
            self.counts.append(0)
            if self.kind == "root":
                self._sums.append(_Roots(self.layout, self.groups, self.known_masses))
            else:
                self._sums.append(_Products(self.plan))


class _Products:
    """Sums of products; those of samples with different unknown forces apart."""

    def __init__(self, plan: ProductPlan) -> None:
        self._plan = plan
        self._stores: dict[tuple[bool, ...], np.ndarray] = {}
        self._sizes: dict[tuple[bool, ...], float] = {}

    def add(self, block: Block, products: np.ndarray | None) -> None:
        """Add samples, or their products if these are known."""
        known = block.known
        if known not in self._stores:
            self._stores[known] = np.zeros(self._plan.size)
            self._sizes[known] = 0.0
        self._sizes[known] += block.weight
        if products is None:
            self._plan.multiply(block.weighted, self._stores[known])
        else:
            self._stores[known] += products

    def of_group(self, dofs: Dofs) -> tuple[np.ndarray, float]:
        """Products and samples of one equation, where its forces are known."""
        take = self._plan.take[dofs]
        matrix = np.zeros(take.shape)
        size = 0.0
        for known, store in self._stores.items():
            if _all_known(known, dofs):
                matrix += store[take]
                size += self._sizes[known]
        return matrix, size


class _Roots:
    """Triangular factors of the samples in which the forces of a group are known."""

    def __init__(
        self,
        layout: Layout,
        groups: Mapping[Dofs, Group],
        known_masses: Mapping[int, float],
    ) -> None:
        self._layout = layout
        self._groups = groups
        self._known_masses = known_masses
        self._roots: dict[Dofs, np.ndarray] = {}
        self._sizes = dict.fromkeys(groups, 0.0)
        for dofs, group in groups.items():
            p = width_of(layout, group)
            self._roots[dofs] = np.zeros((p, p))

    def add(self, block: Block, products: np.ndarray | None) -> None:
        """Add samples."""
        columns = block.weighted
        for dofs, group in self._groups.items():
            if _all_known(block.known, dofs):
                rows = rows_of(self._layout, group, columns, self._known_masses)
                stacked = np.hstack([self._roots[dofs].T, rows]).T
                self._roots[dofs] = root_of(stacked)
                self._sizes[dofs] += block.weight

    def of_group(self, dofs: Dofs) -> tuple[np.ndarray, float]:
        """Triangular factor and samples of one equation."""
        return self._roots[dofs], self._sizes[dofs]


def _all_known(known: Sequence[bool], dofs: Dofs) -> bool:
    """Whether the forces of some DOFs are known."""
    return all(known[j - 1] for j in dofs)


def _shares(
    blocks: Iterable[tuple[int, Block]], size: int
) -> Iterator[list[tuple[int, Block]]]:
    """Numbered blocks, some at a time."""
    rest = iter(blocks)
    share = list(islice(rest, size))
    while share:
        yield share
        share = list(islice(rest, size))


def pieces_of(
    data: Dataset,
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[ZeroPhaseFilter | None],
    known_masses: Mapping[int, float],
    runs: Sequence[Segment | None] | None = None,
    whiteners: Mapping[Dofs, Whitener] | None = None,
    edges: Sequence[np.ndarray] | None = None,
) -> NormalEquations:
    """Sums of products of consecutive pieces of the data.

    ``runs`` are free runs of the records, whose columns are the instruments; a record
    without one is left out. ``edges`` are the ends of the pieces of each record, equal
    pieces if None.
    """
    equations = BalanceEquations(data, layout, filters)
    chosen = list(range(len(data.segments)))
    twins: dict[int, Segment] = {}
    if runs is not None:
        twins = {i: run for i, run in enumerate(runs) if run is not None}
        chosen = list(twins)
    cuts = _equal_pieces(data, chosen)
    if edges is not None:
        cuts = {i: np.asarray(edges[i]) for i in chosen}

    if runs is None and not whiteners:
        sums = ProductSums(layout, groups, known_masses)
        pieces = sums.add_each(_numbered(equations, cuts)).grams()
    else:
        known = dict(known_masses)
        rows = _PieceRows(equations, groups, known, twins, whiteners or {})
        pieces = rows.sums(cuts)
    counts = [len(ends) - 1 for ends in cuts.values()]
    return replace(pieces, record=np.repeat(chosen, counts))


def _equal_pieces(data: Dataset, chosen: Sequence[int]) -> dict[int, np.ndarray]:
    """Ends of pieces of about equal length, by record."""
    sizes = {i: data.segments[i].n_valid for i in chosen}
    length = max(1, -(-sum(sizes.values()) // N_PIECES))
    cuts = {}
    for i, size in sizes.items():
        count = max(1, round(size / length))
        cuts[i] = np.linspace(0, size, count + 1).astype(int)
    return cuts


def _numbered(
    equations: BalanceEquations, cuts: Mapping[int, np.ndarray]
) -> Iterator[tuple[int, Block]]:
    """Blocks of the records with the numbers of their pieces."""
    first = 0
    for i, ends in cuts.items():
        yield from cut_at(ends, equations.blocks(i), first)
        first += len(ends) - 1


@dataclass(frozen=True)
class _PieceRows:
    """Rows of whole records with what stands behind or goes over them."""

    equations: BalanceEquations
    groups: Sequence[Group]
    known_masses: Mapping[int, float]
    # free runs by record: their columns, without the right-hand side, are instruments
    twins: Mapping[int, Segment]
    whiteners: Mapping[Dofs, Whitener]

    def sums(self, cuts: Mapping[int, np.ndarray]) -> NormalEquations:
        """Sums of products of the pieces of all records."""
        matrices: dict[Dofs, list[np.ndarray]] = {g.dofs: [] for g in self.groups}
        sizes: dict[Dofs, list[np.ndarray]] = {g.dofs: [] for g in self.groups}
        for i, ends in cuts.items():
            lengths = np.diff(ends)
            for group, rows, known in self._rows(i):
                sizes[group.dofs].append(lengths * known)
                for low, high in zip(ends[:-1], ends[1:]):
                    piece = rows[:, low:high]
                    matrices[group.dofs].append(piece @ piece.T)

        n_samples = np.concatenate([np.diff(ends) for ends in cuts.values()])
        counted = {dofs: np.concatenate(n).astype(float) for dofs, n in sizes.items()}
        return NormalEquations(
            self.equations.layout,
            {group.dofs: group for group in self.groups},
            {dofs: np.array(products) for dofs, products in matrices.items()},
            counted,
            n_samples.astype(float),
            self.known_masses,
            instrumented=bool(self.twins),
        )

    def _rows(self, record: int) -> Iterator[tuple[Group, np.ndarray, bool]]:
        """Rows of each group along a record, and whether its forces are known.

        Rows of unknown forces are zero.
        """
        layout = self.equations.layout
        block = self.equations.whole_record(record)
        twin = None
        run = self.twins.get(record)
        if run is not None:
            twin = whole_block(run, layout, self.equations.filters[record])

        for group in self.groups:
            rows = rows_of(layout, group, block, self.known_masses)
            if twin is not None:
                instruments = rows_of(layout, group, twin, self.known_masses)[:-1]
                rows = np.concatenate([rows, instruments])
            known = _all_known(block.known, group.dofs)
            if not known:
                rows = np.zeros_like(rows)
            whitener = self.whiteners.get(group.dofs)
            if whitener is not None:
                step = self.equations.data.segments[record].dt
                assert step is not None  # a whitener was made of spectra
                rows = whitener.apply(rows, step)
            yield group, rows, known
