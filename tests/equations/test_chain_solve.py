"""The solve on ready columns: each equation by hand and by NumPy's least squares."""

from dataclasses import dataclass, field

import chains
import numpy as np
import pysindy as ps
import pytest

from pysindy_nrf import Chain, NRFRegressor
from pysindy_nrf.chain import Layout, blocks_of, plan_solve_order
from pysindy_nrf.equations import (
    NormalEquations,
    NotTogether,
    balance_sizes,
    groups_of,
    solve,
    solve_blocks,
    total_products,
)
from pysindy_nrf.exceptions import IdentifiabilityError, NRFError, RankWarning

# Three storeys with a brace from floor 1 to floor 3, and the terms of its laws.
LAYOUT = Layout(
    Chain(3, ["link 3-1"]), {"storey 1": 2, "storey 2": 1, "storey 3": 2, "link 3-1": 1}
)
MASSES = {1: 4.0, 2: 7.0, 3: 2.5}
LAWS = {
    "storey 1": [30.0, 4e4],
    "storey 2": [-5e3],
    "storey 3": [2e4, 1e9],
    "link 3-1": [800.0],
}
UNITS = {
    "storey 1": [1e-1, 1e-3],
    "storey 2": [1e-3],
    "storey 3": [1e-3, 1e-8],
    "link 3-1": [1e-2],
}
# The equation of motion of each DOF, written out: + at the upper end of a link, - at
# the lower one.
SITES = {
    1: {"storey 1": 1, "storey 2": -1, "link 3-1": -1},
    2: {"storey 2": 1, "storey 3": -1},
    3: {"storey 3": 1, "link 3-1": 1},
}
KNOWN = pytest.mark.parametrize("known", [{}, {2: 7.5}], ids=str)


@dataclass
class Case:
    """Columns by site, accelerations, and forces that close every equation to noise."""

    noise: float = 0.0
    n_samples: int = 400
    seed: int = 0
    terms: dict = field(default_factory=dict)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        for site, units in UNITS.items():
            self.terms[site] = rng.normal(size=(self.n_samples, len(units))) * units
        self.a = rng.normal(size=(self.n_samples, 3))
        inertia = self.a * list(MASSES.values())
        self.F = inertia + self.reactions()
        self.F += self.noise * rng.normal(size=self.F.shape)

    def reactions(self):
        """Forces of the laws in each equation."""
        total = np.zeros((self.n_samples, 3))
        for dof, sites in SITES.items():
            for site, sign in sites.items():
                total[:, dof - 1] += sign * self.terms[site] @ LAWS[site]
        return total

    def columns(self, dof):
        """Terms of an equation, in the order of its sites."""
        return [self.terms[site] for site in SITES[dof]]

    def shaken(self, noise):
        """The same laws without force: accelerations follow from the equations."""
        self.F = np.zeros_like(self.F)
        self.a = -self.reactions() / list(MASSES.values())
        self.a += noise * np.random.default_rng(9).normal(size=self.a.shape)
        return self

    def total(self, order, kind="gram", known=None):
        terms = np.hstack([self.terms[str(site)] for site in LAYOUT.sites])
        blocks = blocks_of(terms, self.a, self.F, 150)
        return total_products(LAYOUT, groups_of(LAYOUT, order), blocks, known, kind)

    def solved(self, order, known=None):
        return solve(self.total(order, known=known), order, known)


def order_of(forced=(), known=(), strategy="auto"):
    return plan_solve_order(LAYOUT.chain, forced, (), known, strategy, LAYOUT.acting)


def least_squares(*columns, y):
    """NumPy's solution on columns of unit length, and what it leaves."""
    A = np.column_stack(columns)
    length = np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A / length, y, rcond=None)[0] / length
    return x, y - A @ x


def rms(signal):
    return np.sqrt(np.mean(signal**2))


# -- blocks, each by itself ----------------------------------------------------


@pytest.fixture(scope="module")
def three_records():
    """Records of other noise, solved at once."""
    cases = [Case(noise=5.0, seed=seed) for seed in range(3)]
    order = order_of([1, 2, 3], strategy="complete")
    together = NormalEquations.stack([case.total(order, "root") for case in cases])
    return cases, together, solve(together, order)


def test_blocks_are_solved_as_each_by_itself(three_records):
    cases, _, solution = three_records
    first = next(fit for fit in solution.fits if fit.step.dofs == (1,))
    for i, case in enumerate(cases):
        step = solution.of(i)
        x, residual = least_squares(case.a[:, 0], *case.columns(1), y=case.F[:, 0])
        assert step.masses[1] == pytest.approx(x[0], rel=1e-9)
        assert step.coefficients["storey 1"] == pytest.approx(x[1:3], rel=1e-9)
        assert first.residual[i] == pytest.approx(rms(residual), rel=1e-9)


def test_blocks_are_judged_as_each_by_itself(three_records):
    _, together, solution = three_records
    sizes = balance_sizes(1, solution.masses, solution.coefficients, together)
    for i in range(3):
        step = solution.of(i)
        alone = balance_sizes(1, step.masses, step.coefficients, together[i])
        of_block = [sizes.residual[i], sizes.reference[i], sizes.storey[i]]
        assert of_block == pytest.approx(alone[:3], rel=1e-12)


def test_a_mass_that_is_known_is_known_in_every_block():
    order = order_of([1, 2, 3], {2: 7.0}, "complete")
    cases = [Case(noise=5.0, seed=seed) for seed in range(3)]
    together = NormalEquations.stack([case.total(order) for case in cases])
    solution = solve(together, order, {2: 7.0})
    assert [solution.of(i).masses[2] for i in range(3)] == [7.0] * 3


def test_blocks_with_dependent_columns_have_to_be_solved_one_by_one():
    order = order_of([1, 2, 3], strategy="complete")
    spoilt = Case(noise=5.0)
    spoilt.terms["storey 1"][:, 1] = spoilt.terms["storey 1"][:, 0]
    together = NormalEquations.stack([Case().total(order), spoilt.total(order)])
    with pytest.raises(NotTogether):
        solve(together, order)


# -- what the solve order finds ------------------------------------------------


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_complete_takes_each_equation_on_its_own(dof):
    """A law is found by the equation above it; its twin by that below."""
    case = Case(noise=5.0)
    solution = case.solved(order_of([1, 2, 3], strategy="complete"))
    x, _ = least_squares(case.a[:, dof - 1], *case.columns(dof), y=case.F[:, dof - 1])
    assert solution.masses[dof] == pytest.approx(x[0], rel=1e-9)
    start = 1
    for site, sign in SITES[dof].items():
        stop = start + len(UNITS[site])
        coefficients = solution.coefficients if sign > 0 else solution.twins
        assert coefficients[site] == pytest.approx(sign * x[start:stop], rel=1e-9)
        start = stop


def test_a_storey_on_the_ground_has_no_twin():
    solution = Case(noise=5.0).solved(order_of([1, 2, 3], strategy="complete"))
    assert set(solution.twins) == {"storey 2", "storey 3", "link 3-1"}


def test_sequential_takes_what_it_knows_to_the_right():
    case = Case(noise=5.0)
    solution = case.solved(order_of([3], strategy="sequential"))
    T = case.terms
    a = case.a.T
    F = case.F.T
    x3, e3 = least_squares(a[2], T["storey 3"], T["link 3-1"], y=F[2])
    y2 = F[1] + T["storey 3"] @ x3[1:3]
    x2, e2 = least_squares(a[1], T["storey 2"], y=y2)
    y1 = F[0] + T["storey 2"] @ x2[1:] + T["link 3-1"] @ x3[3:]
    x1, e1 = least_squares(a[0], T["storey 1"], y=y1)

    assert solution.masses == pytest.approx({3: x3[0], 2: x2[0], 1: x1[0]}, rel=1e-9)
    expected = {
        "storey 3": x3[1:3],
        "link 3-1": x3[3:],
        "storey 2": x2[1:],
        "storey 1": x1[1:],
    }
    for site, values in expected.items():
        assert solution.coefficients[site] == pytest.approx(values, rel=1e-9)
    assert not solution.twins
    residuals = [(e3, F[2]), (e2, y2), (e1, y1)]
    for fit, (e, y) in zip(solution.fits, residuals, strict=True):
        assert fit.residual == pytest.approx(rms(e), rel=1e-9)
        assert fit.share == pytest.approx(rms(e) / rms(y), rel=1e-9)
    assert [fit.n_columns for fit in solution.fits] == [4, 2, 3]
    assert [fit.rank for fit in solution.fits] == [4, 2, 3]


def test_base_excitation_takes_each_storey_from_the_inertia_above_it():
    """-sum m a of the floors above a cut is what the cut transmits."""
    case = Case().shaken(noise=0.1)
    order = order_of(known=MASSES)
    assert [step.dofs for step in order.steps] == [(3,), (2, 3), (1, 2, 3)]
    solution = case.solved(order, known=MASSES)

    T = case.terms
    inertia = -case.a * list(MASSES.values())
    top, e3 = least_squares(T["storey 3"], T["link 3-1"], y=inertia[:, 2])
    above_2 = inertia[:, 1:].sum(axis=1) - T["link 3-1"] @ top[2:]
    middle, e2 = least_squares(T["storey 2"], y=above_2)
    bottom, e1 = least_squares(T["storey 1"], y=inertia.sum(axis=1))
    expected = {
        "storey 3": top[:2],
        "link 3-1": top[2:],
        "storey 2": middle,
        "storey 1": bottom,
    }
    for site, values in expected.items():
        assert solution.coefficients[site] == pytest.approx(values, rel=1e-9)
    assert solution.masses == MASSES
    residuals = [fit.residual for fit in solution.fits]
    assert residuals == pytest.approx([rms(e3), rms(e2), rms(e1)], rel=1e-9)


def joint_rows(record, dof, known):
    """Columns of all unknowns in the equation of a DOF, and its right-hand side."""
    columns = []
    for other in (3, 2, 1):
        if other not in known:
            columns.append(record.a[:, [dof - 1]] * (other == dof))
    for site in LAWS:
        columns.append(SITES[dof].get(site, 0) * record.terms[site])
    weighed = known.get(dof, 0.0) * record.a[:, dof - 1]
    return np.hstack(columns), record.F[:, dof - 1] - weighed


@KNOWN
def test_joint_is_least_squares_of_equations_divided_by_what_each_leaves(known):
    """An equation counts by its samples; a law has one value (third law)."""
    complete, without_3 = Case(noise=5.0), Case(noise=5.0, n_samples=300, seed=1)
    without_3.F[:, 2] = np.nan
    order = order_of([1, 2, 3], known, "joint")
    total = complete.total(order, known=known)
    total = total.merge(without_3.total(order, known=known))
    solution = solve(total, order, known)

    stacked = []
    targets = []
    levels = {}
    for dof in (3, 2, 1):
        records = [complete] if dof == 3 else [complete, without_3]
        parts = [joint_rows(record, dof, known) for record in records]
        A = np.vstack([rows for rows, _ in parts])
        y = np.concatenate([target for _, target in parts])
        levels[dof] = rms(least_squares(A[:, A.any(axis=0)], y=y)[1])
        stacked.append(A / levels[dof])
        targets.append(y / levels[dof])
    x, _ = least_squares(np.vstack(stacked), y=np.concatenate(targets))

    free = [dof for dof in (3, 2, 1) if dof not in known]
    masses = [solution.masses[dof] for dof in free]
    coefficients = np.concatenate([solution.coefficients[site] for site in LAWS])
    assert masses == pytest.approx(x[: len(free)], rel=1e-9)
    assert coefficients == pytest.approx(x[len(free) :], rel=1e-9)
    residuals = [fit.residual for fit in solution.fits]
    assert residuals == pytest.approx(list(levels.values()), rel=1e-9)


def test_a_joint_solve_by_default_gives_way_where_equations_contradict_each_other():
    """The force on DOF 2 is ten times too large: its laws are, too."""
    case = Case(noise=0.1)
    case.F[:, 1] *= 10.0
    order = order_of([1, 2, 3])
    solution = case.solved(order)
    assert (order.strategy, order.yields) == ("joint", True)
    assert solution.contradicts
    assert solution.followed(order).strategy == "complete"
    assert solution.coefficients["storey 3"] == pytest.approx(LAWS["storey 3"], rel=0.1)


# -- what is known of a fit ----------------------------------------------------

SINGLE = Layout(Chain(1), {"storey 1": 2})


def order_of_one():
    return plan_solve_order(
        SINGLE.chain, [1], strategy="complete", sites=SINGLE.acting, alone=True
    )


def single(columns, a, F, kind="gram", known=None):
    """One DOF, solved from its two terms."""
    blocks = blocks_of(np.column_stack(columns), a[:, None], F[:, None])
    order = plan_solve_order(
        SINGLE.chain, [1], (), known or (), strategy="complete", sites=SINGLE.acting
    )
    total = total_products(SINGLE, groups_of(SINGLE, order), blocks, known, kind)
    return solve(total, order, known)


def at_angle(angle):
    """Two columns of any length at an angle, and two unit vectors across both."""
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(50, 4)))[0].T
    turned = np.cos(angle) * q[0] + np.sin(angle) * q[1]
    return 3e-4 * q[0], 7e2 * turned, q[2], q[3]


@pytest.mark.parametrize("angle", [0.9, 0.1, 1e-3])
@pytest.mark.parametrize(("kind", "rel"), [("gram", 1e-8), ("root", 1e-9)])
def test_the_condition_is_that_of_columns_of_unit_length(angle, kind, rel):
    """Singular values sqrt(1 +- cos), whose ratio is cot(angle / 2)."""
    x, y, a, F = at_angle(angle)
    (fit,) = single([x, y], a, a + F, kind, known={1: 1.0}).fits
    assert fit.condition == pytest.approx(1 / np.tan(angle / 2), rel=rel)


def test_noise_of_a_mass_is_the_residual_over_the_inertia_that_nothing_imitates():
    """2 kg on a column at 0.3 rad to the stiffness: the own part is 2 |a| sin 0.3."""
    s, a, v, e = at_angle(0.3)
    F = 2 * a + 40 * s / np.linalg.norm(s) + v + 25 * e
    solution = single([s, v], a, F)
    (fit,) = solution.fits
    assert solution.masses[1] == pytest.approx(2.0)
    stiffness = 2 * 700 * np.sin(0.3)
    assert fit.mass_noise == pytest.approx((25 / stiffness,), rel=1e-8)
    assert fit.residual == pytest.approx(25 / np.sqrt(len(a)))


# -- squares that lose digits --------------------------------------------------


def solved_in_passes(angle, noise):
    """Solution, kind of its sums, and passes over data with terms at an angle."""
    x, y, a, e = at_angle(angle)
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    F = 2 * a + 3 * x + 5 * y + noise * e
    passes = []

    def blocks():
        passes.append(1)
        return blocks_of(np.column_stack([x, y]), a[:, None], F[:, None], 20)

    solution, total = solve_blocks(SINGLE, order_of_one(), blocks)
    return solution, total.kind, len(passes)


def test_data_whose_squares_keep_their_digits_are_read_once():
    solution, kind, passes = solved_in_passes(0.5, noise=0.0)
    assert (kind, passes) == ("gram", 1)
    assert solution.masses[1] == pytest.approx(2.0)
    assert solution.coefficients["storey 1"] == pytest.approx([3.0, 5.0])


def test_noise_covers_what_squares_lose():
    assert solved_in_passes(1e-2, noise=0.1)[1:] == ("gram", 1)


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-7, 5e-9])
def test_where_squares_lose_digits_the_data_are_read_again_by_qr(angle):
    solution, kind, passes = solved_in_passes(angle, noise=0.0)
    assert (kind, passes) == ("root", 2)
    assert solution.masses[1] == pytest.approx(2.0, rel=1e-12)
    coefficients = solution.coefficients["storey 1"]
    assert coefficients == pytest.approx([3.0, 5.0], rel=1e-14 / angle)


# -- rank ----------------------------------------------------------------------


def test_dependent_terms_share_the_force():
    """The smallest coefficients on columns of unit length: half to each of the two."""
    s, a = at_angle(0.5)[2:]
    with pytest.warns(RankWarning, match="rank 2 of 3") as caught:
        solution = single([s, -3 * s], a, 2 * a + 12 * s)
    assert solution.masses[1] == pytest.approx(2.0)
    assert solution.coefficients["storey 1"] == pytest.approx([6.0, -2.0])
    (fit,) = solution.fits
    assert (fit.rank, fit.mass_noise) == (2, ())
    assert fit.share < 1e-7
    assert caught[0].filename == __file__


def test_a_warning_of_rank_names_the_terms_that_depend_on_each_other():
    s, a = at_angle(0.5)[2:]
    with pytest.warns(RankWarning) as caught:
        single([s, -3 * s], a, 2 * a + 12 * s)
    text = str(caught[0].message)
    assert "storey 1: term 1" in text
    assert "storey 1: term 2" in text
    assert "m1" not in text


def test_a_mass_that_depends_on_a_term_is_refused():
    s, v, e = at_angle(0.5)[1:]
    with pytest.raises(IdentifiabilityError, match="m1 cannot be separated from"):
        single([s, v], 2 * s, s + v + e)


# -- columns that cannot be used -----------------------------------------------


def test_a_column_of_zeros_is_named():
    s, _, a, F = at_angle(1.0)
    with pytest.raises(
        IdentifiabilityError, match="column of storey 1: term 2 is zero"
    ):
        single([s, 0 * s], a, F)


def test_the_first_of_several_columns_of_zeros_is_named():
    s, _, a, F = at_angle(1.0)
    with pytest.raises(IdentifiabilityError, match="column of m1 is zero"):
        single([s, 0 * s], 0 * a, F)


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("size", [1e-150, 1e200])
def test_squares_that_leave_the_range_of_a_double_are_named(size):
    """By QR, which takes no squares of its own before the lengths are known."""
    s, _, a, F = at_angle(1.0)
    with pytest.raises(NRFError, match="squares of storey 1: term 2"):
        single([s, F * size], a, F, kind="root")
    with pytest.raises(NRFError, match="squares of the force"):
        single([s, F], a, F * size, kind="root")


def test_an_equation_that_nothing_scales_is_refused():
    s, v, a, _ = at_angle(1.0)
    with pytest.raises(IdentifiabilityError, match="right-hand side is zero") as error:
        single([s, v], a, 0 * a)
    assert error.value.cure == "No force, known mass or known law scales it."


# -- an optimizer on every equation --------------------------------------------


def test_no_mass_of_a_joint_solve_meets_the_threshold():
    """A light floor on strong springs: its inertia is a small part of the force."""
    first = chains.duffing(3, [1, 2, 3], seed=0, cubic=False)
    m = np.array([0.1, *first.m[1:]])
    parameters = (m, 0 * first.c, first.k, first.k3)
    case = chains.duffing(3, [1, 2, 3], seed=0, parameters_of_chain=parameters)
    assert np.std(m[0] * case.a[:, 0]) < 0.1 * np.std(case.F[:, 0])
    sparse = ps.STLSQ(threshold=0.1, alpha=0)
    model = NRFRegressor(degree=(0, 1), strategy="joint", optimizer=sparse)
    np.testing.assert_allclose(model.fit(case.X, case.F).masses_, m, rtol=1e-8)
