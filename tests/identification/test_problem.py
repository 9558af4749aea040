"""The identification problem: what it refuses, what it derives, and that it and
NRFRegressor give one answer.
"""

import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainOptimizer, NRFRegressor, Problem, datasets, laws
from pysindy_nrf.exceptions import ChainError, ExcitationError, IdentifiabilityError

LINEAR = (laws.PowerSeries(1),)


def storeys(n, law=LINEAR):
    return {f"storey {i}": law for i in range(1, n + 1)}


def test_the_problem_of_an_estimator_gives_its_answer():
    record = datasets.load_demo()
    given = dict(
        laws={"storey 2": laws.PowerSeries(1)}, known_masses={2: 10.0}, band=(1.0, 60.0)
    )
    estimator = NRFRegressor(degree=3, estimation="ls", **given)
    found = estimator.problem(3).solve(record)
    estimator.fit(record)
    np.testing.assert_allclose(found.model.masses, estimator.masses_, rtol=1e-12)
    for site, values in estimator.model_.coefficients.items():
        np.testing.assert_allclose(found.model.coefficients[site], values, rtol=1e-12)
    np.testing.assert_allclose(
        estimator.problem_.solve(record).model.masses, estimator.masses_, rtol=1e-12
    )


def test_a_problem_is_a_value_that_does_not_change():
    problem = Problem(Chain(2), storeys(2), {2: 12.0})
    with pytest.raises(FrozenInstanceError):
        problem.strategy = "joint"
    with pytest.raises(TypeError):
        problem.known_masses[1] = 3.0
    other = problem.with_known_masses({1: 3.0})
    assert dict(problem.known_masses) == {2: 12.0} and dict(other.known_masses) == {
        1: 3.0
    }
    cubic = problem.with_laws({"storey 1": [laws.PowerSeries(3)]})
    assert (
        cubic.layout.n_terms > problem.layout.n_terms
        and problem.laws["storey 1"] == LINEAR
    )
    assert pickle.loads(pickle.dumps(problem)).known_masses == problem.known_masses


def test_links_join_the_chain_and_a_storey_without_laws_transmits_no_force():
    problem = Problem(
        Chain(3), {"link 3-1": LINEAR, "storey 1": LINEAR, "storey 3": LINEAR}
    )
    assert (
        problem.chain == Chain(3, links=["link 3-1"]) and problem.laws["storey 2"] == ()
    )
    assert [str(s) for s in problem.layout.acting] == [
        "storey 1",
        "storey 3",
        "link 3-1",
    ]


def test_the_order_of_the_solve_follows_from_what_is_excited():
    problem = Problem(Chain(2), storeys(2))
    assert problem.solve_order([1, 2]).strategy == "joint"
    assert replace(problem, excited=[2]).solve_order([1, 2]).strategy == "sequential"
    with pytest.raises(ExcitationError, match="known_masses"):
        problem.solve_order([])
    with pytest.raises(IdentifiabilityError, match="m1 cannot be found"):
        problem.solve_order([2], unknown=[1])


def test_a_chain_optimizer_stands_for_the_one_inside_it():
    assert Problem(Chain(1), storeys(1), optimizer=ChainOptimizer()).optimizer is None


@pytest.mark.parametrize(
    "known, said",
    [
        ({3: 1.0}, "DOF 3"),
        ({1: -1.0}, "is not a mass"),
        ({1: "heavy"}, "is not a mass"),
        ([1.0], "mapping"),
    ],
)
def test_known_masses_that_cannot_be_are_refused(known, said):
    with pytest.raises(ChainError, match=said):
        Problem(Chain(2), storeys(2), known)
