"""Dry friction where sites come to rest and start to slip: by hand, and whatever the order of the sites."""

from __future__ import annotations

import numpy as np
import pytest

from pysindy_nrf import Chain, ChainModel, laws
from pysindy_nrf.simulation import free_run

METHODS = pytest.mark.parametrize("method", ["default", "rk4"])


def rubbing(force):
    return [laws.CoulombFriction(force)]


@METHODS
def test_a_slip_that_ends_within_one_step(method):
    """1 kg on a floor with 10 N of friction; 12 N that fall to 0 within a sample move it by dt^2 / 27 and no more."""
    dt, F = 0.01, np.zeros((6, 1))
    F[0] = 12.0
    run = free_run(ChainModel([1.0], {1: rubbing(10.0)}), F, dt, method=method)
    np.testing.assert_allclose(run.record.displacement[1:, 0], dt**2 / 27, rtol=1e-6)
    assert np.array_equal(run.record.velocity, np.zeros((6, 1))) and run.energy_gap < 1e-9


@METHODS
def test_a_floor_that_its_neighbour_relieves_stays_at_rest(method):
    """10 N on floor 2: storey 2 slips at 5 N, and storey 1, which holds 8 N, does not move."""
    F = np.zeros((101, 2))
    F[:, 1] = 10.0
    run = free_run(ChainModel([1.0, 1.0], {1: rubbing(8.0), 2: rubbing(5.0)}), F, 0.01, method=method)
    assert not run.record.displacement[:, 0].any() and not run.record.acceleration[:, 0].any()
    t = np.arange(101) * 0.01
    np.testing.assert_allclose(run.record.displacement[:, 1], 0.5 * (10.0 - 5.0) * t**2, atol=1e-9)


def test_the_order_of_sites_that_form_a_loop_does_not_matter():
    rng = np.random.default_rng(1)
    F = np.cumsum(rng.normal(size=(401, 3)), axis=0) * 2.0
    F -= np.linspace(0, 1, 401)[:, None] * F[-1]
    held = {
        "storey 1": [laws.PowerSeries(1, [10.0, 3e3]), *rubbing(6.0)],
        "storey 2": [laws.PowerSeries(1, [8.0, 2e3]), *rubbing(3.0)],
        "storey 3": [laws.PowerSeries(1, [8.0, 2e3])],
        "ground 2": rubbing(4.0),
    }
    runs = []
    for order in (list(held), list(held)[::-1]):
        model = ChainModel([2.0, 3.0, 1.5], {s: held[s] for s in order}, chain=Chain(3, links=["ground 2"]))
        model.laws = {model.chain.site(s): model.laws[model.chain.site(s)] for s in order}
        run = free_run(model, F, 0.005)
        assert run.energy_gap < 1e-9
        runs.append(run.record.displacement)
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-7 * np.abs(runs[0]).max())
