"""What an excitation can identify: found before any number, and true."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pysindy_nrf import Chain, ChainModel, laws
from pysindy_nrf.exceptions import ChainError, IdentifiabilityError


@dataclass
class Situation:
    """A chain, DOFs with a measured force, of unknown force, and of known mass."""

    chain: Chain
    forced: set
    unknown: set
    known: set

    def order(self, strategy="auto"):
        return self.chain.identifiability(
            self.forced,
            unknown=self.unknown,
            known_masses=self.known,
            strategy=strategy,
        )


@st.composite
def situations(draw):
    n_dof = draw(st.integers(1, 4))
    dofs = st.sets(st.integers(1, n_dof))
    candidates = {"link 3-1": 3, "link 4-2": 4, "ground 2": 2, "ground 3": 3}
    possible = [link for link, top in candidates.items() if top <= n_dof]
    links = draw(st.lists(st.sampled_from(possible), max_size=1)) if possible else []
    unknown = draw(dofs)
    return Situation(Chain(n_dof, links), draw(dofs) - unknown, unknown, draw(dofs))


def joint_rank(situation):
    """Rank of all usable equations at once for linear laws, and the unknowns."""
    chain = situation.chain
    n_dof = chain.n_dof
    n_sites = len(chain.sites)
    size = 200
    rng = np.random.default_rng(0)
    F = np.zeros((size, n_dof))
    for j in situation.forced | situation.unknown:
        F[:, j - 1] = rng.normal(size=size)

    # drifts and rates of the sites from those of the storeys
    spans = np.zeros((n_sites, n_dof))
    for k, site in enumerate(chain.sites):
        spans[k, site.q : site.p] = 1.0
    drift = rng.normal(size=(size, n_dof)) @ spans.T
    rate = rng.normal(size=(size, n_dof)) @ spans.T
    R = drift * rng.uniform(1, 3, n_sites) + rate * rng.uniform(1, 3, n_sites)
    a = (F - R @ chain.incidence().T) / rng.uniform(1, 3, n_dof)

    free = sorted(set(range(1, n_dof + 1)) - situation.known)
    n_unknowns = len(free) + 2 * n_sites
    rows = [np.zeros((0, n_unknowns))]
    for j in sorted(set(range(1, n_dof + 1)) - situation.unknown):
        masses = a[:, [j - 1]] * (np.array(free) == j)
        signs = chain.incidence()[j - 1]
        rows.append(np.hstack([masses, signs * drift, signs * rate]))
    A = np.vstack(rows)
    if not len(A):
        return 0, n_unknowns
    length = np.linalg.norm(A, axis=0)
    values = np.linalg.svd(A / np.where(length > 0, length, 1.0), compute_uv=False)
    return int((values > 1e-10 * values[0]).sum()), n_unknowns


@settings(max_examples=200)
@given(situations())
def test_the_order_refuses_exactly_what_the_data_cannot_determine(situation):
    """It is complete if and only if all equations together determine every unknown."""
    order = situation.order()
    rank, n_unknowns = joint_rank(situation)
    assert order.complete == (rank == n_unknowns), str(order)
    assert bool(order.reasons) == (not order.complete)


@given(situations())
def test_an_order_finds_each_thing_once_and_uses_what_it_found(situation):
    order = situation.order("sequential")
    masses, sites = set(situation.known), set()
    for step in order.steps:
        assert not set(step.dofs) & situation.unknown
        assert not set(step.masses) & masses
        assert not set(step.sites) & sites
        assert set(step.known_sites) <= sites
        assert step.forced or step.known_sites or set(step.dofs) & masses
        masses |= set(step.masses)
        sites |= set(step.sites)
    dofs = set(range(1, situation.chain.n_dof + 1))
    assert masses | set(order.missing_masses) == dofs
    assert sites | set(order.missing_sites) == set(situation.chain.sites)


def test_the_reasons_name_the_storey_and_the_cure():
    order = Chain(4).identifiability(excited=4, unknown=[3])
    assert "storey 3 cannot be scaled" in str(order)
    assert "hit floor 2" in str(order)
    with pytest.raises(IdentifiabilityError, match="storey 3 cannot be scaled"):
        order.require_complete()


def test_without_a_force_a_mass_would_scale_the_chain():
    assert "no force and no known mass" in str(Chain(2).identifiability())


def test_every_unknown_that_is_out_of_reach_has_a_reason():
    order = Chain(3, ["ground 3"]).identifiability(unknown=[1, 2, 3])
    assert len(order.reasons) == 4 + 3
    top_down = [reason.partition(" cannot")[0] for reason in order.reasons[:3]]
    assert top_down == ["storey 3", "ground 3", "m3"]


def test_a_plan_without_a_floor_to_hit_asks_for_a_mass():
    plan = Chain(3).plan(can_hit=[])
    assert not len(plan.table)
    assert "No floor can be hit" in str(plan)


@pytest.mark.parametrize("strategy", ["complete", "joint"])
def test_complete_and_joint_need_every_force(strategy):
    with pytest.raises(IdentifiabilityError, match="DOF 1, 3"):
        Chain(3).identifiability([2], strategy=strategy)


def test_dofs_that_do_not_exist():
    with pytest.raises(ChainError, match="excited names DOF 4"):
        Chain(3).identifiability([4])


def test_a_strategy_that_does_not_exist():
    with pytest.raises(ChainError, match="strategy='best'"):
        Chain(3).identifiability([3], strategy="best")


def test_what_only_a_brace_scales_comes_after_what_a_storey_scales():
    """A brace carries a small part of the shear, and its errors would rule."""
    order = Chain(3, ["link 3-1"]).identifiability(1)
    assert [step.dofs for step in order.steps] == [(1,), (2,), (3,)]


# -- sensors on some floors ----------------------------------------------------


def test_sensors_everywhere_leave_the_least_errors():
    every = Chain(3).sensing(sensors=[1, 2, 3], excited=3)
    assert every.complete
    assert not every.gains
    assert set(every.errors.values()) == {1.0}


def test_one_more_sensor_lowers_the_largest_error():
    placement = Chain(4).sensing(sensors=4, excited=4)
    worst = max(placement.errors.values())
    floor = max(placement.gains, key=placement.gains.get)
    more = Chain(4).sensing(sensors=[floor, 4], excited=4)
    assert max(more.errors.values()) < worst
    assert f"floor {floor}" in str(placement)


def test_a_shaken_chain_has_no_scale_without_a_mass():
    shaken = Chain(3).sensing(sensors=[1, 2, 3])
    assert shaken.rank == shaken.unknowns - 1
    assert "Measure a force" in str(shaken)
    assert Chain(3).sensing(sensors=[1, 2, 3], known_masses=1).complete


def test_sensing_of_a_model_reads_its_masses_and_stiffnesses():
    storeys = {i: laws.LinearElastic(k=2e4 * i) for i in (1, 2, 3)}
    model = ChainModel([5.0, 6.0, 7.0], storeys)
    placement = model.chain.sensing(sensors=3, excited=3, model=model)
    assert placement.complete
    assert placement.errors != Chain(3).sensing(sensors=3, excited=3).errors


def test_sensing_needs_a_sensor():
    with pytest.raises(ChainError, match="No floor has a sensor"):
        Chain(3).sensing(sensors=[])
