"""Models fitted and judged fold by fold, and scans beside them."""

from dataclasses import replace

import numpy as np
import pytest
from loop_parts import (
    first_state,
    scanned_reduction,
    start_of,
)
from simulated_cases import Plan

from pysindy_nrf import ChainModel, Site, excitation, laws, simulate
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records import Dataset
from pysindy_nrf.simulation import add_noise

SHORT = Plan(3, (1, 2, 3), noise=0.02, seed=75, n_samples=4000)
STOREYS = [Site(f"storey {i}") for i in (1, 2, 3)]


@pytest.fixture(scope="module")
def state():
    """The linear chain of three floors."""
    return first_state(SHORT)


@pytest.fixture(scope="module")
def model(state):
    """Its model."""
    return state.model


def test_products_of_a_scan_serve_the_next_model(model):
    """Beside a further law they give the reductions of new products."""
    cubic, known = laws.CubicStiffness(), {}
    with_friction = model.with_laws([(STOREYS[2], laws.CoulombFriction())])
    for beside in (model, with_friction, model):
        anew = scanned_reduction(beside, STOREYS[1], cubic)
        again = scanned_reduction(beside, STOREYS[1], cubic, known)
        assert again == pytest.approx(anew, rel=1e-9)


NEVER_CLOSED = [(STOREYS[1], laws.TwoSidedGap(gap=1e3))]


def test_a_law_that_does_not_act_is_refused(model):
    with pytest.raises(NRFError, match="depend on each other"):
        model.with_laws(NEVER_CLOSED)


def test_a_force_with_some_unknown_samples_counts_where_it_is_known(model):
    """A corrected delay leaves samples at an end unknown: they are zero for spectra."""
    data = model.spectra.data
    segment = data.data.segments[0]
    forces = segment.F.copy()
    forces[segment.valid][:3, 0] = np.nan
    cut = Dataset([replace(segment, F=forces)], data.data.n_samples)

    measured = data.fixed([0])[data.n_dof]
    used = data.with_data(cut).fixed([0])[data.n_dof]
    assert not used[:3].any()
    np.testing.assert_array_equal(used[3:], measured[3:])


def test_every_balance_is_fitted_as_it_is_judged():
    """Near a resonance the truth must leave no less than the fit.

    Laws that are found twice, and judged by the other one, leave 10 % more.
    """
    storey = [laws.LinearElastic(1e5), laws.LinearViscous(5.0)]
    truth = ChainModel([10.0, 12.0], {1: storey, 2: storey})
    F = excitation.band_limited_random(
        2, 16.0, 250.0, excited=(1, 2), rms=100.0, band=(1, 40), random_state=0
    )
    exact = simulate(truth, F, 1 / 250, hold="cubic")
    model = start_of(add_noise(exact, 0.01, random_state=1)).first.model

    values = np.zeros_like(model.coefficients[:1])
    values[0, :4] = 5.0, 1e5, 5.0, 1e5
    true_rows, _ = model.solver.rows(np.array([[10.0, 12.0]]), values)
    rows, _ = model.solver.rows(model.masses[:1], model.coefficients[:1])
    fitted, true = (
        np.einsum("ik,ip,kpq,iq->i", model.weights, x[0], model.summed, x[0])
        for x in (rows, true_rows)
    )
    assert (fitted < 1.01 * true).all()
