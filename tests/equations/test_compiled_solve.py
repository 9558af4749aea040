"""The compiled solve of many candidates is the general solve of each."""

from dataclasses import dataclass

import numpy as np
import pytest

from pysindy_nrf import Chain
from pysindy_nrf.chain import Layout, blocks_of, plan_solve_order
from pysindy_nrf.equations import (
    ChannelSolve,
    CompiledChainSolve,
    groups_of,
    solve,
    total_products,
)

BRACED = Layout(
    Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 1, "storey 3": 3, "link 3-1": 2}
)
PLAIN = Layout(Chain(4), {f"storey {i}": 2 for i in range(1, 5)})


@dataclass
class Case:
    """Random columns of a layout, and forces that they nearly explain."""

    layout: Layout
    forced: tuple
    known: dict

    def __post_init__(self):
        rng = np.random.default_rng(5)
        n_terms, n_dof = self.layout.n_terms, self.layout.n_dof
        units = 10.0 ** rng.uniform(-6, 1, n_terms)
        self.terms = rng.normal(size=(500, n_terms)) * units
        self.a, noise = rng.normal(size=(2, 500, n_dof))
        forces = self.terms / units @ rng.normal(size=(n_terms, n_dof))
        self.F = 3.0 * self.a + noise + forces
        for dof in range(1, n_dof + 1):
            if dof not in self.forced:
                self.F[:, dof - 1] = 0.0

    @property
    def rows(self):
        return np.hstack([self.terms, self.a, self.F])

    @property
    def where(self):
        return {
            s: range(columns.start, columns.stop)
            for s, columns in self.layout.slices.items()
        }

    def order(self):
        layout = self.layout
        return plan_solve_order(
            layout.chain, self.forced, (), self.known, "sequential", layout.acting
        ).require_complete()

    def general(self):
        order = self.order()
        blocks = blocks_of(self.terms, self.a, self.F)
        groups = groups_of(self.layout, order)
        total = total_products(self.layout, groups, blocks, self.known, "root")
        return solve(total, order, self.known)

    def compiled(self):
        first_mass = self.layout.n_terms
        return CompiledChainSolve(
            self.layout, self.order(), self.known, self.where, first_mass, self.forced
        )


CASES = [
    Case(BRACED, (1, 2, 3), {}),
    Case(BRACED, (1, 2, 3), {2: 7.0}),
    Case(PLAIN, (4,), {}),
    Case(PLAIN, (2,), {3: 2.0}),
    Case(PLAIN, (), {1: 1.0, 2: 2.0, 3: 3.0, 4: 4.0}),
]


@pytest.mark.parametrize("case", CASES)
def test_the_compiled_solve_is_the_general_solve(case):
    general, compiled = case.general(), case.compiled()
    products = case.rows.T @ case.rows
    sums = np.tile(products, (2, len(compiled.groups), 1, 1))
    masses, theta = compiled.solve(sums)
    expected = [general.masses[dof] for dof in range(1, case.layout.n_dof + 1)]
    for k in range(2):
        assert masses[k] == pytest.approx(expected, rel=1e-10)
        for site, values in general.coefficients.items():
            assert theta[k, case.where[site]] == pytest.approx(values, rel=1e-10)


@pytest.mark.parametrize("case", CASES)
def test_rows_of_residuals_are_the_equations_of_motion(case):
    compiled = case.compiled()
    products = case.rows.T @ case.rows
    masses, theta = compiled.solve(np.tile(products, (1, len(compiled.groups), 1, 1)))
    residual, reference = compiled.rows(masses, theta)
    unbalanced = case.a * masses[0] - case.F
    for i, number in enumerate(compiled.judged):
        group = compiled.groups[number]
        expected = unbalanced[:, [dof - 1 for dof in group.dofs]].sum(axis=1)
        for site, sign in zip(group.sites, group.signs):
            columns = case.where[site]
            expected = expected + sign * case.terms[:, columns] @ theta[0, columns]
        np.testing.assert_allclose(case.rows @ residual[0, i], expected, atol=1e-8)
    assert reference.any(axis=2).all()


def test_a_forced_equation_is_judged_over_its_force_and_a_shaken_one_over_inertia():
    force = CASES[0].compiled().rows(np.ones((1, 3)), np.zeros((1, 14)))[1]
    assert (CASES[0].rows @ force[0, 1]).tolist() == CASES[0].F[:, 1].tolist()
    shaken = CASES[4]
    masses = np.array([list(shaken.known.values())])
    inertia = shaken.compiled().rows(masses, np.zeros((1, 16)))[1]
    products = shaken.rows @ inertia[0, 3]
    assert products == pytest.approx(4.0 * shaken.a[:, 3])


def test_columns_that_depend_on_each_other():
    """No number if strict; else the latter of the two is zero."""
    case = Case(PLAIN, (1, 2, 3, 4), {})
    case.terms[:, 1] = 2.0 * case.terms[:, 0]
    compiled = case.compiled()
    products = case.rows.T @ case.rows
    sums = np.tile(products, (1, len(compiled.groups), 1, 1))
    assert np.isnan(compiled.solve(sums)[1]).any()
    theta = compiled.solve(sums, strict=False)[1][0]
    assert np.isfinite(theta).all()
    assert theta[1] == 0.0


def test_rows_beside_a_storey_are_those_of_the_equations_at_its_ends():
    case = CASES[2]
    beside = case.compiled().beside(list(case.where["storey 2"]))
    names = [f"term {k}" for k in range(8)]
    names += [f"{kind}{dof}" for kind in "aF" for dof in range(1, 5)]
    names_beside = {names[row] for row in beside}
    assert {"a1", "a2", "F1", "F2"} <= names_beside
    assert names_beside.isdisjoint({"a3", "a4", "F3", "F4", "term 6", "term 7"})


def test_channels_are_one_least_squares_problem():
    """Columns [terms | what masses do | what forces do | channels]."""
    rng = np.random.default_rng(1)
    layout = Layout(Chain(2), {"storey 1": 2, "storey 2": 1})
    rows = rng.normal(size=(300, 7))
    solver = ChannelSolve(
        layout, {1: 4.0}, {"storey 1": [0, 1], "storey 2": [2]}, first_mass=3
    )
    masses, theta = solver.solve((rows.T @ rows)[None, None])
    unknown = rows[:, [0, 1, 2, 4]]
    expected = np.linalg.lstsq(unknown, rows[:, 5] - 4.0 * rows[:, 3])[0]
    assert theta[0, :3] == pytest.approx(expected[:3], rel=1e-8)
    assert masses[0] == pytest.approx([4.0, expected[3]], rel=1e-8)

    residual, reference = solver.rows(masses, theta)
    gap = unknown @ expected + 4.0 * rows[:, 3] - rows[:, 5]
    assert rows @ residual[0, 0] == pytest.approx(gap, abs=1e-8)
    assert (rows @ reference[0, 0]).tolist() == rows[:, 6].tolist()
