"""Zeros, corners and drifts of sensors are no effects."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from pysindy_nrf import ChainModel, close_loop, excitation, laws, simulate
from pysindy_nrf.simulation import add_noise

FS = 250.0
LINEAR = [laws.LinearElastic(6e4), laws.LinearViscous(60.0)]
TRIED = [
    laws.CoulombFriction(),
    laws.QuadraticDamping(),
    laws.QuadraticStiffness(),
    laws.CubicStiffness(),
    laws.OneSidedGap(),
    laws.MaxwellBranch(),
    laws.Dahl(),
    laws.LinkSpringDashpot(),
    laws.SensorOffset(),
]
pytestmark = pytest.mark.filterwarnings("ignore")


def clean_test(law=None):
    """Half a minute of two floors, shaken on the upper one, a law in storey 2."""
    second = LINEAR if law is None else [*LINEAR, law]
    truth = ChainModel([70.0, 60.0], {1: LINEAR, 2: second})
    F = excitation.band_limited_random(
        2, 30.0, FS, excited=[2], rms=80.0, band=(0.9, 25), random_state=5
    )
    return simulate(truth, F, 1 / FS, hold="cubic").replace(velocity=None)


def noisy(record):
    return add_noise(record, 0.004, random_state=6)


def with_wrong_zeros(record):
    zeros = 0.015 * record.displacement.std(axis=0) * [1.0, -1.0]
    return record.replace(displacement=record.displacement + zeros, force=record.force)


def kinds(report):
    return {note.kind for note in report.quality}


def test_wrong_zeros_are_notes_and_no_effects():
    report = close_loop(noisy(with_wrong_zeros(clean_test())), catalogue=TRIED)

    assert not report.steps
    assert report.verdict.state == "green"
    assert kinds(report) == {"offset"}
    places = {note.channel for note in report.quality}
    assert places == {"dof 1", "dof 2"}


@pytest.mark.slow
def test_a_law_that_sees_the_zero_is_found_beside_wrong_ones():
    law = laws.OneSidedGap(gap=5e-4, k=4e4)
    clean = clean_test(law)
    for record in (clean, with_wrong_zeros(clean)):
        report = close_loop(noisy(record), catalogue=TRIED)
        (step,) = report.steps
        assert (step.law, step.site, step.confirmed) == (law.name, "storey 2", True)
        assert report.free_runs.error < 1.0


def test_a_constant_force_is_found_where_it_is_asked_for():
    """20 N on the right-hand side are -20 N on the left."""
    clean = clean_test()
    record = clean.replace(force=clean.force - [0.0, 20.0])
    report = close_loop(noisy(record), catalogue=[*TRIED, laws.ConstantForce()])

    (step,) = report.steps
    assert step.law == "constant_force"
    assert step.parameters["f0"] == pytest.approx(-20.0, rel=0.02)
    assert kinds(report) == set()


def test_filtered_channels_are_no_relaxation():
    clean = clean_test()
    high_pass = butter(1, 0.6, "high", fs=FS, output="sos")
    record = clean.replace(
        acceleration=sosfilt(high_pass, clean.acceleration, axis=0),
        force=sosfilt(high_pass, clean.force, axis=0),
    )
    report = close_loop(noisy(record), catalogue=TRIED)

    assert not report.steps
    assert report.verdict.state == "amber"
    corners = {note.channel: note.size for note in report.quality}
    assert set(corners) == {"a1", "a2", "F2"}
    assert list(corners.values()) == pytest.approx([0.6] * 3, rel=0.1)


def test_a_wandering_displacement_is_no_force():
    clean = clean_test(laws.CoulombFriction(15.0))
    steps = np.random.default_rng(9).standard_normal((clean.n_samples, 2))
    walk = np.cumsum(steps, axis=0) / np.sqrt(clean.n_samples)
    drift = 0.15 * clean.displacement.std() * walk
    record = clean.replace(displacement=clean.displacement + drift)
    report = close_loop(noisy(record), catalogue=TRIED)

    (step,) = report.steps
    assert step.confirmed
    assert step.closest == "coulomb_friction"
    assert report.verdict.state == "amber"
    assert kinds(report) == {"drift"}
