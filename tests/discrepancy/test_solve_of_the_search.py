"""The compiled solve of a search is the chain solve of the model that is reported."""

import numpy as np
import pytest

from pysindy_nrf import Chain
from pysindy_nrf.chain import Layout, blocks_of, plan_solve_order
from pysindy_nrf.equations import groups_of, solve, total_gram
from pysindy_nrf.equations.many_solves import ChainFit

BRACED = Layout(
    Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 1, "storey 3": 2, "link 3-1": 1}
)
PLAIN = Layout(Chain(4), {f"storey {i}": 2 for i in range(1, 5)})
ALL_MASSES = {1: 1.0, 2: 2.0, 3: 3.0, 4: 4.0}


def order_of(layout, forced, known):
    return plan_solve_order(
        layout.chain, forced, (), known, "sequential", layout.acting
    ).require_complete()


def compiled(layout, forced, known):
    """The compiled solve of the terms, accelerations and forces of a layout."""
    where = {s: list(range(rows.start, rows.stop)) for s, rows in layout.slices.items()}
    order = order_of(layout, forced, known)
    return ChainFit(layout, order, known, where, layout.n_terms, forced)


@pytest.fixture(
    params=[
        (BRACED, (1, 2, 3), {}),
        (BRACED, (1, 2, 3), {2: 7.0}),
        (PLAIN, (4,), {}),
        (PLAIN, (2,), {3: 2.0}),
        (PLAIN, (), ALL_MASSES),
    ]
)
def problem(request):
    """Layout, forced DOFs and known masses."""
    return request.param


def random_columns(layout, forced):
    """Terms of many sizes, accelerations, and forces that they nearly explain."""
    rng = np.random.default_rng(5)
    n, n_terms = layout.n_dof, layout.n_terms
    count = 500
    sizes = 10.0 ** rng.uniform(-6, 1, n_terms)
    terms = rng.normal(size=(count, n_terms)) * sizes
    a, noise = rng.normal(size=(2, count, n))
    F = a * 3.0 + noise + (terms / terms.std(axis=0)) @ rng.normal(size=(n_terms, n))
    F[:, [j - 1 for j in range(1, n + 1) if j not in forced]] = 0.0
    return terms, a, F


def test_it_gives_the_masses_and_coefficients_of_the_chain_solve(problem):
    layout, forced, known = problem
    terms, a, F = random_columns(layout, forced)
    order = order_of(layout, forced, known)
    groups, blocks = groups_of(layout, order), blocks_of(terms, a, F)
    exact = solve(total_gram(layout, groups, blocks, known, "root"), order, known)

    fit = compiled(layout, forced, known)
    rows = np.hstack([terms, a, F])
    masses, values = fit.solve(np.tile(rows.T @ rows, (2, len(fit.groups), 1, 1)))
    wanted = [exact.masses[j] for j in range(1, layout.n_dof + 1)]
    for k in range(2):
        assert masses[k] == pytest.approx(wanted, rel=1e-10)
        for site, coefficients in exact.coefficients.items():
            found = values[k, layout.slices[site]]
            assert found == pytest.approx(coefficients, rel=1e-10)


def test_its_residual_rows_are_the_balances(problem):
    layout, forced, known = problem
    terms, a, F = random_columns(layout, forced)
    fit = compiled(layout, forced, known)
    rows = np.hstack([terms, a, F])
    masses, values = fit.solve(np.tile(rows.T @ rows, (1, len(fit.groups), 1, 1)))
    residual, reference = fit.rows(masses, values)

    inertia = a * masses[0]
    for balance, number in enumerate(fit.judged):
        group = fit.groups[number]
        dofs = [j - 1 for j in group.dofs]
        by_hand = (F - inertia)[:, dofs].sum(axis=1)
        for site, sign in zip(group.sites, group.signs):
            columns = layout.slices[site]
            by_hand -= sign * terms[:, columns] @ values[0, columns]
        np.testing.assert_allclose(rows @ residual[0, balance], -by_hand, atol=1e-8)
    assert reference.shape == residual.shape


def test_columns_that_depend_on_each_other_are_no_number():
    fit = compiled(PLAIN, (1, 2, 3, 4), {})
    rows = np.random.default_rng(0).standard_normal((16, 300))
    rows[1] = 2.0 * rows[0]
    products = np.tile(rows @ rows.T, (1, len(fit.groups), 1, 1))
    assert np.isnan(fit.solve(products)[1]).any()
