"""What a search asks of the solve of many sums of products of columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..chain.layout import Group


class ManySolver(Protocol):
    """Masses and coefficients from many sums of products of columns at once.

    Attributes
    ----------
    groups : list of Group
        Equations of which each has a sum of products.
    judged : list of int
        For each judged equation the number of the sum of products that holds it.
    rows_of_group : list of list of int
        Rows that stand in the equations of each group.
    """

    groups: list[Group]
    judged: list[int]
    rows_of_group: list[list[int]]

    def beside(self, rows: Sequence[int]) -> list[int]:
        """Rows that stand in an equation together with some of these."""

    def solve(
        self, sums: np.ndarray, strict: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, n_rows).

        ``sums`` are (n_fits, n_groups, n_rows, n_rows).
        """

    def rows(
        self, masses: np.ndarray, coefficients: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of rows that are residual and reference of each equation.

        Both are (n_fits, n_equations, n_rows).
        """
