"""Gram matrices of consecutive pieces of the data, with instruments or without: what re-solving needs.

A sum of pieces is any part of the data; leaving one out, or drawing them at random, and solving the whole chain again
carries every uncertainty to where it ends up (an error in R_3 reaches m_1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .blocks import Block, cut_at
from .gram_pass import block_grams, rows_of
from .grams import BlockGrams, width_of
from .layout import Group, LawLayout
from .segments import Segment, SegmentSet

N_PIECES = 64


def pieces_of(
    data: SegmentSet,
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    runs: Sequence[Segment | None] | None = None,
    n_pieces: int = N_PIECES,
    whiteners: Mapping[tuple[int, ...], Any] | None = None,
    edges: Sequence[np.ndarray] | None = None,
) -> BlockGrams:
    """Gram matrices of consecutive pieces of the data."""
    chosen = [i for i in range(len(data.segments)) if runs is None or runs[i] is not None]
    known = {int(j): float(m) for j, m in known_masses.items()}
    if edges is None:
        lengths = {i: data.segments[i].n_valid for i in chosen}
        length = max(1, -(-sum(lengths.values()) // n_pieces))
        cuts = {i: np.linspace(0, n, max(1, round(n / length)) + 1).astype(int) for i, n in lengths.items()}
    else:
        cuts = {i: np.asarray(edges[i]) for i in chosen}
    counts = [len(cuts[i]) - 1 for i in chosen]
    record = np.repeat(chosen, counts)
    if runs is None and not whiteners:
        numbered = (
            pair for i, first in zip(chosen, np.cumsum([0, *counts]).tolist())
            for pair in cut_at(cuts[i], data.segments[i].blocks(layout, filter=filters[i]), first)
        )  # fmt: skip
        return replace(block_grams(layout, groups, numbered, known), record=record)
    grams: dict[tuple[int, ...], list[np.ndarray]] = {g.dofs: [] for g in groups}
    sizes: dict[tuple[int, ...], list[int]] = {g.dofs: [] for g in groups}
    for i in chosen:
        block = whole_block(data.segments[i], layout, filters[i])
        twin = None if runs is None else whole_block(runs[i], layout, filters[i])
        spans = [slice(lo, hi) for lo, hi in zip(cuts[i][:-1], cuts[i][1:])]
        for group in groups:
            width = width_of(layout, group) * (1 if twin is None else 2) - (twin is not None)
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
    return BlockGrams(
        layout, {g.dofs: g for g in groups}, {dofs: np.array(held) for dofs, held in grams.items()},
        {dofs: np.array(held, dtype=float) for dofs, held in sizes.items()},
        np.concatenate([np.diff(cuts[i]) for i in chosen]).astype(float), known,
        instrumented=runs is not None, record=record,
    )  # fmt: skip


def whole_block(segment: Any, layout: LawLayout, filter: Any) -> Block:
    """All valid rows of a record as one block, its arrays our own."""
    parts = list(segment.blocks(layout, filter=filter))
    terms, acceleration, force = (
        np.concatenate([getattr(p, k) for p in parts], axis=1) for k in ("terms", "acceleration", "force")
    )
    return Block(terms, acceleration, force)
