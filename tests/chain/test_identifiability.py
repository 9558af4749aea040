"""What an excitation can identify: said before any number, and true."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain
from pysindy_nrf.exceptions import ChainError, IdentifiabilityError


@st.composite
def situations(draw):
    n = draw(st.integers(1, 4))
    dofs = st.sets(st.integers(1, n))
    links = draw(
        st.sets(
            st.sampled_from(["link 3-1", "link 4-2", "ground 2", "ground 3"]),
            max_size=1,
        )
    )
    links = [x for x in links if int(x.split()[1][0]) <= n]
    return n, links, draw(dofs), draw(dofs), draw(dofs)


def _joint_rank(n, links, forced, unknown, known, seed=0):
    """Rank of all balances at once for a linear chain, and the number of unknowns."""
    rng = np.random.default_rng(seed)
    chain, size = Chain(n, links), 200
    s, v = rng.normal(size=(2, size, n))
    F = np.zeros((size, n))
    for j in forced | unknown:
        F[:, j - 1] = rng.normal(size=size)
    D = np.array(
        [[site.q < j <= site.p for j in range(1, n + 1)] for site in chain.sites],
        dtype=float,
    )
    drift, rate = s @ D.T, v @ D.T
    R = drift * rng.uniform(1, 3, len(chain.sites)) + rate * rng.uniform(
        1, 3, len(chain.sites)
    )
    a = (F - R @ chain.incidence().T) / rng.uniform(1, 3, n)
    free = [j for j in range(1, n + 1) if j not in known]
    rows = []
    for j in range(1, n + 1):
        if j in unknown:
            continue
        row = np.zeros((len(a), len(free) + 2 * len(chain.sites)))
        if j in free:
            row[:, free.index(j)] = a[:, j - 1]
        for i, sign in enumerate(chain.incidence()[j - 1]):
            row[:, len(free) + 2 * i], row[:, len(free) + 2 * i + 1] = (
                sign * drift[:, i],
                sign * rate[:, i],
            )
        rows.append(row)
    columns = len(free) + 2 * len(chain.sites)
    if not rows:
        return 0, columns
    A = np.vstack(rows)
    size = np.linalg.norm(A, axis=0)
    values = np.linalg.svd(A / np.where(size > 0, size, 1.0), compute_uv=False)
    return int((values > 1e-10 * values[0]).sum()), columns


@settings(max_examples=200)
@given(situations())
def test_the_order_refuses_exactly_what_the_data_cannot_hold(situation):
    """A solve order is complete if and only if all balances together determine every
    unknown.
    """
    n, links, forced, unknown, known = situation
    solve_order = Chain(n, links).identifiability(
        forced - unknown, unknown=unknown, known_masses=known
    )
    rank, columns = _joint_rank(n, links, forced - unknown, unknown, known)
    assert solve_order.complete == (rank == columns), str(solve_order)
    assert bool(solve_order.reasons) == (not solve_order.complete)


@given(situations())
def test_a_solve_order_finds_each_thing_once_and_uses_only_what_it_has(situation):
    n, links, forced, unknown, known = situation
    solve_order = Chain(n, links).identifiability(
        forced - unknown, unknown=unknown, known_masses=known, strategy="sequential"
    )
    masses, sites = set(known), set()
    for step in solve_order.steps:
        assert not set(step.dofs) & unknown
        assert not set(step.masses) & masses and not set(step.sites) & sites
        assert set(step.known_sites) <= sites
        assert step.forced or step.known_sites or set(step.dofs) & masses
        masses |= set(step.masses)
        sites |= set(step.sites)
    assert masses | set(solve_order.missing_masses) == set(range(1, n + 1))
    assert sites | set(solve_order.missing_sites) == set(Chain(n, links).sites)


def test_the_words_name_the_storey_and_the_cure():
    solve_order = Chain(4).identifiability(excited=4, unknown=[3])
    text = str(solve_order)
    assert (
        "storey 3 cannot be scaled: the force on DOF 3 is unknown" in text
        and "hit floor 2" in text
    )
    with pytest.raises(IdentifiabilityError, match="storey 3 cannot be scaled"):
        solve_order.require_complete()
    assert "no force and no known mass" in str(Chain(2).identifiability())


@pytest.mark.parametrize("strategy", ["complete", "joint"])
def test_complete_and_joint_need_every_force(strategy):
    with pytest.raises(IdentifiabilityError, match="DOF 1, 3"):
        Chain(3).identifiability([2], strategy=strategy)


def test_dofs_that_do_not_exist():
    with pytest.raises(ChainError, match="excited names DOF 4"):
        Chain(3).identifiability([4])


def test_a_plan_without_a_floor_to_hit_asks_for_a_mass():
    plan = Chain(3).plan(can_hit=[])
    assert not len(plan.table) and "No floor can be hit with a known force" in str(plan)


def test_what_only_a_brace_scales_comes_after_what_a_storey_scales():
    """Both balances have two unknowns left; a brace carries a small part of the shear,
    and its errors would rule.
    """
    order = Chain(3, ["link 3-1"]).identifiability(1)
    assert [step.dofs for step in order.steps] == [(1,), (2,), (3,)]
