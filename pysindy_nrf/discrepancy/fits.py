"""The chain solve on many Gram matrices at once: what ranks the candidates.

The equations are those of :mod:`pysindy_nrf.regression.chain_solve` with plain least squares, compiled, so that every
law, site, shape and fold costs microseconds. The model that is reported is solved by ``chain_solve.solve`` itself, with
which this agrees to round-off (tested).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ..mechanics.identifiability import SolveOrder
from ..mechanics.sites import Site
from ..regression.chain_solve import groups_of
from ..regression.gram import KNOWN, MASS, OWN, SECOND, compiled_solve
from ..regression.layout import Layout


class ChainFit:
    """Masses and coefficients of one set of columns from Gram matrices, and the rows of residuals.

    ``where`` are the rows of the Gram matrices that hold the terms of each site; ``at`` is that of a_1, a_2.., F_1..
    follow.
    """

    def __init__(
        self, layout: Layout, order: SolveOrder, known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]], at: int, forced: Sequence[int],
    ) -> None:  # fmt: skip
        self.layout, self.order, self.known_masses, self.where, self.at = layout, order, dict(known_masses), where, at
        n = self.n = layout.n_dof
        self.groups = groups_of(layout, order)
        index = {g.dofs: u for u, g in enumerate(self.groups)}
        self._known = np.array([self.known_masses.get(j, 0.0) for j in range(1, n + 1)])
        entries: list[tuple[int, int, int, int]] = []
        steps: list[tuple[int, ...]] = []
        dofs: list[int] = []
        for step in order.steps:
            signs = {s: sum(s.incidence(j) for j in step.dofs) for s in (*step.sites, *step.known_sites)}
            begin, first = len(entries), len(dofs)
            entries += [(at + j - 1, 1, MASS, j - 1) for j in step.masses]
            for s in step.sites:  # a second estimate (complete strategy) is solved for and left aside
                role = SECOND if order.strategy == "complete" and s.p not in step.dofs else OWN
                entries += [(int(c), signs[s], role, 0) for c in where[s]]
            entries += [(int(c), signs[s], KNOWN, 0) for s in step.known_sites for c in where[s]]
            dofs += [j - 1 for j in step.dofs]
            steps.append((index[step.dofs], begin, len(entries), first, len(dofs), int(bool(step.masses))))
        self._plan = (
            np.array(steps, dtype=np.int64).reshape(-1, 6),
            np.array(entries, dtype=np.int64).reshape(-1, 4),
            np.array(dofs, dtype=np.int64),
        )
        # Balance j is judged by itself, or with all above it where they are solved together.
        above = [tuple(range(j, n + 1)) for j in range(1, n + 1)]
        self.judged = [index[a] if a in index else index[j + 1,] for j, a in enumerate(above)]
        self._signs: np.ndarray | None = None
        self._given = {
            step.dofs: [(list(where[s]), sum(s.incidence(j) for j in step.dofs)) for s in step.known_sites]
            for step in order.steps
        }
        self.forced = frozenset(forced)

    def solve(self, fit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, p) from Gram matrices (n_fits, n_groups, p, p)."""
        masses = np.tile(self._known, (len(fit), 1))
        theta = np.zeros((len(fit), fit.shape[2]))
        compiled_solve()(np.ascontiguousarray(fit), self.n, self.at, *self._plan, masses, theta)
        return masses, theta

    def rows(self, masses: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of columns that are the residual and the reference of each judged balance, (n_fits, n, p)."""
        n, at, p = self.n, self.at, theta.shape[1]
        if self._signs is None:
            self._signs = np.zeros((n, p))
            for i, u in enumerate(self.judged):
                for site, sign in zip(self.groups[u].sites, self.groups[u].signs):
                    self._signs[i, list(self.where[site])] = sign
        residual = self._signs * theta[:, None]
        reference = np.zeros_like(residual)
        for i, u in enumerate(self.judged):
            dofs = self.groups[u].dofs
            inertia = at + np.array(dofs) - 1
            residual[:, i, inertia] = masses[:, np.array(dofs) - 1]
            residual[:, i, inertia + n] = -1.0
            if len(dofs) > 1:
                reference[:, i, inertia], reference[:, i, inertia + n] = masses[:, np.array(dofs) - 1], -1.0
            elif dofs[0] in self.forced:
                reference[:, i, inertia + n] = 1.0
            else:  # what was known before: the inertia, or the storey above; a free mass may vanish
                reference[:, i, inertia] = masses[:, np.array(dofs) - 1] * (dofs[0] in self.known_masses)
                for where, sign in self._given.get(dofs, ()):
                    reference[:, i, where] = sign * theta[:, where]
        return residual, reference
