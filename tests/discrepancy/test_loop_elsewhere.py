"""Two effects of which a third law, or a wrong gain of a force, imitates a part while both are missing."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pysindy_nrf import NRFRegressor, Record, close_loop, laws
from pysindy_nrf.simulation.noise import add_noise

pytestmark = pytest.mark.slow

FS, M, K, C = 250.0, np.array([6.0, 5.0, 4.0]), np.array([5e4, 4e4, 3e4]), np.array([60.0, 45.0, 36.0])
CATALOGUE = [
    laws.CoulombFriction(), laws.QuadraticDamping(), laws.CubicStiffness(), laws.OneSidedGap(), laws.TwoSidedGap(),
    laws.HarmonicForce(), laws.LinkSpringDashpot(), laws.GainError(), laws.ConstantForce(),
]  # fmt: skip


def swept(in_storeys, unmeasured=(0.0, 0.0, 0.0), at=11.0, size=40.0, duration=20.0, band=(1.0, 30.0)):
    """Three floors by DOP853 under sweeps on all of them, with a force of time and drifts more in the storeys and
    harmonic forces (N, of one frequency in Hz) that no channel tells of."""
    unmeasured, phases = np.asarray(unmeasured), np.array([0.0, 1.0, 2.2])

    def F(t):
        turn = 2 * np.pi * (band[0] * t + (band[1] - band[0]) / (2 * duration) * t**2)
        return size * np.cos(np.add.outer(turn, phases))

    def a_of(t, x, v):
        s, r = np.diff(x, prepend=0.0), np.diff(v, prepend=0.0)
        R = K * s + C * r + in_storeys(t, s)
        return (F(t) + unmeasured * np.sin(2 * np.pi * at * t) - R + np.append(R[1:], 0.0)) / M

    t = np.arange(int(duration * FS)) / FS
    run = solve_ivp(
        lambda t, y: np.concatenate([y[3:], a_of(t, y[:3], y[3:])]),
        (0, t[-1]), np.zeros(6), "DOP853", t, rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    x, v = run.y[:3].T, run.y[3:].T
    a = np.array([a_of(*row) for row in zip(t, x, v)])
    return Record(force=F(t), acceleration=a, velocity=v, displacement=x, fs=FS)


def quiet_loop(record, catalogue=CATALOGUE):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return close_loop(add_noise(record, 0.003, random_state=0), NRFRegressor(degree=1), catalogue=catalogue)


def bumper(gap, k=6e4):
    return lambda t, s: np.array([0.0, 0.0, k * max(s[2] - gap, 0.0)])


def found(report):
    return {(step.law, step.site): step for step in report.steps}


@pytest.mark.parametrize("gap", [1.5e-3, 5e-4])
def test_a_motor_and_a_bumper_are_not_taken_for_a_wrong_gain_of_a_force(gap):
    """Under sweeps the gain of the force at the motor's floor imitates both at first. A gap of 0.5 mm shows in no
    balance while the motor is missing, and the motor alone explains less than the gate asks."""
    report = quiet_loop(swept(bumper(gap), (0.0, 40.0, 0.0)))
    steps = found(report)
    assert set(steps) == {("harmonic_force", "dof 2"), ("one_sided_gap", "storey 3")} and all(s.sure for s in report.steps)
    motor, stop = steps["harmonic_force", "dof 2"].parameters, steps["one_sided_gap", "storey 3"].parameters
    assert motor["frequency"] == pytest.approx(11.0, rel=1e-3)
    assert np.hypot(motor["A"], motor["B"]) == pytest.approx(40.0, rel=0.05)
    assert stop["gap"] == pytest.approx(gap, rel=0.05) and stop["k"] == pytest.approx(6e4, rel=0.05)
    assert "all effects that begin with gain_error at sensor F2 leave" in report.steps[0].evidence
    assert report.table["held-out"].iloc[-1] < 0.1 * report.table["held-out"].iloc[0]
    assert report.model.masses == pytest.approx(M, rel=0.02)


def test_a_gain_that_is_wrong_stays_a_wrong_gain_beside_a_bumper():
    record = swept(bumper(1.5e-3))
    force = record.force.copy()
    force[:, 1] *= 1.15
    report = quiet_loop(record.replace(force=force))
    steps = found(report)
    assert set(steps) == {("gain_error", "sensor F2"), ("one_sided_gap", "storey 3")}
    assert steps["gain_error", "sensor F2"].parameters["e"] == pytest.approx(0.15, abs=0.02)
    assert report.model.masses == pytest.approx(M, rel=0.02)


def test_shapes_that_stood_in_for_a_missing_effect_are_found_again_before_the_next_is_judged():
    """A stiffness that sinks by a third over the record; the gap that was found without it is wide of the mark."""
    catalogue = [*CATALOGUE, laws.StiffnessDrift(), laws.StiffnessStep()]
    report = quiet_loop(
        swept(lambda t, s: np.array([-2.0e4 * t / 20.0 * s[0], 0.0, 3e4 * np.sign(s[2]) * max(abs(s[2]) - 1.5e-3, 0.0)])),
        catalogue,
    )
    steps = found(report)
    assert {("stiffness_drift", "storey 1"), ("two_sided_gap", "storey 3")} <= set(steps)
    stop = steps["two_sided_gap", "storey 3"].parameters
    assert stop["gap"] == pytest.approx(1.5e-3, rel=0.05) and stop["k"] == pytest.approx(3e4, rel=0.05)
    assert steps["stiffness_drift", "storey 1"].parameters["kt"] == pytest.approx(-1e3, rel=0.1)
