"""Consecutive samples of one record, as the pass over the samples takes them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from .layout import Layout, Recipe

# Samples in a block of finished columns; blocks of motions hold fewer where there are many channels, so that a
# block stays in the cache.
BLOCK = 2048
_CACHE = 2**17  # numbers


def block_size(layout: Layout) -> int:
    """Samples in a block of a layout, between 512 and 4096."""
    return int(np.clip(_CACHE // max(4 * layout.n_dof, 1) // 256 * 256, 512, 2 * BLOCK))


class Block:
    """Some consecutive samples of one record, one row for each column; NaN for a DOF whose force is unknown."""

    def __init__(
        self,
        terms: np.ndarray | None,
        acceleration: np.ndarray,
        force: np.ndarray,
        source: np.ndarray | None = None,
        recipe: Recipe | None = None,
        n_terms: int = 0,
    ) -> None:
        # arrays may be views of the user's own; without finished columns, source and recipe say how they follow
        self._terms, self.acceleration, self.force = terms, acceleration, force
        self.source, self.recipe, self.n_terms = source, recipe, n_terms

    @property
    def terms(self) -> np.ndarray:
        """Columns of all sites, shape (n_terms, n)."""
        if self._terms is None:
            assert self.recipe is not None and self.source is not None  # a block has its columns or these
            self.source = np.ascontiguousarray(self.source)
            self._terms = self.recipe.finish(self.source, self.n_terms)
        return self._terms

    @property
    def n_samples(self) -> int:
        """Samples."""
        return self.acceleration.shape[1]

    @property
    def known(self) -> tuple[bool, ...]:
        """Whether the force of each DOF is known."""
        return tuple(np.isfinite(self.force[:, 0]).tolist())

    def take(self, rows: Any) -> Block:
        """Some of the samples; ``rows`` is a slice or an index array."""
        if isinstance(rows, slice) and rows == slice(0, self.acceleration.shape[1]):
            return self
        a, force = self.acceleration[:, rows], self.force[:, rows]
        if self.recipe is None or self.source is None:
            return Block(self.terms[:, rows], a, force)
        return Block(None, a, force, self.source[:, rows], self.recipe, self.n_terms)


def blocks_of(terms: np.ndarray, acceleration: np.ndarray, force: np.ndarray, size: int = BLOCK) -> Iterator[Block]:
    """Cut ready-made columns, one row for each sample, into blocks of ``size`` samples."""
    for start in range(0, len(acceleration), size):
        rows = slice(start, start + size)
        yield Block(terms[rows].T, acceleration[rows].T, force[rows].T)


def cut_at(edges: np.ndarray, blocks: Iterable[Block], first: int = 0) -> Iterator[tuple[int, Block]]:
    """Number the samples of a record by the piece they are in, from ``first`` on."""
    at = 0
    for block in blocks:
        stop = at + block.n_samples
        cuts = [at, *edges[(edges > at) & (edges < stop)].tolist(), stop]
        piece = int(np.searchsorted(edges, at, side="right")) - 1
        for number, (low, high) in enumerate(zip(cuts[:-1], cuts[1:]), piece + first):
            yield number, block.take(slice(low - at, high - at))
        at = stop
