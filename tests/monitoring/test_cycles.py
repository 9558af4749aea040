"""Indicators of damage by storey and cycle, of storeys whose loops are known."""

import json

import numpy as np
import pytest

from pysindy_nrf import Record
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.monitoring import storey_cycles

FS = 400.0
MASS = 10.0
K = 4e4
AMPLITUDE = 0.02
OMEGA = 2 * np.pi
T = np.arange(int(8 * FS)) / FS
MOTION = AMPLITUDE * np.minimum(T / 2, 1.0) * np.sin(OMEGA * T)


def driven(storey_force, drift=MOTION, rate=None):
    """One mass that is driven along a drift by whatever force that takes."""
    rate = np.gradient(drift, 1 / FS) if rate is None else rate
    acceleration = np.gradient(rate, 1 / FS)
    return Record(
        force=(MASS * acceleration + storey_force)[:, None],
        acceleration=acceleration[:, None],
        velocity=rate[:, None],
        displacement=drift[:, None],
        fs=FS,
    )


def elasto_plastic(drift, yield_drift):
    """Force of a spring that yields."""
    force = np.zeros_like(drift)
    for i in range(1, len(drift)):
        trial = force[i - 1] + K * (drift[i] - drift[i - 1])
        force[i] = np.clip(trial, -K * yield_drift, K * yield_drift)
    return force


def steady(cycles):
    """Cycles after the motion has grown."""
    return cycles.table[cycles.table["start"] > 2.2]


def test_a_linear_storey_loses_nothing_and_dissipates_by_its_damping():
    rate = np.gradient(MOTION, 1 / FS)
    cycles = storey_cycles(driven(K * MOTION + 60.0 * rate), {1: MASS})
    of_a_cycle = 60.0 * np.pi * OMEGA * AMPLITUDE**2
    rows = steady(cycles)
    assert rows["stiffness"].to_numpy() == pytest.approx(K, rel=2e-3)
    assert rows["loss"].abs().max() < 0.3
    assert rows["energy"].to_numpy() == pytest.approx(of_a_cycle, rel=0.02)
    assert rows["plastic"].abs().max() < 0.02 * AMPLITUDE


def test_a_storey_that_yields_travels_as_far_as_theory_says():
    yield_drift = 0.012
    force = elasto_plastic(MOTION, yield_drift)
    rows = steady(storey_cycles(driven(force), {1: MASS}))
    plastic = 4 * (AMPLITUDE - yield_drift)
    assert np.diff(rows["plastic"]) == pytest.approx(plastic, rel=0.05)
    work = K * yield_drift * plastic
    assert rows["energy"].to_numpy() == pytest.approx(work, rel=0.05)
    assert (rows["loss"] > 10).all()


def test_a_hardening_spring_is_not_plastic():
    cubic = K * MOTION * (1 + 0.5 * (MOTION / AMPLITUDE) ** 2)
    rows = steady(storey_cycles(driven(cubic), {1: MASS}))
    path = 4 * AMPLITUDE * len(rows)
    assert rows["plastic"].abs().max() < 0.01 * path


def test_a_loss_of_stiffness_is_seen_from_its_cycle_on():
    k = np.where(T < 4.25, K, 0.8 * K)
    cycles = storey_cycles(driven(k * MOTION), {1: MASS})
    before = cycles.table[cycles.table["end"] < 4.25]
    after = cycles.table[cycles.table["start"] > 4.25]
    assert before["loss"].abs().max() < 0.5
    assert after["loss"].to_numpy() == pytest.approx(20.0, abs=0.5)
    total = cycles.storeys.iloc[0]
    assert total["loss_lower"] <= 20.0 <= total["loss_upper"] + 0.2


def test_a_loop_about_another_drift_is_residual():
    lasting = 0.004 / (1 + np.exp(-20 * (T - 4.0)))
    drift = MOTION + lasting
    rows = storey_cycles(driven(K * MOTION, drift), {1: MASS}).table
    assert rows[rows["start"] > 5]["residual"].to_numpy() == pytest.approx(
        0.004, rel=0.02
    )


def test_forces_are_those_of_all_masses_above():
    """Two floors of which the upper one moves with the lower: 2 m on one spring."""
    alone = driven(K * MOTION)
    acceleration = np.repeat(alone.acceleration, 2, axis=1)
    force = np.column_stack([K * MOTION + MASS * acceleration[:, 0]] * 2)
    upper = 0.5 * MOTION
    force[:, 0] = MASS * acceleration[:, 0] + K * MOTION - 2 * K * upper
    acceleration[:, 1] += np.gradient(np.gradient(upper, 1 / FS), 1 / FS)
    force[:, 1] = MASS * acceleration[:, 1] + 2 * K * upper
    record = Record(
        force=force,
        acceleration=acceleration,
        displacement=np.column_stack([MOTION, MOTION + upper]),
        fs=FS,
    )
    cycles = storey_cycles(record, {1: MASS, 2: MASS})
    stiffness = cycles.storeys.set_index("storey")["stiffness"]
    assert stiffness["storey 1"] == pytest.approx(K, rel=0.01)
    assert stiffness["storey 2"] == pytest.approx(2 * K, rel=0.01)


def test_tables_are_json_and_drawn():
    cycles = storey_cycles(driven(K * MOTION), {1: MASS})
    content = json.loads(cycles.to_json())
    assert len(content["cycles"]) == len(cycles.table)
    assert content["storeys"][0]["storey"] == "storey 1"
    assert len(cycles.plot().figure_.axes) >= 4


def test_a_mass_that_is_missing_is_named():
    with pytest.raises(ChainError, match="DOF 1"):
        storey_cycles(driven(K * MOTION), {})
