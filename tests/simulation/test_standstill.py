"""Dry friction where sites come to rest and start to slip: by hand, and whatever the
order of the sites.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import Chain, ChainModel, excitation, laws, simulate
from pysindy_nrf.diagnosis.verdict import free_runs
from pysindy_nrf.exceptions import SimulationError
from pysindy_nrf.simulation import free_run


def rubbing(force):
    return [laws.CoulombFriction(force)]


def test_a_slip_that_ends_within_one_step():
    """1 kg on a floor with 10 N of friction; 12 N that fall to 0 within a sample move
    it by dt^2 / 27 and no more.
    """
    dt, F = 0.01, np.zeros((6, 1))
    F[0] = 12.0
    run = free_run(ChainModel([1.0], {1: rubbing(10.0)}), F, dt)
    np.testing.assert_allclose(run.record.displacement[1:, 0], dt**2 / 27, rtol=1e-6)
    assert (
        np.array_equal(run.record.velocity, np.zeros((6, 1))) and run.energy_gap < 1e-9
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slip_between_two_samples(sign):
    """A spline through 0, 9.8, 9.8, 0 N peaks near 11.8 N: 10 N of friction hold it at
    the samples, not between.
    """
    dt, F = 0.01, np.zeros((12, 1))
    F[5:7] = 9.8 * sign
    course = CubicSpline(dt * np.arange(12), sign * F[:, 0])
    begins, ends = course.solve(10.0)[-2:]
    assert dt * 5 < begins < ends < dt * 6

    def rests(t, y):
        return y[1]

    rests.terminal, rests.direction = True, -1
    slip = solve_ivp(
        lambda t, y: [y[1], (course(t) - 10.0 - 1e3 * y[0]) / 10.0],
        (begins, 0.11),
        [0.0, 0.0],
        "DOP853",
        events=rests,
        rtol=1e-12,
        atol=1e-16,
    )
    model = ChainModel([10.0], {1: [laws.LinearElastic(1e3), *rubbing(10.0)]})
    run = free_run(model, F, dt, hold="cubic")
    np.testing.assert_allclose(
        run.record.displacement[7:, 0], sign * slip.y[0, -1], rtol=1e-3
    )
    assert (
        slip.y[0, -1] > 1e-6
        and not run.record.displacement[:6].any()
        and run.energy_gap < 1e-9
    )
    assert not free_run(
        model, F, dt
    ).record.displacement.any()  # straight lines never reach 10 N


def test_a_floor_that_its_neighbour_relieves_stays_at_rest():
    """10 N on floor 2: storey 2 slips at 5 N, and storey 1, which holds 8 N, does not
    move.
    """
    F = np.zeros((101, 2))
    F[:, 1] = 10.0
    run = free_run(ChainModel([1.0, 1.0], {1: rubbing(8.0), 2: rubbing(5.0)}), F, 0.01)
    assert (
        not run.record.displacement[:, 0].any()
        and not run.record.acceleration[:, 0].any()
    )
    t = np.arange(101) * 0.01
    np.testing.assert_allclose(
        run.record.displacement[:, 1], 0.5 * (10.0 - 5.0) * t**2, atol=1e-9
    )


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
        model = ChainModel(
            [2.0, 3.0, 1.5],
            {s: held[s] for s in order},
            chain=Chain(3, links=["ground 2"]),
        )
        model.laws = {
            model.chain.site(s): model.laws[model.chain.site(s)] for s in order
        }
        run = free_run(model, F, 0.005)
        assert run.energy_gap < 1e-9
        runs.append(run.record.displacement)
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-7 * np.abs(runs[0]).max())


def test_a_run_that_chatters_without_end_is_given_up_aloud():
    """A bristle that sticks beside a friction that sticks, at one site: no step is
    short enough.
    """
    storey = [
        laws.PowerSeries(1, [1.4e5, 2.1e8]),
        laws.CoulombFriction(1800.0),
        laws.LuGre(Fc=550.0, sigma=9.6e6, vs=0.006, ratio=2.5, sigma1=2.1e6),
    ]
    model = ChainModel([45e3], {1: storey})
    F = excitation.band_limited_random(
        1, 8.0, 500.0, excited=[1], rms=2e4, band=(0.5, 40.0), random_state=0
    )
    with pytest.raises(SimulationError, match="more than 250 steps a sample"):
        simulate(model, F, 1 / 500)
    stepwise = simulate(model, F, 1 / 500, method="newmark")  # as the error says
    runs = free_runs(
        model, model.segments(stepwise)
    )  # a verdict runs by either method before it calls a model divergent
    assert runs.error < 1.0 and not runs.failed


def test_a_memory_waits_for_a_blow_however_small_the_ripples_before_it():
    """A spline through a force that is zero for long ripples down to the smallest
    numbers there are.
    """
    storey = [
        laws.LinearElastic(1.4e5),
        laws.LinearViscous(20.0),
        laws.PinchedBoucWen(alpha=1e6, beta=5e4, slip=0.0, width=0.1),
    ]
    model, blow = ChainModel([12.0], {1: storey}), np.zeros((900, 1))
    blow[700:720, 0] = 900.0 * np.hanning(20)
    run, late = (
        free_run(model, F, 1 / 1024, hold="cubic").record.displacement
        for F in (blow, blow[650:])
    )
    np.testing.assert_allclose(run[650:], late, atol=1e-6 * np.abs(late).max())
