"""Records that drift to one side, start in a running test, or are harmonic."""

import numpy as np
import pytest

from pysindy_nrf import (
    ChainModel,
    NRFRegressor,
    Record,
    close_loop,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.equations.shape_search import driving_lines, spectral_lines
from pysindy_nrf.simulation import add_noise


def one_sided_drift(t):
    """Drift, rate and acceleration of a motion between 0 and 0.24 m."""
    x = 0.12 * (1 - 0.6 * np.cos(1.7 * t) - 0.4 * np.cos(4.1 * t))
    v = 0.12 * (0.6 * 1.7 * np.sin(1.7 * t) + 0.4 * 4.1 * np.sin(4.1 * t))
    a = 0.12 * (0.6 * 1.7**2 * np.cos(1.7 * t) + 0.4 * 4.1**2 * np.cos(4.1 * t))
    return x, v, a


def test_along_a_drift_of_one_sign_an_offset_goes_before_a_curved_spring():
    fs = 500.0
    x, v, a = one_sided_drift(np.arange(20 * int(fs)) / fs)
    force = 90 * a + 200 * v - 6.0 + 20 * np.sign(v)
    force += 0.02 * force.std() * np.random.default_rng(2).standard_normal(len(force))
    tried = [
        laws.CoulombFriction(),
        laws.ConstantForce(),
        laws.QuadraticStiffness(),
        laws.AbsoluteQuadraticStiffness(),
        laws.OneSidedGap(),
        laws.CubicStiffness(),
    ]
    record = Record(force=force, displacement=x, fs=fs)
    report = close_loop(record, NRFRegressor(degree=1), tried, band=(None, 20.0))
    first, second = report.steps[:2]
    assert (first.law, second.law) == ("coulomb_friction", "constant_force")
    assert first.parameters["Fc"] == pytest.approx(20, rel=0.05)


@pytest.mark.slow
def test_a_record_cut_out_of_a_running_test_keeps_its_memory():
    true = {"beta": 800.0, "rho": -0.4, "n": 1.5, "alpha": 5e4}
    storey = [laws.LinearElastic(5e4), laws.LinearViscous(10.0), laws.BoucWen(**true)]
    F = excitation.band_limited_random(
        1, 9.0, 2000.0, excited=1, rms=100.0, band=(5, 60), random_state=1
    )
    record = simulate(ChainModel([2.0], {1: storey}), F, 1 / 2000)
    tried = [laws.BoucWen(), laws.Dahl()]
    report = close_loop(record.window(2.0, 9.0), catalogue=tried, max_steps=1)
    (step,) = report.steps
    assert step.law == "bouc_wen"
    assert step.parameters == pytest.approx(true, rel=0.04)
    for name, (low, high) in step.intervals.items():
        assert low < true[name] < high
    # the search leaves next to nothing, whatever the scatter of the final estimate
    assert step.remainder < 0.05
    # the free run is fitted only where the baseline asks for it
    assert report.identified.method == "iv"
    assert report.verdict.state == "green"


def test_a_harmonic_test_hides_no_harmonic_force():
    t = np.arange(12000) / 1000
    drive = np.sin(2 * np.pi * 1.5 * t)
    assert driving_lines(drive[None], 1e-3) == pytest.approx((1.5,), abs=0.05)

    odd_harmonics = np.sign(np.cos(2 * np.pi * 1.5 * t))
    hidden = 0.3 * np.sin(2 * np.pi * 7.9 * t)
    first = spectral_lines(odd_harmonics + hidden, 1e-3, 3, (1.5,))[0]
    assert first == pytest.approx(7.9, abs=0.05)
    assert abs(first / 1.5 - round(first / 1.5)) > 0.05


def test_two_sines_drive_at_two_frequencies():
    t = np.arange(12000) / 1000
    drive = np.sin(2 * np.pi * 1.5 * t) + 0.8 * np.cos(2 * np.pi * 4.0 * t)
    assert driving_lines(drive[None], 1e-3) == pytest.approx((1.5, 4.0), abs=0.05)


def test_noise_drives_at_no_frequency():
    noise = np.random.default_rng(0).standard_normal((1, 12000))
    assert driving_lines(noise, 1e-3) == ()
    low_passed = np.convolve(noise[0], np.ones(250))[None]
    assert driving_lines(low_passed, 1e-3) == ()


def test_an_error_on_pieces_without_a_force_has_a_reference():
    """A stage spun up by a step of force: no other piece holds one that changes."""
    truth = ChainModel([2.0], {1: [laws.LinearViscous(1.0)]})
    force = np.full((800, 1), 3.0)
    force[400:] = 4.5
    record = simulate(truth, force, 1 / 40)
    noisy = add_noise(record.replace(acceleration=None), 0.01, random_state=0)
    record = noisy.replace(force=force)

    report = close_loop(record)

    heldout = report.table["held-out"]
    assert (heldout < 1000).all()
