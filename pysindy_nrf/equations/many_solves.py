"""The compiled solve: many sums of products at once, which ranks candidates.

It solves the equations of :mod:`pysindy_nrf.equations.chain_solve` by plain least
squares, so that every law, site, shape and fold costs microseconds. The model that is
reported is solved by ``chain_solve.solve`` itself, with which this agrees to round-off
(tested).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..chain.identifiability import SolveOrder
from ..chain.layout import Group, Layout
from ..chain.sites import Site
from .compiled_solve import KNOWN, MASS, UNKNOWN, compiled_solve
from .normal_equations import groups_of

# Ridge of scaled products: above round-off, far below what any channel determines.
RIDGE = 1e-12


class CompiledChainSolve:
    """Masses and coefficients of one set of columns, from many sums of products.

    Parameters
    ----------
    layout : Layout
    order : SolveOrder
        Every equation by itself, complete or sequential.
    known_masses : mapping of int to float
        kg.
    where : mapping of Site to sequence of int
        Rows of the products that hold the terms of each site.
    first_mass : int
        Row of a_1; those of a_2.. and F_1.. follow.
    forced : sequence of int
        DOFs on which a force acts.

    Attributes
    ----------
    groups : list of Group
        Equations, and sums of equations, of which products are needed.
    own : list of list of int
        By group the rows that stand in it.
    judged : list of int
        By equation the group that is judged: itself, or with all above it where they
        are solved together.
    """

    def __init__(
        self,
        layout: Layout,
        order: SolveOrder,
        known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]],
        first_mass: int,
        forced: Sequence[int],
    ) -> None:
        self.layout = layout
        self.order = order
        self.known_masses = dict(known_masses)
        self.where = where
        self.first_mass = first_mass
        self.forced = forced
        self.n = layout.n_dof

        self.groups = groups_of(layout, order)
        number = {group.dofs: k for k, group in enumerate(self.groups)}
        self.judged = []
        for dof in range(1, self.n + 1):
            above = tuple(range(dof, self.n + 1))
            self.judged.append(number[above] if above in number else number[(dof,)])

        self.rows_of_group = [self._rows_in(group) for group in self.groups]
        self._tables = self._solve_tables(number)
        self._preset = _mass_line(self.known_masses, self.n)
        self._combinations = self._combination_table()

    def _rows_in(self, group: Group) -> list[int]:
        """Rows that stand in an equation."""
        rows = [self.first_mass + dof - 1 for dof in group.dofs]
        rows.extend(self.first_mass + self.n + dof - 1 for dof in group.dofs)
        for site in group.sites:
            rows.extend(map(int, self.where[site]))
        return rows

    def _solve_tables(self, number: Mapping[tuple[int, ...], int]) -> _SolveTables:
        """The steps of the order in numbers, as the compiled solve reads them."""
        steps: list[tuple[int, ...]] = []
        entries: list[tuple[int, int, int, int]] = []
        dofs: list[int] = []
        for step in self.order.steps:
            first_entry, first_dof = len(entries), len(dofs)
            for dof in step.masses:
                entries.append((self.first_mass + dof - 1, 1, MASS, dof - 1))
            for role, sites in ((UNKNOWN, step.sites), (KNOWN, step.known_sites)):
                for row, sign in self._signed_terms(sites, step.dofs):
                    entries.append((row, sign, role, 0))
            dofs.extend(dof - 1 for dof in step.dofs)
            free_mass = int(bool(step.masses))
            spans = (first_entry, len(entries), first_dof, len(dofs))
            steps.append((number[step.dofs], *spans, free_mass))
        return _SolveTables(
            np.array(steps, dtype=np.int64).reshape(-1, 6),
            np.array(entries, dtype=np.int64).reshape(-1, 4),
            np.array(dofs, dtype=np.int64),
        )

    def _signed_terms(
        self, sites: Sequence[Site], dofs: Sequence[int]
    ) -> list[tuple[int, int]]:
        """Rows of the terms at some sites, with their signs in a sum of equations."""
        terms = []
        for site in sites:
            sign = sum(map(site.incidence, dofs))
            for row in self.where[site]:
                terms.append((int(row), sign))
        return terms

    def _combination_table(self) -> np.ndarray:
        """How residuals and references follow from masses and coefficients.

        Columns are the equation (references n further), the row of the products, the
        place among ``[masses | 1 | coefficients]``, and the factor.
        """
        known_terms = {}
        for step in self.order.steps:
            known_terms[step.dofs] = self._signed_terms(step.known_sites, step.dofs)

        table: list[tuple[int, int, int, int]] = []
        for equation, number in enumerate(self.judged):
            group = self.groups[number]
            terms = self._signed_terms(group.sites, group.dofs)
            residual = self._term_entries(terms)
            residual.extend(self._inertia_entries(group.dofs))
            residual.extend(self._force_entries(group.dofs, -1))
            known = known_terms.get(group.dofs, [])
            reference = self._reference_entries(group.dofs, known)

            table.extend((equation, *entry) for entry in residual)
            table.extend((self.n + equation, *entry) for entry in reference)
        return np.array(table, dtype=np.int64).T

    def _reference_entries(
        self, dofs: tuple[int, ...], known_terms: list[tuple[int, int]]
    ) -> list[tuple[int, int, int]]:
        """What an equation was known by: its force, its inertia, or the storey above.

        A free mass is no reference: it may vanish.
        """
        summed = len(dofs) > 1
        is_forced = dofs[0] in self.forced
        if summed:
            return self._inertia_entries(dofs) + self._force_entries(dofs, -1)
        if is_forced:
            return self._force_entries(dofs, 1)

        entries = self._term_entries(known_terms)
        if dofs[0] in self.known_masses:
            entries.extend(self._inertia_entries(dofs))
        return entries

    def _term_entries(self, terms: list[tuple[int, int]]) -> list[tuple[int, int, int]]:
        return [(row, self.n + 1 + row, sign) for row, sign in terms]

    def _inertia_entries(self, dofs: Sequence[int]) -> list[tuple[int, int, int]]:
        return [(self.first_mass + dof - 1, dof - 1, 1) for dof in dofs]

    def _force_entries(
        self, dofs: Sequence[int], sign: int
    ) -> list[tuple[int, int, int]]:
        first = self.first_mass + self.n
        return [(first + dof - 1, self.n, sign) for dof in dofs]

    def beside(self, rows: Sequence[int]) -> list[int]:
        """Rows that stand in an equation together with some of these."""
        return _beside(rows, self.rows_of_group)

    def solve(
        self, fit: np.ndarray, strict: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, p).

        ``fit`` are sums of products (n_fits, n_groups, p, p). Where columns depend on
        each other coefficients are NaN if ``strict``; else one of them is zero.
        """
        masses = np.tile(self._preset, (len(fit), 1))
        theta = np.zeros((len(fit), fit.shape[2]))
        sums = np.ascontiguousarray(fit)
        compiled_solve()(
            sums, strict, self.n, self.first_mass, *self._tables, masses, theta
        )
        return masses, theta

    def rows(
        self, masses: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of rows that are residual and reference of each equation.

        Both are (n_fits, n_dof, p).
        """
        row, column, place, factor = self._combinations
        ones = np.ones((len(masses), 1))
        values = np.concatenate([masses, ones, theta], axis=1)
        out = np.zeros((len(masses), 2 * self.n, theta.shape[1]))
        out[:, row, column] = factor * values[:, place]
        return out[:, : self.n], out[:, self.n :]


class _SolveTables(NamedTuple):
    """A solve order in numbers.

    ``steps`` are group, entries from and to, DOFs from and to, whether the mass is
    free; ``entries`` are row, sign, role and DOF of a column; ``dofs`` count from 0.
    """

    steps: np.ndarray
    entries: np.ndarray
    dofs: np.ndarray


def _beside(rows: Sequence[int], groups: Sequence[Sequence[int]]) -> list[int]:
    """Rows of the groups in which some rows stand."""
    wanted = set(rows)
    beside: set[int] = set()
    for members in groups:
        if not wanted.isdisjoint(members):
            beside.update(members)
    return sorted(beside)


def _mass_line(known_masses: Mapping[int, float], n_dof: int) -> np.ndarray:
    """Known masses by DOF, zero where they are not known."""
    return np.array([known_masses.get(dof, 0.0) for dof in range(1, n_dof + 1)])


class ChannelSolve:
    """Masses and coefficients from measured channels, where floors have no sensor.

    All columns stand in one sum of products, whatever equations their forces enter.

    Parameters
    ----------
    layout : Layout
    known_masses : mapping of int to float
        kg.
    where : mapping of Site to sequence of int
        Rows of the products that hold the terms of each site.
    first_mass : int
        Row of what the inertia of DOF 1 does to the channels; those of the other DOFs,
        of the forces, and the channels themselves follow.
    """

    def __init__(
        self,
        layout: Layout,
        known_masses: Mapping[int, float],
        where: Mapping[Site, Sequence[int]],
        first_mass: int,
    ) -> None:
        self.n = layout.n_dof
        self.first_mass = first_mass
        self.groups = [Group((1,), (), ())]
        self.judged = [0]
        self._preset = _mass_line(known_masses, self.n)
        self._free = [j for j in range(self.n) if j + 1 not in known_masses]
        self._terms: list[int] = []
        for site in layout.sites:
            self._terms.extend(map(int, where[site]))
        self.rows_of_group = [
            [*range(first_mass, first_mass + self.n + 2), *self._terms]
        ]

    def beside(self, rows: Sequence[int]) -> list[int]:
        """Rows that stand in an equation together with some of these: all of them."""
        return _beside(rows, self.rows_of_group)

    def solve(
        self, fit: np.ndarray, strict: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n_fits, n_dof) and coefficients (n_fits, p).

        ``fit`` are sums of products (n_fits, 1, p, p).
        """
        grams = fit[:, 0]
        inertia = slice(self.first_mass, self.first_mass + self.n)
        columns = self._terms + [self.first_mass + j for j in self._free]
        size = np.sqrt(np.einsum("kii->ki", grams)[:, columns])
        size[size == 0] = 1.0

        known = grams[:, columns, inertia] @ self._preset
        vector = (grams[:, columns, self.first_mass + self.n] - known) / size
        matrix = grams[:, columns][:, :, columns] / size[:, :, None] / size[:, None]
        matrix = matrix + RIDGE * np.eye(len(columns))
        values = np.linalg.solve(matrix, vector[:, :, None])[:, :, 0] / size

        masses = np.tile(self._preset, (len(fit), 1))
        theta = np.zeros((len(fit), fit.shape[2]))
        theta[:, self._terms] = values[:, : len(self._terms)]
        masses[:, self._free] = values[:, len(self._terms) :]
        return masses, theta

    def rows(
        self, masses: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Combinations of rows that are the residual and the measured channels.

        Both are (n_fits, 1, p).
        """
        forces = self.first_mass + self.n
        residual = theta[:, None].copy()
        residual[:, 0, self.first_mass : forces] = masses
        residual[:, 0, forces] = -1.0
        reference = np.zeros_like(residual)
        reference[:, 0, forces + 1] = 1.0
        return residual, reference
