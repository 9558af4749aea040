"""The pass over the samples: blocks of rows in, Gram matrices of the balances out, on
all cores.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from typing import Any

import numpy as np

from ..chain.layout import Block, Group, LawLayout, Layout, cut_at
from ..common.threads import in_threads
from ..records.dataset import Dataset, Segment
from .balances import blocks_of_segment
from .compiled_sums import Plan
from .normal_equations import NormalEquations, root_of, width_of

N_PIECES = 64  # over all records
SHARE = 4  # blocks that a thread takes at once


def total_gram(
    layout: Layout,
    groups: Sequence[Group],
    blocks: Iterable[Block],
    known_masses: Mapping[int, float] | None = None,
    kind: str = "gram",
) -> NormalEquations:
    """Gram matrices of all samples of some blocks; ``kind`` as for
    :class:`GramPass`.
    """
    return (
        GramPass(layout, groups, known_masses, kind)
        .add_each((0, block) for block in blocks)
        .total()
    )


class GramPass:
    """Running sums of the products of the columns; "root" keeps all digits, by a
    streamed QR.
    """

    def __init__(
        self,
        layout: Layout,
        groups: Sequence[Group],
        known_masses: Mapping[int, float] | None = None,
        kind: str = "gram",
        n_blocks: int = 0,
    ) -> None:
        self.layout, self.groups, self.kind = layout, {g.dofs: g for g in groups}, kind
        self.known_masses = dict(known_masses or {})
        self._widths = {g.dofs: width_of(layout, g) for g in groups}
        self.counts: list[float] = []  # samples of each number, by their weights
        # products and samples by the known forces; for "root" roots and samples by
        # balance
        self._sums: list[dict[tuple, list[Any]]] = []
        self._before: NormalEquations | None = None
        self._plan: Plan | None = None
        self._open(n_blocks - 1)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_plan": None}

    @property
    def plan(self) -> Plan:
        """Which products are taken; shared by all passes that :meth:`empty` makes."""
        if self._plan is None:
            self._plan = Plan(
                self.layout, list(self.groups.values()), self.known_masses
            )
        return self._plan

    def empty(self, before: NormalEquations | None = None) -> GramPass:
        """A pass over the same columns that has seen nothing, or that goes on behind a
        total.
        """
        out = GramPass(
            self.layout, list(self.groups.values()), self.known_masses, self.kind
        )
        out._plan, out._before = (self.plan if self.kind == "gram" else None), before
        return out

    @property
    def n_samples(self) -> int:
        """Samples of all numbers, by their weights."""
        return int(
            sum(self.counts) + (0 if self._before is None else self._before.n_samples)
        )

    def add(
        self, block: Block, number: int = 0, products: np.ndarray | None = None
    ) -> GramPass:
        """Add samples to a number, or their products if these are known; self."""
        self._open(number)
        self.counts[number] += block.weight
        if self.kind == "root":
            columns = block.weighted
            for dofs, part in self._sums[number].items():
                if all(block.known[j - 1] for j in dofs):
                    rows = rows_of(
                        self.layout, self.groups[dofs], columns, self.known_masses
                    )
                    part[0] = root_of(np.hstack([part[0].T, rows]).T)
                    part[1] += block.weight
            return self
        held = self._sums[number].setdefault(block.known, [np.zeros(self.plan.size), 0])
        held[1] += block.weight
        if products is None:
            self.plan.multiply(block.weighted, held[0])
        else:
            held[0] += products
        return self

    def add_each(self, blocks: Iterable[tuple[int, Block]]) -> GramPass:
        """Add numbered blocks, on all cores; self."""
        for number, block, products in self.multiplied(blocks):
            self.add(block, number, products)
        return self

    def multiplied(
        self, blocks: Iterable[tuple[int, Block]]
    ) -> Iterator[tuple[int, Block, np.ndarray | None]]:
        """Numbered blocks with their products, which are found on all cores; none for
        roots.
        """
        plan, rest = (
            self.plan if self.kind == "gram" else None,
            iter(blocks),
        )  # made before the threads ask for it

        def product(number: int, block: Block) -> tuple[int, Block, np.ndarray | None]:
            store = np.zeros(plan.size) if plan else None
            if plan and store is not None:
                plan.multiply(block.weighted, store)
            return number, block, store

        def products(
            share: list[tuple[int, Block]],
        ) -> list[tuple[int, Block, np.ndarray | None]]:
            return [product(*one) for one in share]

        return chain.from_iterable(
            in_threads(products, iter(lambda: list(islice(rest, SHARE)), []))
        )

    def grams(self) -> NormalEquations:
        """Gram matrices or roots of each number."""
        shape = (len(self.counts),)
        matrices = {dofs: np.zeros((*shape, p, p)) for dofs, p in self._widths.items()}
        sizes = {dofs: np.zeros(shape) for dofs in matrices}
        for number in range(len(self.counts)):
            for dofs, matrix in matrices.items():
                if self.kind == "root":
                    matrix[number], sizes[dofs][number] = self._sums[number][dofs]
                    continue
                take = self.plan.take[dofs]
                for known, (store, size) in self._sums[number].items():
                    if all(known[j - 1] for j in dofs):
                        matrix[number] += store[take]
                        sizes[dofs][number] += size
        counts = np.array(self.counts, dtype=float)
        return NormalEquations(
            self.layout,
            self.groups,
            matrices,
            sizes,
            counts,
            self.known_masses,
            self.kind,
        )

    def total(self) -> NormalEquations:
        """Gram matrices or roots of all that was added under the number 0."""
        self._open(0)
        out = self.grams()[0]
        return out if self._before is None else self._before.merge(out)

    def _open(self, number: int) -> None:
        while len(self.counts) <= number:
            self.counts.append(0)
            roots = self._widths.items() if self.kind == "root" else ()
            self._sums.append({dofs: [np.zeros((p, p)), 0.0] for dofs, p in roots})


def rows_of(
    layout: Layout, group: Group, block: Block, known_masses: Mapping[int, float]
) -> np.ndarray:
    """Rows ``[terms | a | F]`` of a balance, ``[terms | F - m a]`` of a sum of
    balances, for all samples of a block.
    """
    own = [block.terms[layout.slices[s]] for s in group.sites]
    index = [j - 1 for j in group.dofs]
    if len(index) == 1:
        return np.vstack([*own, block.acceleration[index], block.force[index]])
    inertia = (
        np.array([known_masses[j] for j in group.dofs]) @ block.acceleration[index]
    )
    return np.vstack([*own, block.force[index].sum(axis=0) - inertia])


def pieces_of(
    data: Dataset,
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    runs: Sequence[Segment | None] | None = None,
    whiteners: Mapping[tuple[int, ...], Any] | None = None,
    edges: Sequence[np.ndarray] | None = None,
) -> NormalEquations:
    """Gram matrices of consecutive pieces of the data."""
    chosen = [
        i for i in range(len(data.segments)) if runs is None or runs[i] is not None
    ]
    known = {int(j): float(m) for j, m in known_masses.items()}
    if edges is None:
        lengths = {i: data.segments[i].n_valid for i in chosen}
        length = max(1, -(-sum(lengths.values()) // N_PIECES))
        cuts = {
            i: np.linspace(0, n, max(1, round(n / length)) + 1).astype(int)
            for i, n in lengths.items()
        }
    else:
        cuts = {i: np.asarray(edges[i]) for i in chosen}
    counts = [len(cuts[i]) - 1 for i in chosen]
    record = np.repeat(chosen, counts)
    if runs is None and not whiteners:
        numbered = (
            pair
            for i, first in zip(chosen, np.cumsum([0, *counts]).tolist())
            for pair in cut_at(
                cuts[i],
                blocks_of_segment(data.segments[i], layout, filter=filters[i]),
                first,
            )
        )
        return replace(
            GramPass(layout, groups, known).add_each(numbered).grams(), record=record
        )
    grams: dict[tuple[int, ...], list[np.ndarray]] = {g.dofs: [] for g in groups}
    sizes: dict[tuple[int, ...], list[int]] = {g.dofs: [] for g in groups}
    for i in chosen:
        block = whole_block(data.segments[i], layout, filters[i])
        twin = None if runs is None else whole_block(runs[i], layout, filters[i])
        spans = [slice(lo, hi) for lo, hi in zip(cuts[i][:-1], cuts[i][1:])]
        for group in groups:
            width = width_of(layout, group) * (1 if twin is None else 2) - (
                twin is not None
            )
            if not all(block.known[j - 1] for j in group.dofs):
                grams[group.dofs] += [np.zeros((width, width))] * len(spans)
                sizes[group.dofs] += [0] * len(spans)
                continue
            rows = rows_of(layout, group, block, known)
            if twin is not None:
                rows = np.vstack([rows, rows_of(layout, group, twin, known)[:-1]])
            if whiteners is not None and whiteners.get(group.dofs) is not None:
                rows = whiteners[group.dofs].apply(rows, data.segments[i].dt)
            grams[group.dofs] += [(part := rows[:, span]) @ part.T for span in spans]
            sizes[group.dofs] += [span.stop - span.start for span in spans]
    return NormalEquations(
        layout,
        {g.dofs: g for g in groups},
        {dofs: np.array(held) for dofs, held in grams.items()},
        {dofs: np.array(held, dtype=float) for dofs, held in sizes.items()},
        np.concatenate([np.diff(cuts[i]) for i in chosen]).astype(float),
        known,
        instrumented=runs is not None,
        record=record,
    )


def whole_block(segment: Any, layout: LawLayout, filter: Any) -> Block:
    """All valid rows of a record as one block, its arrays our own."""
    parts = list(blocks_of_segment(segment, layout, filter=filter))
    whole = [
        np.concatenate([getattr(p, k) for p in parts], axis=1)
        for k in ("terms", "acceleration", "force")
    ]
    return Block(whole[0], whole[1], whole[2])
