"""Blocks of samples: the columns of all equations of motion, some samples at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from .recipe import Recipe

if TYPE_CHECKING:
    from .layout import Layout

# Samples in a block of finished columns.
BLOCK = 2048
# Numbers of a block that stay in the cache; blocks of many channels have fewer samples.
CACHED_NUMBERS = 2**17


def block_size(layout: Layout) -> int:
    """Samples in a block of a layout, between 512 and 4096."""
    samples = CACHED_NUMBERS // max(4 * layout.n_dof, 1)
    return int(np.clip(samples // 256 * 256, 512, 2 * BLOCK))


class Block:
    """Some consecutive samples of one record; one row for each column.

    The arrays may be views of the user's own. Without finished columns, source and
    recipe determine them.

    Parameters
    ----------
    terms : ndarray of shape (n_terms, n_samples), optional
    acceleration, force : ndarray of shape (n_dof, n_samples)
        m/s^2 and N; NaN for a DOF whose force is unknown.
    source : ndarray of shape (recipe.n_source, n_samples), optional
    recipe : Recipe, optional
    n_terms : int
        Columns that the recipe makes.
    weights : ndarray of shape (n_samples,), optional
    """

    def __init__(
        self,
        terms: np.ndarray | None,
        acceleration: np.ndarray,
        force: np.ndarray,
        source: np.ndarray | None = None,
        recipe: Recipe | None = None,
        n_terms: int = 0,
        weights: np.ndarray | None = None,
    ) -> None:
        self._terms = terms
        self.acceleration = acceleration
        self.force = force
        self.source = source
        self.recipe = recipe
        self.n_terms = n_terms
        self.weights = weights

    @property
    def terms(self) -> np.ndarray:
        """Columns of all sites, shape (n_terms, n_samples)."""
        if self._terms is None:
            assert self.recipe is not None and self.source is not None
            self.source = np.ascontiguousarray(self.source)
            self._terms = self.recipe.finish(self.source, self.n_terms)
        return self._terms

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.acceleration.shape[1]

    @property
    def weight(self) -> float:
        """Sum of the weights of the samples; their number where they have none."""
        return self.n_samples if self.weights is None else float(self.weights.sum())

    @property
    def weighted(self) -> Block:
        """Columns times the root of the weights: a sample of weight 2 counts twice."""
        if self.weights is None:
            return self
        root = np.sqrt(self.weights)
        return Block(self.terms * root, self.acceleration * root, self.force * root)

    @property
    def known(self) -> tuple[bool, ...]:
        """Whether the force of each DOF is known."""
        return tuple(np.isfinite(self.force[:, 0]).tolist())

    def take(self, rows: slice | np.ndarray) -> Block:
        """Some of the samples."""
        if isinstance(rows, slice) and rows == slice(0, self.n_samples):
            return self

        a = self.acceleration[:, rows]
        force = self.force[:, rows]
        weights = None if self.weights is None else self.weights[rows]
        if self.recipe is None or self.source is None:
            return Block(self.terms[:, rows], a, force, weights=weights)
        source = self.source[:, rows]
        return Block(None, a, force, source, self.recipe, self.n_terms, weights)


def blocks_of(
    terms: np.ndarray,
    acceleration: np.ndarray,
    force: np.ndarray,
    size: int = BLOCK,
    weights: np.ndarray | None = None,
) -> Iterator[Block]:
    """Cut ready-made columns, one row a sample, into blocks of ``size`` samples."""
    for start in range(0, len(acceleration), size):
        rows = slice(start, start + size)
        yield Block(
            terms[rows].T,
            acceleration[rows].T,
            force[rows].T,
            weights=None if weights is None else weights[rows],
        )


def cut_at(
    edges: np.ndarray, blocks: Iterable[Block], first: int = 0
) -> Iterator[tuple[int, Block]]:
    """Cut the blocks of a record at ``edges``; number the pieces from ``first`` on."""
    start = 0
    for block in blocks:
        stop = start + block.n_samples
        inside = edges[(edges > start) & (edges < stop)]
        cuts = [start, *inside.tolist(), stop]

        number = first + int(np.searchsorted(edges, start, side="right")) - 1
        for low, high in zip(cuts[:-1], cuts[1:]):
            yield number, block.take(slice(low - start, high - start))
            number += 1
        start = stop
