"""The identification problem: what it refuses and derives, and that it gives the answer
of its estimator.
"""

import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainOptimizer, NRFRegressor, Problem, datasets, laws
from pysindy_nrf.exceptions import (
    ChainError,
    ExcitationError,
    IdentifiabilityError,
    LawError,
)

LINEAR = (laws.PowerSeries(1),)


def linear_chain(n, **known):
    storeys = {f"storey {i}": LINEAR for i in range(1, n + 1)}
    return Problem(Chain(n), storeys, **known)


def assert_same(model, other):
    np.testing.assert_allclose(model.masses, other.masses, rtol=1e-12)
    for site, values in other.coefficients.items():
        np.testing.assert_allclose(model.coefficients[site], values, rtol=1e-12)


def test_the_problem_of_an_estimator_gives_its_answer():
    record = datasets.load_demo()
    estimator = NRFRegressor(
        estimation="ls",
        laws={"storey 2": laws.PowerSeries(1)},
        known_masses={2: 10.0},
        band=(1.0, 60.0),
    )
    model = estimator.fit(record).model_
    assert_same(estimator.problem(3).solve(record).model, model)
    assert_same(estimator.problem_.solve(record).model, model)


def test_a_problem_does_not_change():
    problem = linear_chain(2, known_masses={2: 12.0})
    with pytest.raises(FrozenInstanceError):
        problem.strategy = "joint"
    with pytest.raises(TypeError):
        problem.known_masses[1] = 3.0


def test_other_masses_or_laws_give_another_problem():
    problem = linear_chain(2, known_masses={2: 12.0})
    other = problem.with_known_masses({1: 3.0})
    assert dict(problem.known_masses) == {2: 12.0}
    assert dict(other.known_masses) == {1: 3.0}

    cubic = problem.with_laws({"storey 1": [laws.PowerSeries(3)]})
    assert cubic.layout.n_terms > problem.layout.n_terms
    assert problem.laws["storey 1"] == LINEAR


def test_a_problem_survives_pickling():
    problem = linear_chain(2, known_masses={2: 12.0})
    again = pickle.loads(pickle.dumps(problem))
    assert again.known_masses == problem.known_masses
    assert again.laws == problem.laws


@pytest.mark.parametrize(
    "estimation",
    ["ls", "iv", "auto", pytest.param("simulation", marks=pytest.mark.slow)],
)
def test_a_constant_force_is_refused_in_a_band_without_0_hz(estimation):
    laws_of_sites = {i: [laws.PowerSeries(1)] for i in (1, 2, 3)}
    laws_of_sites["dof 2"] = [laws.ConstantForce()]
    estimator = NRFRegressor(laws=laws_of_sites, estimation=estimation)
    record = datasets.load_demo()
    estimator.set_params(band=(None, 60.0)).fit(record)
    with pytest.raises(LawError, match=r"constant_force at dof 2 .* 1 Hz"):
        estimator.set_params(band=(1.0, 60.0)).fit(record)


def test_links_join_the_chain():
    sites = ["link 3-1", "storey 1", "storey 3"]
    problem = Problem(Chain(3), dict.fromkeys(sites, LINEAR))
    assert problem.chain == Chain(3, links=["link 3-1"])
    acting = [str(site) for site in problem.layout.acting]
    assert acting == ["storey 1", "storey 3", "link 3-1"]


def test_a_storey_without_laws_transmits_no_force():
    problem = Problem(Chain(3), {"storey 1": LINEAR, "storey 3": LINEAR})
    assert problem.laws["storey 2"] == ()


def test_the_order_of_the_solve_follows_from_what_is_excited():
    problem = linear_chain(2)
    assert problem.solve_order([1, 2]).strategy == "joint"
    one_force = replace(problem, excited=[2])
    assert one_force.solve_order([1, 2]).strategy == "sequential"


def test_what_cannot_be_solved_is_refused():
    problem = linear_chain(2)
    with pytest.raises(ExcitationError, match="known_masses"):
        problem.solve_order([])
    with pytest.raises(IdentifiabilityError, match="m1 cannot be found"):
        problem.solve_order([2], unknown=[1])


def test_a_chain_optimizer_stands_for_the_one_inside_it():
    assert linear_chain(1, optimizer=ChainOptimizer()).optimizer is None


@pytest.mark.parametrize(
    ("known_masses", "message"),
    [
        ({3: 1.0}, "DOF 3"),
        ({1: -1.0}, "is not a mass"),
        ({1: "heavy"}, "is not a mass"),
        ([1.0], "mapping"),
    ],
)
def test_known_masses_that_cannot_be_are_refused(known_masses, message):
    with pytest.raises(ChainError, match=message):
        linear_chain(2, known_masses=known_masses)
