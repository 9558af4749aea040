"""The solve on ready columns: what each balance gives, by hand and by NumPy's least
squares.
"""

import chains
import numpy as np
import pysindy as ps
import pytest

from pysindy_nrf import Chain, NRFRegressor
from pysindy_nrf.chain.identifiability import SolveOrder, plan_solve_order
from pysindy_nrf.chain.layout import Layout, blocks_of
from pysindy_nrf.equations.accumulation import total_gram
from pysindy_nrf.equations.chain_solve import Solution, groups_of, solve, solve_blocks
from pysindy_nrf.equations.errors import balance_sizes
from pysindy_nrf.equations.normal_equations import NormalEquations
from pysindy_nrf.exceptions import IdentifiabilityError, NRFError, RankWarning

# A chain of three storeys with a brace from the base's floor 1 to floor 3, and the
# columns of its laws.
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
SIZES = {
    "storey 1": [1e-1, 1e-3],
    "storey 2": [1e-3],
    "storey 3": [1e-3, 1e-8],
    "link 3-1": [1e-2],
}
# The force balance of each DOF, written out: + at the upper end of a link, - at the
# lower one.
BALANCES = {
    1: [("storey 1", 1), ("storey 2", -1), ("link 3-1", -1)],
    2: [("storey 2", 1), ("storey 3", -1)],
    3: [("storey 3", 1), ("link 3-1", 1)],
}
N = 400


class Test:
    """Columns of the laws (by site), accelerations, and forces that close every balance
    up to some noise, N.
    """

    __test__ = False

    def __init__(
        self, noise: float = 0.0, n: int = N, seed: int = 0, forces: bool = True
    ) -> None:
        rng = np.random.default_rng(seed)
        self.terms = {
            site: rng.normal(size=(n, len(size))) * size for site, size in SIZES.items()
        }
        self.a = rng.normal(size=(n, 3))
        self.F = np.column_stack(
            [MASSES[j] * self.a[:, j - 1] + self.reaction(j, LAWS) for j in (1, 2, 3)]
        )
        self.F += noise * rng.normal(size=(n, 3))

    def reaction(self, dof: int, laws: dict) -> np.ndarray:
        return sum(
            sign * self.terms[site] @ np.asarray(laws[site])
            for site, sign in BALANCES[dof]
        )

    def unforced(self, known: dict[int, float], noise: float = 0.0) -> "Test":
        """The same laws without force: the accelerations follow from the balances."""
        self.F = np.zeros_like(self.F)
        self.a = np.column_stack(
            [-self.reaction(j, LAWS) / known[j] for j in (1, 2, 3)]
        )
        self.a += noise * np.random.default_rng(9).normal(size=self.a.shape)
        return self

    def blocks(self, size: int = 150):
        return blocks_of(
            np.hstack([self.terms[str(s)] for s in LAYOUT.sites]), self.a, self.F, size
        )

    def total(
        self, solve_order: SolveOrder, kind: str = "gram", known=None
    ) -> NormalEquations:
        return total_gram(
            LAYOUT, groups_of(LAYOUT, solve_order), self.blocks(), known, kind
        )

    def solved(
        self, solve_order: SolveOrder, kind: str = "gram", known=None, **options
    ) -> Solution:
        return solve(
            self.total(solve_order, kind, known), solve_order, known, **options
        )


def plan(forced=(), known=(), strategy="auto"):
    return plan_solve_order(LAYOUT.chain, forced, (), known, strategy, LAYOUT.acting)


def least_squares(*columns, y):
    """NumPy's solution on columns of unit length, and what it leaves."""
    A = np.column_stack(columns)
    size = np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A / size, y, rcond=None)[0] / size
    return x, y - A @ x


# -- blocks, each by itself ----------------------------------------------------


@pytest.mark.parametrize("known", [{}, {2: 7.0}], ids=str)
def test_blocks_are_solved_as_each_by_itself(known):
    """Three records of other noise: masses and laws of each balance are NumPy's least
    squares on that record alone.
    """
    cases, solve_order = (
        [Test(noise=5.0, seed=seed) for seed in range(3)],
        plan([1, 2, 3], known, "complete"),
    )
    together = NormalEquations.stack(
        [case.total(solve_order, "root", known) for case in cases]
    )
    found = solve(together, solve_order, known)
    for i, case in enumerate(cases):
        own, motion = found.of(i), [case.terms[s] for s, _ in BALANCES[1]]
        x, left = least_squares(case.a[:, 0], *motion, y=case.F[:, 0])
        assert own.masses[1] == pytest.approx(x[0], rel=1e-9)
        assert own.coefficients["storey 1"].tolist() == pytest.approx(
            x[1:3].tolist(), rel=1e-9
        )
        assert own.masses.get(2) == known.get(2, own.masses[2])
        step = next(fit for fit in found.fits if fit.step.dofs == (1,))
        assert step.residual[i] == pytest.approx(np.sqrt((left**2).mean()), rel=1e-9)
        size = balance_sizes(1, found.masses, found.coefficients, together)
        alone = balance_sizes(1, own.masses, own.coefficients, together[i])
        assert [size.residual[i], size.reference[i], size.storey[i]] == pytest.approx(
            list(alone[:3]), rel=1e-12
        )


# -- what the solve order finds ------------------------------------------------


def test_complete_takes_each_balance_on_its_own():
    """A law is the estimate of the balance above it; its twin is that of the balance
    below, with its sign turned.
    """
    case = Test(noise=5.0)
    found = case.solved(plan([1, 2, 3], strategy="complete"))
    for dof, sites in BALANCES.items():
        x, _ = least_squares(
            case.a[:, dof - 1], *(case.terms[s] for s, _ in sites), y=case.F[:, dof - 1]
        )
        assert found.masses[dof] == pytest.approx(x[0], rel=1e-9)
        at = 1
        for site, sign in sites:
            own = found.coefficients if sign > 0 else found.twins
            assert own[site].tolist() == pytest.approx(
                (sign * x[at : at + len(SIZES[site])]).tolist(), rel=1e-9
            )
            at += len(SIZES[site])
    assert set(found.twins) == {
        "storey 2",
        "storey 3",
        "link 3-1",
    }  # storey 1 has the ground below


def test_sequential_takes_what_it_knows_to_the_right():
    case = Test(noise=5.0)
    found = case.solved(plan([3], strategy="sequential"))
    T = case.terms
    x3, e3 = least_squares(case.a[:, 2], T["storey 3"], T["link 3-1"], y=case.F[:, 2])
    y2 = case.F[:, 1] + T["storey 3"] @ x3[1:3]
    x2, e2 = least_squares(case.a[:, 1], T["storey 2"], y=y2)
    y1 = case.F[:, 0] + T["storey 2"] @ x2[1:] + T["link 3-1"] @ x3[3:]
    x1, e1 = least_squares(case.a[:, 0], T["storey 1"], y=y1)
    assert found.masses == pytest.approx({3: x3[0], 2: x2[0], 1: x1[0]}, rel=1e-9)
    for site, x in zip(
        ("storey 3", "link 3-1", "storey 2", "storey 1"),
        (x3[1:3], x3[3:], x2[1:], x1[1:]),
    ):
        assert found.coefficients[site].tolist() == pytest.approx(x.tolist(), rel=1e-9)
    assert not found.twins
    assert [fit.step.dofs for fit in found.fits] == [(3,), (2,), (1,)]
    for fit, e, y, p in zip(
        found.fits, (e3, e2, e1), (case.F[:, 2], y2, y1), (4, 2, 3)
    ):
        assert fit.residual == pytest.approx(np.sqrt(np.mean(e**2)), rel=1e-9)
        assert fit.share == pytest.approx(
            np.sqrt(np.mean(e**2) / np.mean(y**2)), rel=1e-9
        )
        assert (fit.rank, fit.n_columns) == (p, p)


def test_base_excitation_takes_each_storey_from_the_inertia_above_it():
    """Without forces and with all masses known, -sum m a of the floors above a cut is
    what the cut transmits.
    """
    case = Test().unforced(MASSES, noise=0.1)
    solve_order = plan(known=MASSES)
    assert [step.dofs for step in solve_order.steps] == [(3,), (2, 3), (1, 2, 3)]
    found = case.solved(solve_order, known=MASSES)
    inertia, T = -case.a * [MASSES[j] for j in (1, 2, 3)], case.terms
    top, e3 = least_squares(T["storey 3"], T["link 3-1"], y=inertia[:, 2])
    middle, e2 = least_squares(
        T["storey 2"], y=inertia[:, 1:].sum(axis=1) - T["link 3-1"] @ top[2:]
    )
    bottom, e1 = least_squares(T["storey 1"], y=inertia.sum(axis=1))
    for site, x in zip(
        ("storey 3", "link 3-1", "storey 2", "storey 1"),
        (top[:2], top[2:], middle, bottom),
    ):
        assert found.coefficients[site].tolist() == pytest.approx(x.tolist(), rel=1e-9)
    assert found.masses == MASSES and not found.twins
    rms = [np.sqrt(np.mean(e**2)) for e in (e3, e2, e1)]
    assert [fit.residual for fit in found.fits] == pytest.approx(rms, rel=1e-9)
    assert all(fit.mass_noise == () for fit in found.fits)


@pytest.mark.parametrize("known", [{}, {2: 7.5}], ids=str)
def test_joint_is_least_squares_of_all_balances_divided_by_what_each_leaves(known):
    """Each balance counts by its samples over the residual that it leaves by itself; a
    law has one value (third law).
    """
    case, lost = Test(noise=5.0), Test(noise=5.0, n=300, seed=1)
    lost.F[:, 2] = np.nan  # the second record does not know the force on DOF 3
    solve_order = plan([1, 2, 3], known, "joint")
    total = case.total(solve_order, known=known).merge(
        lost.total(solve_order, known=known)
    )
    found = solve(total, solve_order, known)
    free = [j for j in (3, 2, 1) if j not in known]
    rows, right = [], []
    for dof in (1, 2, 3):
        for record in (case, lost) if dof != 3 else (case,):
            a = {
                j: record.a[:, [dof - 1]] if j == dof else np.zeros((len(record.a), 1))
                for j in free
            }
            sign = dict(BALANCES[dof])
            own = [sign.get(site, 0) * record.terms[site] for site in LAWS]
            rows.append((dof, np.hstack([*a.values(), *own])))
            right.append(
                record.F[:, dof - 1] - known.get(dof, 0.0) * record.a[:, dof - 1]
            )
    rms = {}
    for dof in (1, 2, 3):
        own = np.concatenate([A[:, A.any(axis=0)] for d, A in rows if d == dof])
        left = least_squares(
            own, y=np.concatenate([y for (d, _), y in zip(rows, right) if d == dof])
        )[1]
        rms[dof] = np.sqrt(np.mean(left**2))
    A, y = (
        np.concatenate([x / rms[d] for (d, _), x in zip(rows, of)])
        for of in ([A for _, A in rows], right)
    )
    x, _ = least_squares(A, y=y)
    assert [found.masses[j] for j in free] == pytest.approx(
        x[: len(free)].tolist(), rel=1e-9
    )
    assert np.concatenate([found.coefficients[site] for site in LAWS]) == pytest.approx(
        x[len(free) :], rel=1e-9
    )
    assert [fit.residual for fit in found.fits] == pytest.approx(
        [rms[dof] for dof in (3, 2, 1)], rel=1e-9
    )
    assert {j: found.masses[j] for j in known} == known and not found.twins


# -- what is said of a fit -----------------------------------------------------

ONE = Layout(Chain(1), {"storey 1": 2})


def single(columns, a, F, known=None, kind="gram", inner=None, layout=ONE):
    """One DOF, solved from its columns."""
    solve_order = plan_solve_order(
        layout.chain,
        [1],
        known_masses=known or (),
        strategy="complete",
        sites=layout.acting,
    )
    blocks = blocks_of(
        np.asarray(columns), np.asarray(a)[:, None], np.asarray(F)[:, None]
    )
    return solve(
        total_gram(layout, groups_of(layout, solve_order), blocks, known, kind),
        solve_order,
        known,
        inner,
    )


def at_angle(angle, n=4):
    """Two columns of any length at an angle, and a third across both."""
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(50, n)))[0].T
    return 3e-4 * q[0], 7e2 * (np.cos(angle) * q[0] + np.sin(angle) * q[1]), *q[2:]


@pytest.mark.parametrize("angle", [0.9, 0.1, 1e-3])
@pytest.mark.parametrize("kind", ["gram", "root"])
def test_the_condition_is_that_of_columns_of_unit_length(angle, kind):
    """Two unit vectors at an angle have singular values sqrt(1 +- cos), whose ratio is
    cot(angle / 2).
    """
    x, y, a, F = at_angle(angle)
    (fit,) = single(np.column_stack([x, y]), a, a + F, {1: 1.0}, kind).fits
    assert fit.condition == pytest.approx(
        1 / np.tan(angle / 2), rel=1e-9 if kind == "root" else 1e-8
    )


def test_noise_in_the_mass_is_the_residual_over_the_inertia_that_nothing_imitates():
    """A mass of 2 kg on a column at 0.3 rad to the stiffness: its own part is 2 |a| sin
    0.3.
    """
    s, a, v, e = at_angle(0.3)
    F = 2 * a + 40 * s / np.linalg.norm(s) + v + 25 * e
    found = single(np.column_stack([s, v]), a, F)
    assert found.masses[1] == pytest.approx(2.0)
    assert found.fits[0].mass_noise == pytest.approx(
        (25 / (2 * 700 * np.sin(0.3)),), rel=1e-8
    )
    assert found.fits[0].residual == pytest.approx(25 / np.sqrt(len(a)))


# -- squares that lose digits --------------------------------------------------


def _passes(angle, noise):
    """Solve one DOF whose terms stand at an angle; the solution, the kind of its sums
    and the passes over the data.
    """
    x, y, a, e = at_angle(angle)
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    F, passes = 2 * a + 3 * x + 5 * y + noise * e, []
    solve_order = plan_solve_order(
        ONE.chain, [1], strategy="complete", sites=ONE.acting
    )

    def blocks():
        passes.append(1)
        return blocks_of(np.column_stack([x, y]), a[:, None], F[:, None], 20)

    found, total = solve_blocks(ONE, solve_order, blocks)
    return found, total.kind, len(passes)


def test_data_whose_squares_keep_their_digits_are_seen_once():
    found, kind, passes = _passes(0.5, 0.0)
    assert (kind, passes) == ("gram", 1)
    assert [found.masses[1], *found.coefficients["storey 1"]] == pytest.approx(
        [2.0, 3.0, 5.0]
    )
    assert _passes(1e-2, 0.1)[1:] == ("gram", 1)  # noise covers what the squares lose


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-7, 5e-9])
def test_where_squares_lose_digits_the_data_are_seen_again_by_qr(angle):
    found, kind, passes = _passes(angle, 0.0)
    assert (kind, passes) == ("root", 2)
    assert found.masses[1] == pytest.approx(2.0, rel=1e-12)
    assert found.coefficients["storey 1"].tolist() == pytest.approx(
        [3.0, 5.0], rel=1e-14 / angle
    )


# -- rank ----------------------------------------------------------------------


def test_terms_that_cannot_be_told_apart_share_the_force():
    """Of all coefficients that fit, the smallest on columns of unit length: half of the
    force to each of the two.
    """
    s, a = at_angle(0.5)[2:]
    with pytest.warns(
        RankWarning,
        match=r"rank 2 of 3; .* are linearly dependent on this excitation\. ",
    ) as caught:
        found = single(np.column_stack([s, -3 * s]), a, 2 * a + 12 * s)
    assert caught[0].filename == __file__  # where the caller stands
    text = str(caught[0].message)
    assert (
        text.startswith("balance of DOF 1: ")
        and "storey 1: term 1" in text
        and "storey 1: term 2" in text
    )
    assert "m1" not in text  # the mass is none of them
    assert found.masses[1] == pytest.approx(2.0)
    assert found.coefficients["storey 1"].tolist() == pytest.approx([6.0, -2.0])
    (fit,) = found.fits
    assert fit.rank == 2 and fit.mass_noise == () and fit.share < 1e-7


# -- columns that cannot be used -----------------------------------------------


def test_a_column_of_zeros_is_named():
    s, _, a, F = at_angle(1.0)
    with pytest.raises(
        IdentifiabilityError,
        match="balance of DOF 1: the column of storey 1: term 2 is zero throughout",
    ):
        single(np.column_stack([s, 0 * s]), a, F)
    with pytest.raises(
        IdentifiabilityError, match="the column of m1 is zero throughout"
    ):
        single(np.column_stack([s, 0 * s]), 0 * a, F)  # the first of two


@pytest.mark.parametrize("size", [1e-150, 1e200])
def test_squares_that_leave_the_range_of_a_double_are_named(size):
    """By QR, which takes no squares of its own before the lengths are known."""
    s, _, a, F = at_angle(1.0)
    with np.errstate(over="ignore"):
        with pytest.raises(
            NRFError,
            match="balance of DOF 1: the squares of storey 1: term 2 leave the range",
        ):
            single(np.column_stack([s, F * size]), a, F, kind="root")
        with pytest.raises(
            NRFError, match="balance of DOF 1: the squares of the force leave the range"
        ):
            single(np.column_stack([s, F]), a, F * size, kind="root")


def test_a_balance_that_nothing_scales_is_refused():
    s, v, a, _ = at_angle(1.0)
    with pytest.raises(
        IdentifiabilityError,
        match="balance of DOF 1: the right-hand side is zero throughout",
    ) as error:
        single(np.column_stack([s, v]), a, 0 * a)
    assert error.value.cure == "No force, known mass or known law scales it."


# -- an optimizer on every balance ---------------------------------------------


def test_no_mass_of_a_joint_solve_meets_the_threshold():
    """A light floor on strong springs: its inertia is a small part of the force, and is
    found all the same.
    """
    first = chains.duffing(3, [1, 2, 3], seed=0, cubic=False)
    m = np.array([0.1, *first.m[1:]])
    case = chains.duffing(
        3, [1, 2, 3], seed=0, given=(m, 0 * first.c, first.k, first.k3)
    )
    assert np.std(m[0] * case.a[:, 0]) < 0.1 * np.std(case.F[:, 0])
    sparse = ps.STLSQ(threshold=0.1, alpha=0)
    model = NRFRegressor(degree=(0, 1), strategy="joint", optimizer=sparse).fit(
        case.X, case.F
    )
    np.testing.assert_allclose(model.masses_, m, rtol=1e-8)
