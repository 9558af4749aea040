"""Dry friction where sites come to rest and start to slip."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pysindy_nrf import Chain, ChainModel, excitation, laws, simulate
from pysindy_nrf.equations import free_run_by_either
from pysindy_nrf.exceptions import SimulationError
from pysindy_nrf.simulation import free_run

DT = 0.01  # s
RUBBING = laws.CoulombFriction(10.0)


def test_a_slip_that_ends_within_one_step():
    """12 N that fall to 0 in a sample move 1 kg against 10 N by dt^2 / 27."""
    F = np.zeros((6, 1))
    F[0] = 12.0
    run = free_run(ChainModel([1.0], {1: RUBBING}), F, DT, hold="linear")
    np.testing.assert_allclose(run.record.displacement[1:, 0], DT**2 / 27, rtol=1e-6)
    assert not run.record.velocity.any()
    assert run.energy_gap < 1e-9


# 9.8 N in two samples are 11.8 N between them by a spline: 10 N of friction hold them
# at the samples, not between.
SPRING = [laws.LinearElastic(1e3), RUBBING]


def force_between_samples(sign):
    F = np.zeros((12, 1))
    F[5:7] = 9.8 * sign
    return F


def slip_by_scipy():
    """How far 10 kg slip between samples 5 and 6."""
    course = CubicSpline(DT * np.arange(12), force_between_samples(1.0)[:, 0])
    begins, ends = course.solve(10.0)[-2:]
    assert DT * 5 < begins < ends < DT * 6

    def rates(t, y):
        x, v = y
        return [v, (course(t) - 10.0 - 1e3 * x) / 10.0]

    def rate_of_slip(t, y):
        return y[1]

    rate_of_slip.terminal = True
    rate_of_slip.direction = -1
    run = solve_ivp(
        rates,
        (begins, 0.11),
        [0.0, 0.0],
        "DOP853",
        events=rate_of_slip,
        rtol=1e-12,
        atol=1e-16,
    )
    return run.y[0, -1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slip_between_two_samples(sign):
    F = force_between_samples(sign)
    run = free_run(ChainModel([10.0], {1: SPRING}), F, DT, hold="cubic")
    slip = slip_by_scipy()
    assert slip > 1e-6
    np.testing.assert_allclose(run.record.displacement[7:, 0], sign * slip, rtol=1e-3)
    assert not run.record.displacement[:6].any()
    assert run.energy_gap < 1e-9


def test_straight_lines_between_these_samples_slip_nowhere():
    F = force_between_samples(1.0)
    run = free_run(ChainModel([10.0], {1: SPRING}), F, DT, hold="linear")
    assert not run.record.displacement.any()


def test_a_floor_that_its_neighbour_relieves_stays_at_rest():
    """10 N on floor 2: storey 2 slips at 5 N, storey 1 would hold 8 N."""
    F = np.zeros((101, 2))
    F[:, 1] = 10.0
    by_storey = {1: laws.CoulombFriction(8.0), 2: laws.CoulombFriction(5.0)}
    run = free_run(ChainModel([1.0, 1.0], by_storey), F, DT)
    t = np.arange(101) * DT
    expected = 0.5 * (10.0 - 5.0) * t**2
    np.testing.assert_allclose(run.record.displacement[:, 1], expected, atol=1e-9)
    assert not run.record.displacement[:, 0].any()
    assert not run.record.acceleration[:, 0].any()


LOOP = {
    "storey 1": [laws.PowerSeries(1, [10.0, 3e3]), laws.CoulombFriction(6.0)],
    "storey 2": [laws.PowerSeries(1, [8.0, 2e3]), laws.CoulombFriction(3.0)],
    "storey 3": [laws.PowerSeries(1, [8.0, 2e3])],
    "ground 2": [laws.CoulombFriction(4.0)],
}


def loop_in_order(sites):
    """Three floors whose floor 2 rubs against the ground, with sites in an order."""
    chain = Chain(3, links=["ground 2"])
    model = ChainModel([2.0, 3.0, 1.5], LOOP, chain=chain)
    model.laws = {chain.site(site): model.laws[chain.site(site)] for site in sites}
    return model


def test_the_order_of_sites_that_form_a_loop_does_not_matter():
    rng = np.random.default_rng(1)
    F = np.cumsum(rng.normal(size=(401, 3)), axis=0) * 2.0
    F -= np.linspace(0, 1, 401)[:, None] * F[-1]
    forward = free_run(loop_in_order(LOOP), F, 0.005)
    backward = free_run(loop_in_order(reversed(LOOP)), F, 0.005)
    assert forward.energy_gap < 1e-9
    assert backward.energy_gap < 1e-9
    x = forward.record.displacement
    tolerance = 1e-7 * np.abs(x).max()
    np.testing.assert_allclose(backward.record.displacement, x, atol=tolerance)


# -- hard cases ----------------------------------------------------------------


def test_a_run_that_chatters_without_end_is_given_up():
    """A bristle and a friction stick side by side: no step is short enough."""
    storey = [
        laws.PowerSeries(1, [1.4e5, 2.1e8]),
        laws.CoulombFriction(1800.0),
        laws.LuGre(Fc=550.0, sigma=9.6e6, vs=0.006, ratio=2.5, sigma1=2.1e6),
    ]
    model = ChainModel([45e3], {1: storey})
    F = excitation.band_limited_random(
        1, 8.0, 500.0, excited=[1], rms=2e4, band=(0.5, 40.0), random_state=0
    )
    with pytest.raises(SimulationError, match="more than 250 steps"):
        simulate(model, F, 1 / 500)

    # the cure of the error, which a verdict takes by itself
    by_newmark = simulate(model, F, 1 / 500, method="newmark")
    (segment,) = model.segments(by_newmark).segments
    segment = replace(segment, simulation_method="default")
    by_either = free_run_by_either(model, segment, segment.valid)
    assert by_either.by_newmark
    assert not by_either.diverges
    error = by_either.record.displacement - by_newmark.displacement
    assert np.abs(error).max() < 0.01 * np.abs(by_newmark.displacement).max()


def test_a_memory_waits_for_a_blow_however_small_the_ripples_before_it():
    """A spline through a force of zero ripples down to the smallest numbers."""
    storey = [
        laws.LinearElastic(1.4e5),
        laws.LinearViscous(20.0),
        laws.PinchedBoucWen(alpha=1e6, beta=5e4, slip=0.0, width=0.1),
    ]
    model = ChainModel([12.0], {1: storey})
    blow = np.zeros((900, 1))
    blow[700:720, 0] = 900.0 * np.hanning(20)
    displacement = free_run(model, blow, 1 / 1024, hold="cubic").record.displacement
    late = free_run(model, blow[650:], 1 / 1024, hold="cubic").record.displacement
    np.testing.assert_allclose(displacement[650:], late, atol=1e-6 * np.abs(late).max())
