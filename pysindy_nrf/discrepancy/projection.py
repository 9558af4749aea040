"""The chain solve on many Gram matrices at once: what ranks the candidates.

The equations are those of :mod:`pysindy_nrf.regression.chain_solve` with plain least squares, compiled, so that
every law, site, shape and fold costs microseconds. Only ranks and fold errors come from here; what
is reported is solved by ``chain_solve.solve`` itself, with which this agrees to round-off (tested).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from ..exceptions import NRFError, RankWarning
from ..mechanics.identifiability import SolveOrder
from ..mechanics.sites import Site
from ..regression.chain_solve import groups_of, solve
from ..regression.errors import pooled_error
from ..regression.grams import BlockGrams
from ..regression.layout import Layout


def _least_squares(
    gram: np.ndarray, columns: np.ndarray, target: np.ndarray, values: np.ndarray, work: np.ndarray
) -> bool:
    """Solve for columns scaled to unit length; False where they depend on each other."""
    width = len(columns)
    for i in range(width):
        size = gram[columns[i], columns[i]]
        if not (size > 0.0 and size < np.inf):
            return False
        work[i, width] = 1.0 / np.sqrt(size)
    for i in range(width):
        dot = 0.0
        for j in range(len(target)):
            if target[j] != 0.0:
                dot += gram[columns[i], j] * target[j]
        values[i] = dot * work[i, width]
        for j in range(i + 1):
            part = gram[columns[i], columns[j]] * work[i, width] * work[j, width]
            for k in range(j):
                part -= work[i, k] * work[j, k]
            if i != j:
                work[i, j] = part / work[j, j]
            elif part > 9e-16 * (width + 1):
                work[i, i] = np.sqrt(part)
            else:
                return False
        for k in range(i):
            values[i] -= work[i, k] * values[k]
        values[i] /= work[i, i]
    for i in range(width - 1, -1, -1):
        for k in range(i + 1, width):
            values[i] -= work[k, i] * values[k]
        values[i] /= work[i, i]
    for i in range(width):
        values[i] *= work[i, width]
    return True


def _square(gram: np.ndarray, weights: np.ndarray) -> float:
    """Sum of squares of a combination of columns."""
    total = 0.0
    for i in range(len(weights)):
        if weights[i] != 0.0:
            for j in range(len(weights)):
                if weights[j] != 0.0:
                    total += weights[i] * gram[i, j] * weights[j]
    return max(total, 0.0)


@cache
def _compiled() -> Callable[..., None]:
    from ..laws.compiled import jit, part

    least_squares, square = part(_least_squares), part(_square)

    def project(
        fit: np.ndarray, judge: np.ndarray, sizes: np.ndarray, n: int, at: int, steps: np.ndarray, entries: np.ndarray,
        groups: np.ndarray, members: np.ndarray, dofs: np.ndarray, known: np.ndarray, masses: np.ndarray,
        theta: np.ndarray, errors: np.ndarray, parts: np.ndarray,
    ) -> None:  # fmt: skip
        """For each Gram matrix: masses and coefficients from ``fit``, errors on ``judge``."""
        p = fit.shape[2]
        target, weights = np.empty(p), np.empty((4, p))
        values, work = np.empty(p), np.empty((p, p + 1))
        columns = np.empty(p, dtype=np.int64)
        for b in range(fit.shape[0]):
            masses[b] = known
            theta[b] = 0.0
            errors[b] = np.inf
            good = True
            for i in range(len(steps)):
                target[:] = 0.0
                u, e0, e1, d0, d1, free = steps[i]
                for d in range(d0, d1):
                    j = dofs[d]
                    target[at + n + j] += 1.0
                    if not free:
                        target[at + j] -= masses[b, j]
                width = 0
                for e in range(e0, e1):
                    where, sign, role, j = entries[e]
                    if role == 1:
                        target[where] -= sign * theta[b, where]
                    else:
                        columns[width] = where
                        width += 1
                good = least_squares(fit[b, u], columns[:width], target, values, work)
                if not good:
                    break
                width = 0
                for e in range(e0, e1):
                    where, sign, role, j = entries[e]
                    if role == 0:
                        theta[b, where] = sign * values[width]
                    elif role == 2:
                        masses[b, j] = values[width]
                    if role != 1:
                        width += 1
            if not good:
                continue
            top = bottom = 0.0
            for i in range(len(groups)):
                u, m0, m1, d0, d1, single = groups[i]
                count = sizes[b, u]
                if count == 0.0:
                    continue
                weights[:] = 0.0
                for e in range(m0, m1):
                    where, sign, own, j = members[e]
                    weights[0, where] = sign * theta[b, where]
                    if own:
                        weights[3, where] = theta[b, where]
                for d in range(d0, d1):
                    j = dofs[d]
                    weights[0, at + n + j] -= 1.0
                    weights[1, at + n + j] += 1.0
                    weights[0, at + j] += masses[b, j]
                    if single:
                        weights[2, at + j] = masses[b, j]
                    else:
                        weights[1, at + j] -= masses[b, j]
                residual, reference = square(judge[b, u], weights[0]), square(judge[b, u], weights[1])
                if reference == 0.0:
                    reference = square(judge[b, u], weights[2])
                storey = square(judge[b, u], weights[3])
                if storey == 0.0:
                    storey = reference if reference > 0.0 else count
                top += count * residual / storey
                bottom += count * reference / storey
                parts[b, i, 0] = residual
                parts[b, i, 1] = reference
            errors[b] = 100.0 * np.sqrt(top / bottom) if bottom > 0.0 else (0.0 if top == 0.0 else np.inf)

    return jit(project)


class Projection:
    """Masses, coefficients and errors of one set of columns, from Gram matrices.

    Parameters
    ----------
    layout : Layout
    solve_order : SolveOrder
    known_masses : mapping of int to float
    where : mapping of Site to ndarray of int
        Rows of the Gram matrix that hold the terms of each site, in the order of the layout.
    at : int
        Row of a_1; a_2.., F_1.. follow.
    uses : mapping of tuple of int to int
        For the DOFs of each group, which of the stacked Gram matrices holds the samples in which all their
        forces are known.
    """

    def __init__(
        self,
        layout: Layout,
        solve_order: SolveOrder,
        known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]],
        at: int,
        uses: Mapping[tuple[int, ...], int],
    ) -> None:
        self.layout, self.solve_order, self.at = layout, solve_order, at
        self.known_masses, self.where, self._uses = dict(known_masses), where, uses
        self.groups = groups_of(layout, solve_order)
        n = self.n_dof = layout.n_dof
        self._known = np.array([self.known_masses.get(j, 0.0) for j in range(1, n + 1)])
        entries: list[tuple[int, int, int, int]] = []
        steps: list[tuple[int, ...]] = []
        dofs: list[int] = []
        done: set[Site] = set()
        for step in solve_order.steps if solve_order.strategy != "joint" else ():
            signs = {s: sum(s.incidence(j) for j in step.dofs) for s in (*step.sites, *step.known_sites)}
            begin, first = len(entries), len(dofs)
            entries += [(at + j - 1, 1, 2, j - 1) for j in step.masses]
            for s in step.sites:  # a second estimate (complete strategy) is solved for and left aside
                role = 3 if solve_order.strategy == "complete" and s.p not in step.dofs else 0
                entries += [(int(c), signs[s], role, 0) for c in where[s]]
            entries += [(int(c), signs[s], 1, 0) for s in step.known_sites for c in where[s]]
            dofs += [j - 1 for j in step.dofs]
            done.update(step.sites)
            steps.append((uses[step.dofs], begin, len(entries), first, len(dofs), int(bool(step.masses))))
        members: list[tuple[int, int, int, int]] = []
        groups: list[tuple[int, ...]] = []
        have = {g.dofs for g in self.groups}
        for j in range(1, n + 1):
            above = tuple(range(j, n + 1))
            group = next(g for g in self.groups if g.dofs == (above if above in have else (j,)))
            begin, first = len(members), len(dofs)
            own = next((s for s in group.sites if s.p == j), None)
            for s, sign in zip(group.sites, group.signs):
                members += [(int(c), sign, int(s == own), 0) for c in where[s]]
            dofs += [k - 1 for k in group.dofs]
            groups.append((uses[group.dofs], begin, len(members), first, len(dofs), int(len(group.dofs) == 1)))
        self._judged = groups
        self._plan = tuple(
            np.array(rows, dtype=np.int64).reshape(-1, width)
            for rows, width in ((steps, 6), (entries, 4), (groups, 6), (members, 4))
        ) + (np.array(dofs, dtype=np.int64),)

    def __call__(
        self, fit: np.ndarray, judge: np.ndarray | None = None, sizes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit and judge."""
        judge = fit if judge is None else judge
        b, _, p, _ = fit.shape
        if sizes is None:
            sizes = np.ones(fit.shape[:2])
        sizes = np.ascontiguousarray(sizes, dtype=float)
        errors, theta, masses = np.empty(b), np.zeros((b, p)), np.empty((b, self.n_dof))
        parts = np.zeros((b, self.n_dof, 2))
        if self.solve_order.strategy == "joint":
            self._joint(fit, judge, sizes, theta, errors)
            return errors, theta, parts
        steps, entries, groups, members, dofs = self._plan
        fit, judge = np.ascontiguousarray(fit), np.ascontiguousarray(judge)
        _compiled()(
            fit, judge, sizes, self.n_dof, self.at, steps, entries, groups, members, dofs,
            self._known, masses, theta, errors, parts,
        )  # fmt: skip
        return errors, theta, parts

    def _joint(
        self, fit: np.ndarray, judge: np.ndarray, sizes: np.ndarray, theta: np.ndarray, errors: np.ndarray
    ) -> None:
        """One after another by the chain solve itself."""
        rows = [c for s in self.layout.sites for c in self.where.get(s, ())]
        rows += range(self.at, self.at + 2 * self.n_dof)
        for b in range(len(fit)):
            def of(grams: np.ndarray, b: int = b) -> BlockGrams:
                def gram(dofs: tuple[int, ...]) -> tuple[np.ndarray, float]:
                    u = self._uses[dofs]
                    return grams[b, u][np.ix_(rows, rows)], sizes[b, u]

                return BlockGrams.from_shared(self.layout, self.groups, gram, self.known_masses)

            errors[b] = np.inf
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error", RankWarning)
                    found = solve(of(fit), self.solve_order, self.known_masses)
            except (NRFError, RankWarning):
                continue
            for s, values in found.coefficients.items():
                theta[b, list(self.where[s])] = values
            errors[b] = pooled_error(found.masses, found.coefficients, of(judge))
