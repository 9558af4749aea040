"""Samples of one equation of motion, for optimizers that need more than products."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..chain.layout import Block, Group, Layout
from .balances import rows_of


@dataclass(frozen=True)
class EquationRows:
    """Reads the samples of the equations of motion again, one equation at a time.

    Attributes
    ----------
    layout : Layout
    blocks : callable
        Gives all samples again, block by block.
    known_masses : mapping of int to float
        kg; those of summed equations are needed.
    """

    layout: Layout
    blocks: Callable[[], Iterable[Block]]
    known_masses: Mapping[int, float]

    def combined(self, group: Group, combine: np.ndarray) -> np.ndarray:
        """Combinations of an equation's columns, (n_samples, n_combinations).

        Samples in which a force of the equation is unknown are left out.

        Parameters
        ----------
        group : Group
        combine : ndarray of shape (n_columns, n_combinations)
        """
        parts = []
        for block in self.blocks():
            if not all(block.known[j - 1] for j in group.dofs):
                continue
            rows = rows_of(self.layout, group, block.weighted, self.known_masses)
            parts.append(rows.T @ combine)
        return np.concatenate(parts)
