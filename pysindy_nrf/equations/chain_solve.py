"""The general solve of a chain: masses and coefficients from normal equations.

Complete (paper eq. 3), sequential (eqs. 4-5) or joint, with or without an optimizer of
PySINDy on every equation. What a search ranks by the thousand is solved by
:mod:`pysindy_nrf.equations.many_solves`, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..chain.identifiability import SolveOrder, Step
from ..chain.layout import Block, Layout
from ..chain.sites import Site
from ..common.warn import warn_user
from ..exceptions import IdentifiabilityError, RankWarning
from .accumulation import total_products
from .equation_rows import EquationRows
from .inner_optimizer import Optimizer
from .least_squares import NotTogether, SubProblem, back_substituted
from .measured_motion import (
    clock_of,
    require_clock,
    require_moving,
    require_samples,
    scales_of,
    unknown_forces,
    visited_regions,
)
from .normal_equations import NormalEquations, PerBlock, groups_of
from .solution import Solution, StepFit, doubtful_masses, model_of, third_law_gap
from .triangular import root_of, upper_of

__all__ = [
    "NotTogether",
    "Solution",
    "StepFit",
    "clock_of",
    "doubtful_masses",
    "groups_of",
    "model_of",
    "require_clock",
    "require_moving",
    "require_samples",
    "scales_of",
    "solve",
    "solve_blocks",
    "solved_safely",
    "third_law_gap",
    "unknown_forces",
    "visited_regions",
]

# Residual of an equation, as a share of its force, below which a joint solve takes it
# for as good as any: forces and motions are not calibrated better than to a thousandth.
BEST_SHARE = 1e-3

Key = int | Site  # DOF of a mass, or site of laws


def solve_blocks(
    layout: Layout,
    solve_order: SolveOrder,
    blocks: Callable[[], Iterable[Block]],
    known_masses: Mapping[int, float] | None = None,
    inner: Optimizer | None = None,
) -> tuple[Solution, NormalEquations]:
    """Sum up the samples and solve.

    Where squaring loses digits the samples are summed up once more by QR: ``blocks``
    is called again. So it is for an optimizer that needs the samples themselves.
    """
    groups = groups_of(layout, solve_order)
    known = dict(known_masses or {})
    rows = EquationRows(layout, blocks, known)
    grams = total_products(layout, groups, blocks(), known)
    solution = solved_safely(grams, solve_order, known, inner, rows)
    if solution is None:
        grams = total_products(layout, groups, blocks(), known, "root")
        solution = solve(grams, solve_order, known, inner, rows)
    return solution, grams


def solved_safely(
    grams: NormalEquations,
    order: SolveOrder,
    known: Mapping[int, float],
    inner: Optimizer | None,
    rows: EquationRows | None = None,
) -> Solution | None:
    """The solution, or None where squaring may have lost digits that the data have."""
    try:
        solution = _solved(grams, order, known, inner, rows)
    except IdentifiabilityError:
        return None
    if solution.dependent or solution.digits_at_risk():
        return None
    return solution


def solve(
    grams: NormalEquations,
    solve_order: SolveOrder,
    known_masses: Mapping[int, float] | None = None,
    inner: Optimizer | None = None,
    rows: EquationRows | None = None,
) -> Solution:
    """Find masses and coefficients from the normal equations of a chain.

    Parameters
    ----------
    grams : NormalEquations
        A sum of blocks; or several blocks, which are solved together.
    solve_order : SolveOrder
    known_masses : mapping of int to float, optional
        kg.
    inner : PySINDy optimizer, optional
        Runs on every equation; plain least squares if None.
    rows : EquationRows, optional
        The samples behind the sums, for an optimizer that needs them.

    Returns
    -------
    Solution

    Raises
    ------
    IdentifiabilityError
        If a mass depends on other columns, a column is zero, or nothing scales an
        equation.
    NotTogether
        If several blocks have to be solved one by one.
    """
    solution = _solved(grams, solve_order, dict(known_masses or {}), inner, rows)
    for text in solution.dependent:
        warn_user(text, RankWarning)
    return solution


def _solved(
    grams: NormalEquations,
    order: SolveOrder,
    known_masses: Mapping[int, float],
    inner: Optimizer | None,
    rows: EquationRows | None,
) -> Solution:
    """The solution without a warning of columns that depend on each other."""
    masses: dict[int, PerBlock] = {}
    for dof, mass in known_masses.items():
        masses[int(dof)] = float(mass)
    if order.strategy == "joint":
        return _JointSolve(grams, order, masses, inner, rows).solution()
    one_by_one = _EachByItself(grams, order, masses, inner, rows)
    if order.apart:
        return _from_above_or_apart(one_by_one)
    return one_by_one.solution()


@dataclass
class _EachByItself:
    """The steps of an order, one after the other."""

    grams: NormalEquations
    order: SolveOrder
    masses: dict[int, PerBlock]
    inner: Optimizer | None = None
    rows: EquationRows | None = None
    coefficients: dict[Site, np.ndarray] = field(default_factory=dict)
    twins: dict[Site, np.ndarray] = field(default_factory=dict)

    def solution(self, triangles: Sequence[np.ndarray] = ()) -> Solution:
        """Solve the steps; each may use what those before it found.

        ``triangles`` are their triangular factors, if they are known.
        """
        fits = []
        used = list(triangles)
        for i, step in enumerate(self.order.steps):
            if not triangles:
                used.append(self.triangle_of(step))
            fits.append(self._solve_step(step, used[i]))

        crossed = []
        for fit, triangle in zip(fits, used):
            share = self._share_with_other_laws(fit.step, triangle)
            crossed.append(fit if share is None else replace(fit, crossed=share))
        return Solution(self.masses, self.coefficients, self.twins, crossed)

    def triangle_of(self, step: Step) -> np.ndarray:
        """Triangular factor of ``[mass | terms | right-hand side]`` of a step."""
        return self.grams.triangle(step.dofs, self.unknowns_of(step))

    def unknowns_of(self, step: Step) -> np.ndarray:
        """Combination of an equation's columns to those of a step.

        What is known of the mass and of laws stands on the right-hand side.
        """
        places = self.grams.positions(step.dofs)
        group = self.grams.groups[step.dofs]
        signs = dict(zip(group.sites, group.signs))
        n_columns = self.grams.matrices[step.dofs].shape[-1]

        target = np.zeros((*self.grams.shape, n_columns))
        target[..., places.target] = 1.0
        for site in step.known_sites:
            columns = places.sites[site]
            target[..., columns] -= signs[site] * self.coefficients[site]
        if places.mass is not None and not step.masses:
            target[..., places.mass] -= self.masses.get(step.dofs[0], 0.0)

        unknown: list[int] = []
        if places.mass is not None and step.masses:
            unknown.append(places.mass)
        for site in step.sites:
            columns = places.sites[site]
            unknown.extend(range(columns.start, columns.stop))
        combine = np.zeros((*target.shape, len(unknown) + 1))
        combine[..., unknown, np.arange(len(unknown))] = 1.0
        combine[..., -1] = target
        return combine

    def _solve_step(self, step: Step, triangle: np.ndarray) -> StepFit:
        """Solve one step and remember what it finds."""
        grams = self.grams
        size = grams.sizes[step.dofs]
        rows = None
        if self.rows is not None:
            group = grams.groups[step.dofs]
            rows = partial(self.rows.combined, group, self.unknowns_of(step))
        problem = SubProblem(step, triangle, size, grams.layout, grams.kind, rows)
        if grams.shape:
            values, fit = problem.solve_blocks(self.inner)
        else:
            values, fit = problem.solve(self.inner)

        start = 0
        if step.masses:
            self.masses[step.masses[0]] = _plain(values[..., 0])
            start = 1
        group = grams.groups[step.dofs]
        signs = dict(zip(group.sites, group.signs))
        for site in step.sites:
            stop = start + grams.layout.counts[site]
            coefficients = signs[site] * values[..., start:stop]
            start = stop
            # an equation at the lower end finds the laws of a site once more
            is_twin = self.order.strategy != "sequential" and site.p not in step.dofs
            store = self.twins if is_twin else self.coefficients
            store[site] = coefficients
        return fit

    def _share_with_other_laws(
        self, step: Step, triangle: np.ndarray
    ) -> PerBlock | None:
        """What an equation leaves with the laws that its neighbours find.

        As a share of its right-hand side; None where its own laws are the only ones.
        """
        found_twice = [
            site
            for site in step.sites
            if site in self.twins and site.p not in step.dofs
        ]
        if not found_twice:
            return None

        shape = self.grams.shape
        parts = [np.reshape(self.masses[dof], (*shape, 1)) for dof in step.masses]
        for site in step.sites:
            parts.append(site.incidence(step.dofs[0]) * self.coefficients[site])
        parts.append(-np.ones((*shape, 1)))
        weights = np.concatenate(parts, axis=-1)
        residual = (triangle @ weights[..., None])[..., 0]
        length = np.linalg.norm(triangle[..., -1], axis=-1)
        return np.linalg.norm(residual, axis=-1) / length


@dataclass
class _JointSolve:
    """All equations at once with shared laws: Newton's third law is built in.

    Each equation is divided by what it leaves by itself.
    """

    grams: NormalEquations
    order: SolveOrder
    masses: dict[int, PerBlock]
    inner: Optimizer | None = None
    rows: EquationRows | None = None

    def solution(self) -> Solution:
        """The joint solution, or that of each equation by itself where it gives way."""
        grams = self.grams
        if grams.shape and self.inner is not None:
            raise NotTogether()

        single = _EachByItself(grams, self.order, dict(self.masses))
        triangles = [single.triangle_of(step) for step in self.order.steps]
        alone = _independent(single, triangles)
        if alone is None:
            return self._jointly(triangles, None)

        gives_way = self.order.yields and alone.contradicts
        if gives_way and grams.shape:
            raise NotTogether()
        return alone if gives_way else self._jointly(triangles, alone)

    def _jointly(
        self, triangles: Sequence[np.ndarray], alone: Solution | None
    ) -> Solution:
        """All equations at once."""
        factor = _JointFactor(self.grams, self.order.steps)
        for i, triangle in enumerate(triangles):
            share = 1.0 if alone is None else alone.fits[i].share
            factor.add(self.order.steps[i], triangle, np.maximum(share, BEST_SHARE))

        # columns that are independent in every equation are so together
        if alone is not None and self.inner is None:
            return self._named(factor, factor.solved(), alone.fits, alone)
        values, fit = self._least_squares(factor)
        return self._named(factor, values, [fit], alone)

    def _least_squares(self, factor: _JointFactor) -> tuple[np.ndarray, StepFit]:
        """All unknowns by one step with masses first, for an optimizer or low rank."""
        layout = self.grams.layout
        free: list[int] = []
        for step in self.order.steps:
            free.extend(step.masses)
        dofs = tuple(range(1, layout.n_dof + 1))
        all_at_once = Step(dofs, tuple(free), layout.acting, (), True)

        keys: list[Key] = [*free, *layout.acting]
        columns = np.concatenate([factor.columns[key] for key in keys])
        last = factor.n_unknowns
        triangle = root_of(factor.upper[:, [*columns, last]])
        samples = sum(self.grams.sizes[step.dofs] for step in self.order.steps)
        rows = None
        if self.rows is not None:
            rows = partial(self._rows_of_all, self.rows, factor, [*columns, last])
        problem = SubProblem(
            all_at_once, triangle, samples, layout, self.grams.kind, rows
        )
        in_order, fit = problem.solve(self.inner)
        values = np.empty(last)
        values[columns] = in_order
        return values, fit

    def _rows_of_all(
        self, equations: EquationRows, factor: _JointFactor, columns: list[int]
    ) -> np.ndarray:
        """Samples of all equations one below the other, scaled as in the factor."""
        single = _EachByItself(self.grams, self.order, dict(self.masses))
        parts = []
        for step in self.order.steps:
            group = self.grams.groups[step.dofs]
            samples = equations.combined(group, single.unknowns_of(step))
            places, signs = factor.columns_of(step)
            rows = np.zeros((len(samples), factor.n_unknowns + 1))
            rows[:, places] = samples * signs * factor.scales[step.dofs]
            parts.append(rows)
        return np.concatenate(parts)[:, columns]

    def _named(
        self,
        factor: _JointFactor,
        values: np.ndarray,
        fits: Sequence[StepFit],
        alone: Solution | None,
    ) -> Solution:
        """Values of all unknowns by DOF and site."""
        masses = dict(self.masses)
        coefficients = {}
        for key, columns in factor.columns.items():
            if isinstance(key, Site):
                coefficients[key] = values[..., columns]
            else:
                masses[key] = _plain(values[..., columns[0]])
        return Solution(masses, coefficients, fits=fits, alone=alone)


def _from_above_or_apart(from_above: _EachByItself) -> Solution:
    """The solution of an order, or that of each equation by itself.

    The latter where two equations contradict each other: the error of one would pass
    on to all below it.
    """
    order = from_above.order
    complete = replace(order, strategy="complete", steps=order.apart, apart=())
    masses = dict(from_above.masses)
    single = _EachByItself(from_above.grams, complete, dict(masses))
    triangles = [single.triangle_of(step) for step in complete.steps]
    alone = _independent(single, triangles)
    if alone is None or not alone.contradicts:
        return replace(from_above.solution(), alone=alone)
    if from_above.grams.shape:
        raise NotTogether()
    return replace(from_above, order=complete, masses=masses).solution()


def _independent(
    single: _EachByItself, triangles: Sequence[np.ndarray]
) -> Solution | None:
    """Each equation by itself, None where its columns depend on each other.

    They may have a solution together.
    """
    try:
        solution = single.solution(triangles)
    except IdentifiabilityError:
        return None
    return None if solution.dependent else solution


class _JointFactor:
    """Triangular factor of all equations, built one after the other.

    An unknown is eliminated after the last equation it stands in, so that only few
    columns are carried on.

    Attributes
    ----------
    columns : dict of int or Site to ndarray
        Columns of each mass and of the terms of each site, in the order in which they
        are eliminated.
    upper : ndarray of shape (..., n_unknowns + 1, n_unknowns + 1)
    scales : dict of tuple of int to ndarray
        By which the rows of each equation added were multiplied.
    """

    def __init__(self, grams: NormalEquations, steps: Sequence[Step]) -> None:
        self.grams = grams
        self.last: dict[Key, int] = {}
        for i, step in enumerate(steps):
            for key in _unknowns(step):
                self.last[key] = i

        self.columns: dict[Key, np.ndarray] = {}
        start = 0
        for key in sorted(self.last, key=self.last.__getitem__):
            width = grams.layout.counts[key] if isinstance(key, Site) else 1
            self.columns[key] = np.arange(start, start + width)
            start += width
        self.n_unknowns = start
        self.scales: dict[tuple[int, ...], np.ndarray] = {}
        self.upper = np.zeros((*grams.shape, start + 1, start + 1))
        # columns and rows that later equations still change
        self._open = np.array([start])
        self._carried = np.zeros((*grams.shape, 0, 1))
        self._n_added = 0
        self._n_done = 0

    def add(self, step: Step, triangle: np.ndarray, share: PerBlock) -> None:
        """Add the triangular factor of an equation that leaves a share by itself."""
        columns_of_step, signs = self.columns_of(step)
        length = np.linalg.norm(triangle[..., -1], axis=-1)
        size = np.sqrt(self.grams.sizes[step.dofs])
        scale = np.asarray(size / length / share)[..., None, None]
        self.scales[step.dofs] = scale

        columns = np.union1d(self._open, columns_of_step)
        n_carried = self._carried.shape[-2]
        n_rows = n_carried + triangle.shape[-2]
        rows = np.zeros((*self.grams.shape, n_rows, len(columns)))
        rows[..., :n_carried, np.searchsorted(columns, self._open)] = self._carried
        places = np.searchsorted(columns, columns_of_step)
        rows[..., n_carried:, places] = triangle * signs * scale
        factor = upper_of(rows)

        n_new = 0
        for key, last in self.last.items():
            if last == self._n_added:
                n_new += len(self.columns[key])
        stop = self._n_done + n_new
        self.upper[..., self._n_done : stop, columns] = factor[..., :n_new, :]
        self._open = columns[n_new:]
        self._carried = factor[..., n_new:, n_new:]
        self._n_done = stop
        self._n_added += 1
        if self._n_done == self.n_unknowns:
            self.upper[..., -1, -1] = self._carried[..., 0, 0]

    def columns_of(self, step: Step) -> tuple[np.ndarray, np.ndarray]:
        """Columns of an equation's factor among all, and their signs in it."""
        columns = []
        signs = []
        for key in _unknowns(step):
            columns.append(self.columns[key])
            sign = key.incidence(step.dofs[0]) if isinstance(key, Site) else 1
            signs.append(np.full(len(columns[-1]), float(sign)))
        columns.append(np.array([self.n_unknowns]))
        signs.append(np.ones(1))
        return np.concatenate(columns), np.concatenate(signs)

    def solved(self) -> np.ndarray:
        """All unknowns, (..., n_unknowns), of a factor of full rank."""
        p = self.n_unknowns
        values = []
        for upper in self.upper.reshape(-1, p + 1, p + 1):
            values.append(back_substituted(upper[:p, :p], upper[:p, p]))
        return np.array(values).reshape(*self.grams.shape, p)


def _unknowns(step: Step) -> list[Key]:
    """Masses and sites that are unknown in a step."""
    return [*step.masses, *step.sites]


def _plain(value: np.ndarray) -> PerBlock:
    """A plain number, or one for each block."""
    return value if value.ndim else float(value)
