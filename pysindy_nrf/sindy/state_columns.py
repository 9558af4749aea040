"""Features of a chain in state space: which column is a velocity, a term, a force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.layout import LawLayout, Layout
from ..chain.sites import Site


@dataclass(frozen=True)
class StateColumns:
    """Velocities, terms of every site, forces, in this order.

    Attributes
    ----------
    layout : Layout
    velocities : tuple of int
        DOFs whose velocity is its own column. The others are sums of terms v_i.
    forces : tuple of int
        DOFs on which the columns of forces act; the others are unforced.
    rates : dict of int to int
        Place of the term v_i among the terms, by storey.
    """

    layout: Layout
    velocities: tuple[int, ...]
    forces: tuple[int, ...]
    rates: dict[int, int]

    @classmethod
    def of_laws(cls, layout: LawLayout, forces: Sequence[int]) -> StateColumns:
        """No column is a combination of others: v_i is a term, or xdot_i a column."""
        rates = {}
        for dof in range(1, layout.n_dof + 1):
            site = Site(f"storey {dof}")
            if site in layout.acting and "v" in layout.labels(site):
                place = layout.slices[site].start + layout.labels(site).index("v")
                rates[dof] = place
        velocities = [dof for dof in range(1, layout.n_dof + 1) if dof not in rates]
        return cls(layout, tuple(velocities), tuple(forces), rates)

    @classmethod
    def of_counts(cls, layout: Layout) -> StateColumns:
        """Every velocity and every force has a column."""
        dofs = tuple(range(1, layout.n_dof + 1))
        return cls(layout, dofs, dofs, {})

    @property
    def terms(self) -> slice:
        """Columns of the terms."""
        start = len(self.velocities)
        return slice(start, start + self.layout.n_terms)

    @property
    def n_columns(self) -> int:
        """Columns in all."""
        return self.terms.stop + len(self.forces)

    def force(self, features: np.ndarray) -> np.ndarray:
        """Forces on all DOFs, (n_samples, n_dof)."""
        F = np.zeros((len(features), self.layout.n_dof))
        F[:, [j - 1 for j in self.forces]] = features[:, self.terms.stop :]
        return F

    def rows(self, equations: np.ndarray, masses: np.ndarray) -> np.ndarray:
        """Coefficients of xdot_1..xdot_n, then of the accelerations.

        Parameters
        ----------
        equations : ndarray of shape (n_dof, n_terms)
            Coefficients of the terms in the equations of motion.
        masses : ndarray of shape (n_dof,)
            kg.
        """
        n_dof = self.layout.n_dof
        out = np.zeros((2 * n_dof, self.n_columns))
        for row, dof in enumerate(range(1, n_dof + 1)):
            if dof in self.rates:
                # xdot_i is v_i above the velocity of the DOF below
                out[row] = out[row - 1] if row else 0.0
                out[row, self.terms.start + self.rates[dof]] = 1.0
            else:
                out[row, self.velocities.index(dof)] = 1.0

        accelerations = out[n_dof:]
        accelerations[:, self.terms] = -equations / masses[:, None]
        for i, dof in enumerate(self.forces):
            accelerations[dof - 1, self.terms.stop + i] = 1.0 / masses[dof - 1]
        return out
