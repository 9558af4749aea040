"""Moments of consecutive pieces of the data, with instruments or without: what re-solving needs.

A sum of pieces is the moments of any part of the data; leaving one out, or drawing them at random,
and solving the whole chain again carries every uncertainty to where it ends up (an error in R_3
reaches m_1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .layout import Group, LawLayout
from .moments import Block, GroupMoments, Moments
from .segments import Segment, SegmentSet

N_PIECES = 64
# Directions of the instruments whose share of the largest is below this are round-off.
_CUT = 1e-12


@dataclass
class Pieces:
    """Gram matrices of ``[columns of a group | its instruments]``, piece by piece.

    Attributes
    ----------
    layout : LawLayout
    groups : list of Group
    known_masses : dict of int to float
        kg.
    grams : dict of tuple of int to ndarray of shape (n_pieces, q, q)
        By the DOFs of the group.
    sizes : dict of tuple of int to ndarray of shape (n_pieces,)
        Samples in which the group's forces are known.
    record : ndarray of shape (n_pieces,)
        Number of the record of each piece.
    instrumented : bool
        Whether the rows hold instruments behind the columns.

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> fitted = NRFRegressor(degree=3).fit(datasets.load_demo())
    >>> pieces = fitted._resolving().pieces  # what its intervals are taken from
    >>> len(pieces), pieces.instrumented
    (63, False)
    """

    layout: LawLayout
    groups: list[Group]
    known_masses: dict[int, float]
    grams: dict[tuple[int, ...], np.ndarray]
    sizes: dict[tuple[int, ...], np.ndarray]
    record: np.ndarray
    instrumented: bool

    def __len__(self) -> int:
        return len(self.record)

    def moments(self, weights: np.ndarray | None = None) -> Moments:
        """Moments of the pieces, each taken ``weights`` times; columns projected on the instruments."""
        weights = np.ones(len(self)) if weights is None else weights
        out = Moments(self.layout, [], "gram", self.known_masses)
        for group in self.groups:
            gram = np.tensordot(weights, self.grams[group.dofs], 1)
            n = _width(self.layout, group)
            part = GroupMoments(0, "root" if self.instrumented else "gram")
            part.matrix = _projected(gram, n) if self.instrumented else gram
            part.n_samples = int(round(weights @ self.sizes[group.dofs]))
            out.groups[group.dofs], out.parts[group.dofs] = group, part
            out.n_samples = max(out.n_samples, part.n_samples)
        return out


def pieces_of(
    data: SegmentSet,
    layout: LawLayout,
    groups: Sequence[Group],
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    runs: Sequence[Segment | None] | None = None,
    n_pieces: int = N_PIECES,
    whiteners: Mapping[tuple[int, ...], Any] | None = None,
) -> Pieces:
    """Cut the data into consecutive pieces and take the moments of each."""
    chosen = [i for i in range(len(data.segments)) if runs is None or runs[i] is not None]
    total = sum(data.segments[i].n_valid for i in chosen)
    length = max(1, -(-total // n_pieces))
    known = {int(j): float(m) for j, m in known_masses.items()}
    grams: dict[tuple[int, ...], list[np.ndarray]] = {g.dofs: [] for g in groups}
    sizes: dict[tuple[int, ...], list[int]] = {g.dofs: [] for g in groups}
    record: list[int] = []
    for i in chosen:
        block = whole_block(data.segments[i], layout, filters[i])
        run = None if runs is None else runs[i]
        twin = None if run is None else whole_block(run, layout, filters[i])
        n = block.acceleration.shape[1]
        edges = np.linspace(0, n, max(1, round(n / length)) + 1).astype(int)
        record += [i] * (len(edges) - 1)
        for group in groups:
            n_rows = _width(layout, group) + (0 if twin is None else _width(layout, group) - 1)
            if any(np.isnan(block.force[j - 1, 0]) for j in group.dofs):
                grams[group.dofs] += [np.zeros((n_rows, n_rows))] * (len(edges) - 1)
                sizes[group.dofs] += [0] * (len(edges) - 1)
                continue
            rows = rows_of(layout, group, block, known)
            if twin is not None:
                rows = np.vstack([rows, rows_of(layout, group, twin, known)[:-1]])
            if whiteners is not None and whiteners.get(group.dofs) is not None:
                rows = whiteners[group.dofs].apply(rows, data.segments[i].dt)
            for lo, hi in zip(edges[:-1], edges[1:]):
                grams[group.dofs].append(rows[:, lo:hi] @ rows[:, lo:hi].T)
                sizes[group.dofs].append(hi - lo)
    return Pieces(
        layout,
        list(groups),
        known,
        {dofs: np.array(held) for dofs, held in grams.items()},
        {dofs: np.array(held, dtype=float) for dofs, held in sizes.items()},
        np.array(record, dtype=int),
        runs is not None,
    )


def whole_block(segment: Segment, layout: LawLayout, filter: Any) -> Block:
    """All valid rows of a record as one block, its arrays our own."""
    parts = list(segment.blocks(layout, filter=filter))
    terms, acceleration, force = (
        np.concatenate([getattr(p, k) for p in parts], axis=1) for k in ("terms", "acceleration", "force")
    )
    return Block(terms, acceleration, force)


def _width(layout: LawLayout, group: Group) -> int:
    return sum(layout.counts[s] for s in group.sites) + (2 if len(group.dofs) == 1 else 1)


def rows_of(layout: LawLayout, group: Group, block: Block, known: Mapping[int, float]) -> np.ndarray:
    """Rows ``[terms | a | F]`` of a balance, ``[terms | F - m a]`` of a sum of balances."""
    own = [block.terms[layout.slices[s]] for s in group.sites]
    index = [j - 1 for j in group.dofs]
    if len(index) == 1:
        return np.vstack([*own, block.acceleration[index], block.force[index]])
    inertia = np.array([known[j] for j in group.dofs]) @ block.acceleration[index]
    return np.vstack([*own, block.force[index].sum(axis=0) - inertia])


def _projected(gram: np.ndarray, n: int) -> np.ndarray:
    """Root of the moments of the first n columns projected on the others, at most n; square, zeros below."""
    inner, cross = gram[n:, n:], gram[n:, :n]
    scale = np.sqrt(np.diag(inner))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(inner / scale[:, None] / scale)
    good = values > _CUT * values[-1]
    out = np.zeros((n, n))
    out[: good.sum()] = (vectors[:, good] / np.sqrt(values[good])).T @ (cross / scale[:, None])
    return out
