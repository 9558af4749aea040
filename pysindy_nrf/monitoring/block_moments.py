"""Moments of consecutive pieces of a record: windows, halves and replicates are sums of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..exceptions import ChannelError
from ..mechanics.identifiability import Walk, plan_walk
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import Solution, groups_of, solve
from ..regression.layout import LawLayout
from ..regression.moments import Block, Moments
from ..regression.segments import SegmentSet
from ..regression.solution import model_of


@dataclass
class BlockMoments:
    """Moments of consecutive pieces of the data.

    Attributes
    ----------
    layout : LawLayout
    walk : Walk
        The order of the solve.
    known_masses : dict of int to float
        kg.
    pieces : list of Moments
        In the order of time, record after record.
    edges : ndarray of shape (n_pieces, 2)
        Start and end of each piece, s from the start of its record.
    record : ndarray of shape (n_pieces,)
        Number of the record of each piece.
    """

    layout: LawLayout
    walk: Walk
    known_masses: dict[int, float]
    pieces: list[Moments]
    edges: np.ndarray
    record: np.ndarray

    def total(self, chosen: Iterable[int] | None = None) -> Moments:
        """Sum of some pieces, all by default."""
        out = self.empty()
        for i in range(len(self.pieces)) if chosen is None else chosen:
            out.merge(self.pieces[int(i)])
        return out

    def sums(self) -> tuple[list[Moments], list[Moments]]:
        """Sums of the pieces before each boundary, and after it; n_pieces + 1 of each."""
        before, after = [self.empty()], [self.empty()]
        for first, last in zip(self.pieces, self.pieces[::-1]):
            before.append(self.empty().merge(before[-1]).merge(first))
            after.append(self.empty().merge(after[-1]).merge(last))
        return before, after[::-1]

    def empty(self) -> Moments:
        """Moments of nothing."""
        like = self.pieces[0]
        return Moments(like.layout, list(like.groups.values()), like.kind, like.known_masses)

    def solve(self, moments: Moments) -> tuple[ChainModel, Solution]:
        """Model of some moments."""
        solution = solve(moments, self.walk, self.known_masses)
        return model_of(self.layout, solution), solution


def block_moments(
    estimator: Any,
    data: SegmentSet,
    known_masses: Mapping[int, float] | None = None,
    *,
    n_blocks: int | None = None,
    length: float | None = None,
) -> BlockMoments:
    """Moments of consecutive pieces."""
    from ..signals.zero_phase_filter import filters_of

    layout = LawLayout(estimator.chain_, estimator.model_.laws)
    known = dict(estimator._known_masses(layout.chain) if known_masses is None else known_masses)
    walk = plan_walk(
        layout.chain, data.forced, data.unknown, known, estimator.strategy, layout.acting
    ).require_complete()
    groups = groups_of(layout, walk)
    pieces, edges, record = [], [], []
    whole = sum(seg.n_valid for seg in data.segments)
    for number, (seg, filter) in enumerate(zip(data.segments, filters_of(estimator.band, data))):
        n = seg.n_valid
        if length is None:
            size = int(np.ceil(whole / (n_blocks or 1)))
        elif seg.dt is None:
            raise ChannelError("A window in seconds needs the sampling step", "Pass dt= (s), or X with a time index.")
        else:
            size = int(round(length / seg.dt))
        if size < layout.n_dof + 2:
            raise ChannelError(f"Pieces of {size} samples are too short", "Use longer windows or fewer blocks.")
        parts = list(seg.blocks(layout, filter=filter))
        terms, a, force = (
            np.concatenate([getattr(b, k) for b in parts], axis=1) for k in ("terms", "acceleration", "force")
        )
        t = seg.t[seg.valid] if seg.t is not None else np.arange(n, dtype=float)
        # a rest shorter than half a piece joins the last one
        starts = [*range(0, max(n - size // 2, 1), size), n]
        for start, stop in zip(starts[:-1], starts[1:]):
            moments = Moments(layout, groups, "gram", known)
            moments.add(Block(terms[:, start:stop], a[:, start:stop], force[:, start:stop]))
            pieces.append(moments)
            edges.append((t[start], t[stop - 1]))
            record.append(number)
    return BlockMoments(layout, walk, known, pieces, np.array(edges), np.array(record))
