"""Noise levels from the error of a free run, and the force corrected by the motion."""

from dataclasses import replace

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import ChainModel, KinematicSmoother, excitation, laws, simulate
from pysindy_nrf.chain.layout import LawLayout
from pysindy_nrf.identification.free_runs import simulated
from pysindy_nrf.identification.linear_response import (
    equivalent_matrices,
    transfer,
    unbalanced,
)
from pysindy_nrf.identification.noise_spectra import corrected, noise_model
from pysindy_nrf.records.input_arrays import from_arrays
from pysindy_nrf.simulation.noise import add_noise

FS, LEVEL = 1000.0, 0.05
TRUTH = ChainModel(
    [12.4] * 3, {f"storey {i}": laws.PowerSeries(1, [25.0, 1.4e5]) for i in (1, 2, 3)}
)


@pytest.fixture(scope="module")
def noisy():
    F = excitation.band_limited_random(
        3, 16.0, FS, excited=[3], rms=100.0, band=(0.5, 60.0), random_state=0
    )
    rec = add_noise(
        simulate(TRUTH, F, 1 / FS, hold="cubic"),
        LEVEL,
        random_state=np.random.default_rng(1),
    )
    segment = from_arrays(rec, smooth=KinematicSmoother(joint=False)).segments[0]
    run, layout = simulated(TRUTH, segment), LawLayout(TRUTH.chain, TRUTH.laws)
    gap = unbalanced(TRUTH, equivalent_matrices(TRUTH, layout, [run]), segment)
    return F, segment, gap, noise_model(TRUTH, layout, [segment], [run], [gap])


def test_the_level_of_the_force_noise_is_found(noisy):
    F, _, _, noise = noisy
    true = (LEVEL * np.sqrt(np.mean(F[:, 2] ** 2))) ** 2 / FS
    assert noise.force[2] == pytest.approx(true, rel=0.3)
    assert (
        noise.force[[0, 1, 3]].max() == 0.0
    )  # unforced DOFs and a base at rest have none


def test_the_motions_noise_is_that_of_three_channels_together(noisy):
    """Density of the best velocity from white noise on a, v and x: 1 / (w^2/a^2 + 1/v^2
    + 1/(w x)^2).
    """
    F, _, _, noise = noisy
    exact = simulate(TRUTH, F, 1 / FS, hold="cubic")
    a, v, x = (
        LEVEL * y.std(axis=0)
        for y in (exact.acceleration, exact.velocity, exact.displacement)
    )
    f = np.array([12.0, 20.0, 30.0, 45.0])
    w = 2 * np.pi * f[:, None]
    best = 1 / ((w / a) ** 2 + 1 / v**2 + 1 / (w * x) ** 2) / FS
    assert np.median(np.abs(np.log(noise.motion(f) / best))) < 0.35


def test_the_corrected_force_is_nearer_and_its_error_independent_of_what_the_run_misses(
    noisy,
):
    F, segment, gap, noise = noisy
    better = corrected(segment, gap, noise)
    errors = [np.fft.rfft(s.F[:, 2] - F[:, 2]) for s in (segment, better)]
    f = np.fft.rfftfreq(len(F), 1 / FS)
    band = (f > 2) & (f < 40)
    before, after = (np.sum(np.abs(e[band]) ** 2) for e in errors)
    assert after < 0.7 * before
    missed = np.fft.rfft(
        np.cumsum(segment.v - simulated(TRUTH, segment).v, axis=1)[:, 2]
    )
    G = transfer(noise.matrices, f[band])[:, 2, 2]
    alike = [
        abs(np.sum(np.conj(e[band]) * missed[band] / G))
        / np.linalg.norm(e[band])
        / np.linalg.norm(missed[band] / G)
        for e in errors
    ]
    assert alike[1] < 0.3 * alike[0]


def test_exact_motion_needs_no_noise_model():
    rec = driven(TRUTH, [3], 4.0, FS, 100.0, (0.5, 60.0))
    segment = from_arrays(rec, smooth=False).segments[0]
    run, layout = replace(segment), LawLayout(TRUTH.chain, TRUTH.laws)
    gap = unbalanced(TRUTH, equivalent_matrices(TRUTH, layout, [run]), segment)
    assert noise_model(TRUTH, layout, [segment], [run], [gap]) is None


def test_transfer_is_what_a_steady_sine_shows():
    """A sine of 9 Hz on DOF 2, long after it began: amplitude and phase of every
    velocity.
    """
    t = np.arange(20_000) / FS
    F = np.zeros((len(t), 3))
    F[:, 1] = np.sin(2 * np.pi * 9.0 * t)
    heavy = TRUTH.with_laws(
        {f"storey {i}": laws.PowerSeries(1, [400.0, 1.4e5]) for i in (1, 2, 3)}
    )
    v = simulate(heavy, F, 1 / FS, hold="cubic").velocity[10_000:]
    phasor = (
        2 * np.mean(v * np.exp(-2j * np.pi * 9.0 * t[10_000:])[:, None], axis=0) * 1j
    )
    np.testing.assert_allclose(
        phasor, transfer(heavy.matrices(), np.array([9.0]))[0, :, 1], rtol=1e-4
    )
