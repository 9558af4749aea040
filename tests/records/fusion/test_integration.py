"""Integrals of motions against those in closed form."""

import numpy as np
import pytest
from smooth_motions import FS, rms, two_floors

from pysindy_nrf.exceptions import ChannelError
from pysindy_nrf.records import integrate


@pytest.mark.parametrize(("method", "error"), [("spline", 1e-8), ("cumulative", 1e-3)])
def test_every_integral_starts_at_zero(method, error):
    """Of a cos(w t + p), once: (sin(w t + p) - sin p) / w; twice, about rest."""
    w, phase = 2 * np.pi * 6.0, 0.7
    t = np.arange(500) / FS
    a = np.cos(w * t + phase)
    once = (np.sin(w * t + phase) - np.sin(phase)) / w
    twice = (np.cos(phase) - np.cos(w * t + phase)) / w**2 - np.sin(phase) / w * t

    velocity = integrate(a, 1 / FS, method)
    displacement = integrate(a, 1 / FS, method, order=2)
    np.testing.assert_allclose(velocity, once, atol=error / w)
    np.testing.assert_allclose(displacement, twice, atol=5 * error / w**2)
    assert velocity[0] == displacement[0] == 0.0


def test_the_trapezoid_rule_loses_what_theory_says():
    """Of a sine, all but the factor h / tan(h) with h = w dt / 2."""
    t = np.arange(4000) / FS
    w = 2 * np.pi * FS / 10
    half = w / FS / 2
    velocity = integrate(np.cos(w * t) * w, 1 / FS, "cumulative")
    expected = half / np.tan(half) * np.sin(w * t).max()
    assert velocity.max() == pytest.approx(expected, rel=1e-3)


def test_detrended_integral_drops_offset_and_initial_velocity():
    motion = two_floors(8000, top=20.0)
    displacement = integrate(motion.a + 0.3, 1 / FS, order=2, detrend=True)
    parabolas = np.polynomial.legendre.legvander(np.linspace(-1, 1, 8000), 2)
    fit = np.linalg.lstsq(parabolas, motion.x, rcond=None)[0]
    wanted = motion.x - parabolas @ fit
    assert np.abs(displacement - wanted).max() < 1e-5 * rms(wanted).min()


@pytest.mark.parametrize(
    ("motion", "options", "words"),
    [
        (np.zeros((3, 3, 3)), {}, "has 3 dimensions"),
        (np.zeros(2), {}, "2 samples are too few"),
        (np.zeros(10), {"method": "magic"}, "Choose"),
        (np.zeros(10), {"order": 3}, "order"),
        (np.array([0.0, 1.0, np.nan, 3.0]), {}, "not finite in row 2"),
    ],
)
def test_what_cannot_be_integrated_is_refused(motion, options, words):
    with pytest.raises(ChannelError, match=words):
        integrate(motion, 0.1, **options)
