"""Noise levels from the gaps of a free run, and forces corrected by the motion."""

from dataclasses import dataclass

import numpy as np
import pytest
from chains import driven

from pysindy_nrf import (
    ChainModel,
    KinematicSmoother,
    Record,
    excitation,
    laws,
    simulate,
)
from pysindy_nrf.identification import (
    FreeRunFit,
    free_parameters,
    shots_of,
    transfer,
)
from pysindy_nrf.records import from_arrays
from pysindy_nrf.simulation import add_noise

FS = 1000.0
LEVEL = 0.05
STIFFNESS = 1.4e5


def chain(damping):
    storeys = {i: laws.PowerSeries(1, [damping, STIFFNESS]) for i in (1, 2, 3)}
    return ChainModel([12.4] * 3, storeys)


TRUTH = chain(25.0)


def free_run_fit(record, smooth):
    """The free run of the true model beside a record."""
    shots = shots_of(from_arrays(record, smooth=smooth), TRUTH)
    return FreeRunFit(free_parameters(TRUTH, {}), shots)


@dataclass(frozen=True)
class Noisy:
    """A record with noise, and a fit with the noise that the true model shows."""

    exact: Record
    fit: FreeRunFit


@pytest.fixture(scope="module")
def noisy():
    """A force on the top of three floors, 5 % of noise in all channels."""
    F = excitation.band_limited_random(
        3, 16.0, FS, excited=[3], rms=100.0, band=(0.5, 60.0), random_state=0
    )
    exact = simulate(TRUTH, F, 1 / FS, hold="cubic")
    record = add_noise(exact, LEVEL, random_state=np.random.default_rng(1))
    fit = free_run_fit(record, KinematicSmoother(joint=False))
    return Noisy(exact, fit.with_noise(TRUTH))


def test_the_level_of_the_force_noise_is_found(noisy):
    rms = np.sqrt(np.mean(noisy.exact.force[:, 2] ** 2))

    assert noisy.fit.noise.force[2] == pytest.approx((LEVEL * rms) ** 2 / FS, rel=0.3)


def test_unforced_floors_and_a_base_at_rest_have_no_noise(noisy):
    assert noisy.fit.noise.force[[0, 1, 3]].max() == 0.0


def test_the_noise_of_the_motion_is_that_of_three_channels_together(noisy):
    """The best velocity from white noise on a, v and x: 1 / (w^2/a^2 + 1/v^2 + ...)."""
    a = LEVEL * noisy.exact.acceleration.std(axis=0)
    v = LEVEL * noisy.exact.velocity.std(axis=0)
    x = LEVEL * noisy.exact.displacement.std(axis=0)
    f = np.array([12.0, 20.0, 30.0, 45.0])
    w = 2 * np.pi * f[:, None]

    best = 1 / ((w / a) ** 2 + 1 / v**2 + 1 / (w * x) ** 2) / FS
    ratio = noisy.fit.noise.motion(f) / best
    assert np.median(np.abs(np.log(ratio))) < 0.35


def force_errors(noisy):
    """Lines of the error of the measured and of the corrected force in 2 to 40 Hz."""
    (shot,) = noisy.fit.shots
    f = np.fft.rfftfreq(len(noisy.exact.force), 1 / FS)
    band = (f > 2) & (f < 40)
    lines = []
    for segment in (shot.segment, noisy.fit.forces[0]):
        error = segment.F[:, 2] - noisy.exact.force[:, 2]
        lines.append(np.fft.rfft(error)[band])
    return f, band, lines


def test_the_corrected_force_is_nearer(noisy):
    _, _, (measured, better) = force_errors(noisy)

    assert np.linalg.norm(better) ** 2 < 0.7 * np.linalg.norm(measured) ** 2


def test_the_error_of_the_corrected_force_is_independent_of_the_gap(noisy):
    f, band, errors = force_errors(noisy)
    (shot,) = noisy.fit.shots
    missed = (shot.measured - shot.simulated_channels(TRUTH))[:, 2]
    G = transfer(noisy.fit.noise.matrices, f[band])[:, 2, 2]
    as_force = np.fft.rfft(missed)[band] / G

    coherence = []
    for error in errors:
        size = np.linalg.norm(error) * np.linalg.norm(as_force)
        coherence.append(abs(np.vdot(error, as_force)) / size)
    assert coherence[1] < 0.3 * coherence[0]


def test_exact_motion_has_no_noise_model():
    record = driven(TRUTH, [3], 4.0, FS, 100.0, (0.5, 60.0), hold="cubic")

    assert free_run_fit(record, smooth=False).with_noise(TRUTH) is None


def test_transfer_is_what_a_steady_sine_shows():
    """A sine of 9 Hz on DOF 2, long after it began: all velocities."""
    t = np.arange(20_000) / FS
    F = np.zeros((len(t), 3))
    F[:, 1] = np.sin(2 * np.pi * 9.0 * t)
    heavy = chain(400.0)
    velocity = simulate(heavy, F, 1 / FS, hold="cubic").velocity[10_000:]

    carrier = np.exp(-2j * np.pi * 9.0 * t[10_000:])
    phasors = 2j * np.mean(velocity * carrier[:, None], axis=0)
    expected = transfer(heavy.matrices(), np.array([9.0]))[0, :, 1]
    np.testing.assert_allclose(phasors, expected, rtol=1e-4)
