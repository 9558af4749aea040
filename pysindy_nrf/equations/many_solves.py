"""The chain solve on many Gram matrices at once: what ranks the candidates.

The equations are those of :mod:`pysindy_nrf.equations.chain_solve` with plain least
squares, compiled, so that every law, site, shape and fold costs microseconds. The model
that is reported is solved by ``chain_solve.solve`` itself, with which this agrees to
round-off (tested).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ..chain.identifiability import SolveOrder, Step
from ..chain.layout import Layout
from ..chain.sites import Site
from .chain_solve import groups_of
from .compiled_sums import KNOWN, MASS, OWN, compiled_solve

RIDGE = (
    1e-12  # of scaled Gram matrices: above round-off, far below what any channel tells
)


class ChainFit:
    """Masses and coefficients of one set of columns from Gram matrices, and the rows of
    residuals.

    ``where`` are the rows of the Gram matrices that hold the terms of each site; ``at``
    is that of a_1; F_1.. follow.
    """

    def __init__(
        self,
        layout: Layout,
        order: SolveOrder,
        known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]],
        at: int,
        forced: Sequence[int],
    ) -> None:
        self.layout, self.order, self.known_masses, self.where, self.at = (
            layout,
            order,
            dict(known_masses),
            where,
            at,
        )
        n = self.n = layout.n_dof
        self.groups = groups_of(layout, order)
        # Rows that stand in each group of balances.
        self.own = [
            [
                *(at + k + j - 1 for k in (0, n) for j in g.dofs),
                *(int(c) for s in g.sites for c in where[s]),
            ]
            for g in self.groups
        ]
        index = {g.dofs: u for u, g in enumerate(self.groups)}
        self._known = np.array([self.known_masses.get(j, 0.0) for j in range(1, n + 1)])
        entries: list[tuple[int, int, int, int]] = []
        steps: list[tuple[int, ...]] = []
        dofs: list[int] = []
        for step in order.steps:
            signs = {
                s: sum(s.incidence(j) for j in step.dofs)
                for s in (*step.sites, *step.known_sites)
            }
            begin, first = len(entries), len(dofs)
            entries += [(at + j - 1, 1, MASS, j - 1) for j in step.masses]
            entries += [
                (int(c), signs[s], OWN, 0) for s in step.sites for c in where[s]
            ]
            entries += [
                (int(c), signs[s], KNOWN, 0) for s in step.known_sites for c in where[s]
            ]
            dofs += [j - 1 for j in step.dofs]
            steps.append(
                (
                    index[step.dofs],
                    begin,
                    len(entries),
                    first,
                    len(dofs),
                    int(bool(step.masses)),
                )
            )
        self._plan = (
            np.array(steps, dtype=np.int64).reshape(-1, 6),
            np.array(entries, dtype=np.int64).reshape(-1, 4),
            np.array(dofs, dtype=np.int64),
        )
        # Balance j is judged by itself, or with all above it where they are solved
        # together.
        above = [tuple(range(j, n + 1)) for j in range(1, n + 1)]
        self.judged = [
            index[a] if a in index else index[j + 1,] for j, a in enumerate(above)
        ]
        given = {
            step.dofs: [
                (int(c), sum(s.incidence(j) for j in step.dofs))
                for s in step.known_sites
                for c in where[s]
            ]
            for step in order.steps
        }
        # What rows of residuals and, n below, references hold: row, column, place in
        # masses and coefficients, factor.
        held: list[tuple[int, int, int, int]] = []
        for i, group in enumerate(self.groups[u] for u in self.judged):
            seen, below = group.dofs, n + i
            held += [
                (i, int(c), n + 1 + int(c), sign)
                for s, sign in zip(group.sites, group.signs)
                for c in where[s]
            ]
            held += [
                entry
                for j in seen
                for entry in ((i, at + j - 1, j - 1, 1), (i, at + n + j - 1, n, -1))
            ]
            if len(seen) > 1 or (
                seen[0] not in forced and seen[0] in self.known_masses
            ):
                held += [(below, at + j - 1, j - 1, 1) for j in seen]
            if len(seen) > 1 or seen[0] in forced:
                held += [
                    (below, at + n + j - 1, n, -1 if len(seen) > 1 else 1) for j in seen
                ]
            # what was known before: the inertia, or the storey above; a free mass may
            # vanish
            else:
                held += [(below, c, n + 1 + c, sign) for c, sign in given.get(seen, [])]
        self._held = np.array(held, dtype=int).T

    def beside(self, rows: Sequence[int]) -> list[int]:
        """The rows that stand in a balance with some of these."""
        return sorted(
            set().union(*(own for own in self.own if not set(own).isdisjoint(rows)))
        )

    def solve(
        self, fit: np.ndarray, strict: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, p) from Gram matrices
        (n_fits, n_groups, p, p).
        """
        masses = np.tile(self._known, (len(fit), 1))
        theta = np.zeros((len(fit), fit.shape[2]))
        compiled_solve()(
            np.ascontiguousarray(fit),
            strict,
            self.n,
            self.at,
            *self._plan,
            masses,
            theta,
        )
        return masses, theta

    def rows(
        self, masses: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of columns that are the residual and the reference of each
        judged balance, (n_fits, n, p).
        """
        row, column, place, factor = self._held
        values = np.concatenate([masses, np.ones((len(masses), 1)), theta], axis=1)
        out = np.zeros((len(masses), 2 * self.n, theta.shape[1]))
        out[:, row, column] = factor * values[:, place]
        return out[:, : self.n], out[:, self.n :]


class ChannelFit(ChainFit):
    """Masses and coefficients from measured channels: one sum of all columns, whatever
    balances they stand in.
    """

    def __init__(
        self,
        layout: Layout,
        known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]],
        at: int,
    ) -> None:
        n = self.n = layout.n_dof
        self.groups, self.judged, self.at = [Step((1,), (), ())], [0], at  # type: ignore[list-item]
        self._known = np.array([known_masses.get(j, 0.0) for j in range(1, n + 1)])
        self._terms = [int(c) for s in layout.sites for c in where[s]]
        self._free = [j for j in range(n) if j + 1 not in known_masses]
        self.own = [[*range(at, at + n + 2), *self._terms]]

    def solve(
        self, fit: np.ndarray, strict: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, p) from Gram matrices
        (n_fits, 1, p, p).
        """
        grams, at, n = fit[:, 0], self.at, self.n
        columns = self._terms + [at + j for j in self._free]
        size = np.sqrt(np.einsum("kii->ki", grams)[:, columns])
        size[size == 0] = 1.0
        right = (
            grams[:, columns, at + n] - grams[:, columns, at : at + n] @ self._known
        ) / size
        left = grams[:, columns][:, :, columns] / size[:, :, None] / size[
            :, None
        ] + RIDGE * np.eye(len(columns))
        found = np.linalg.solve(left, right[:, :, None])[:, :, 0] / size
        masses, theta = (
            np.tile(self._known, (len(fit), 1)),
            np.zeros((len(fit), fit.shape[2])),
        )
        theta[:, self._terms], masses[:, self._free] = np.split(
            found, [len(self._terms)], axis=1
        )
        return masses, theta

    def rows(
        self, masses: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of columns that are the residual and the measured channels,
        (n_fits, 1, p).
        """
        at, end = self.at, self.at + self.n
        residual, reference = (
            theta[:, None].copy(),
            np.zeros((len(theta), 1, theta.shape[1])),
        )
        residual[:, 0, at:end], residual[:, 0, end], reference[:, 0, end + 1] = (
            masses,
            -1.0,
            1.0,
        )
        return residual, reference
