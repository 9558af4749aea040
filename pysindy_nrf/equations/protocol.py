"""What a search asks of equations, whatever they are made of.

Two kinds of equations are linear in masses and in coefficients of laws. Where every
floor is measured, the equations of motion balance measured forces and accelerations
(:class:`~pysindy_nrf.equations.balances.BalanceEquations`). Where floors have no
sensor, the measured channels are compared with the free run of a model, linearised
about it: a force at a site changes every channel by the response of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..chain.sites import Site
from ..laws.base import ForceLaw


class Equations(Protocol):
    """Columns of laws and masses, and right-hand sides, along records.

    A column is one line of samples, which stands in several equations with the signs
    of its site; or one line for each measured channel, and the lines of one column
    follow each other.
    """

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""

    @property
    def n_channels(self) -> int:
        """Lines of one column: 1, or the number of measured channels."""

    def columns(self, law: ForceLaw, site: Site, record: int) -> np.ndarray:
        """Columns of a law at a site, (n_terms * n_channels, n_samples)."""

    def inertias(self, record: int) -> np.ndarray:
        """Columns of the masses, (n_dof * n_channels, n_samples)."""

    def target(self, record: int) -> np.ndarray:
        """Right-hand sides, (n_sides * n_channels, n_samples).

        The forces on the DOFs; or what the forces do to the channels, then the channels
        themselves, over which a residual is judged.
        """


class ManySolver(Protocol):
    """Masses and coefficients from many sums of products of columns at once.

    Attributes
    ----------
    judged : list of int
        For each judged equation the number of the sum of products that holds it.
    """

    judged: list[int]

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
