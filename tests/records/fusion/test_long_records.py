"""Records that are long, or rest for most of the time."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.signal import chirp

from pysindy_nrf import ChainModel, KinematicSmoother, Record, laws, simulate
from pysindy_nrf.records.fusion.joint_fusion import (
    Predictor,
    error_variance,
    prior_correction,
)
from pysindy_nrf.records.fusion.splines import SplineBasis


def measured(x, a, rng, *noise):
    """Displacement and acceleration of one DOF at 1 kHz, with noise."""
    x, a = (y + level * rng.standard_normal(len(y)) for y, level in zip((x, a), noise))
    return Record(displacement=x, acceleration=a, fs=1000.0)


@pytest.mark.parametrize("n", [61_440, 65_535])
def test_three_blocks_that_overlap_by_more_than_half_keep_the_size_of_the_motion(n):
    """5 Hz at 1 kHz with 1 % noise in x and a: the fused motion is right to a fraction
    of that everywhere.
    """
    rng = np.random.default_rng(0)
    x = np.sin(2 * np.pi * 5 * np.arange(n) / 1000)
    a = -((2 * np.pi * 5) ** 2) * x
    noisy = measured(x, a, rng, 0.01, 0.01 * (2 * np.pi * 5) ** 2)
    fused = KinematicSmoother(joint=False).fit_transform(noisy).displacement[:, 0]
    assert np.abs(fused - x).max() < 0.01


def test_a_record_that_rests_most_of_the_time_keeps_its_noise():
    """A triggered sensor: two thirds of the record are quiet to the last bit, and the
    noise of the rest is heard.
    """
    rng, n = np.random.default_rng(0), 12_000
    t = np.arange(n) / 1000
    live = t < 4.0
    x = np.where(
        live, 1e-3 * np.sin(2 * np.pi * 6 * t) * np.sin(np.pi * t / 4.0) ** 2, 0.0
    )
    a = np.gradient(np.gradient(x, t), t)
    smoother = KinematicSmoother(joint=False)
    fused = smoother.fit_transform(
        measured(x, a, rng, 3e-5 * live, 0.05 * live)
    ).displacement[:, 0]
    assert smoother.noise_["x1"] == pytest.approx(3e-5, rel=0.2)
    assert np.sqrt(np.mean((fused - x)[live] ** 2)) < 1e-5


def test_a_sweep_keeps_the_frequencies_that_it_passes_last():
    """All floors fused together know them at least as well as floor by floor, though
    the record holds them briefly.
    """
    storeys = {
        i: [laws.LinearElastic(k), laws.LinearViscous(4.0)]
        for i, k in enumerate((6e3, 5e3, 4e3, 4e3), 1)
    }
    F, rng = np.zeros((8000, 4)), np.random.default_rng(0)
    F[:, 1] = 10 * chirp(np.arange(8000) / 200, 0.5, 40.0, 13.0)
    exact = simulate(ChainModel([3.0, 2.5, 2.0, 2.0], storeys), F, 1 / 200)
    noisy = {}
    for kind in ("acceleration", "velocity", "displacement"):
        y = getattr(exact, kind)
        noisy[kind] = y + 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    f, errors = np.fft.rfftfreq(8000, 1 / 200), []
    for joint in (True, False):
        fused = (
            KinematicSmoother(joint=joint)
            .fit_transform(exact.replace(**noisy))
            .displacement
        )
        lines = np.fft.rfft(fused - exact.displacement, axis=0)[(f > 10) & (f < 13)]
        errors.append(np.linalg.norm(lines, axis=0))
    assert (errors[0] < errors[1]).all()


def test_the_end_of_a_long_sweep_tells_the_knots():
    """60,000 samples, 1 to 60 Hz at 1 kHz, 1 % noise: the last frequencies are no
    noise, though most samples lack them.
    """
    rng, t = np.random.default_rng(0), np.arange(60_000) / 1000
    rate, phase = 2 * np.pi * (1 + 59 * t / 60), 2 * np.pi * (t + 59 * t**2 / 120)
    x, a = np.sin(phase), 2 * np.pi * 59 / 60 * np.cos(phase) - rate**2 * np.sin(phase)
    fused = (
        KinematicSmoother()
        .fit_transform(measured(x, a, rng, 0.01, 0.01 * a.std()))
        .acceleration[:, 0]
    )
    assert np.std(fused - a) < 0.01 * a.std()


def test_a_blow_of_five_samples_is_kept():
    """A hammer at the top, 0.1 % noise: all floors fused together lose nothing of the
    floor that is hit.
    """
    storeys = {
        i: [laws.LinearElastic(6e4), laws.LinearViscous(30.0)] for i in (1, 2, 3, 4)
    }
    F, rng = np.zeros((6000, 4)), np.random.default_rng(0)
    for start in (100, 2000, 4100):
        F[start : start + 5, 3] = 2000 * np.hanning(5)
    exact = simulate(ChainModel([10.0, 9.0, 8.0, 8.0], storeys), F, 1 / 500)
    x, a = exact.displacement, exact.acceleration
    noisy = [y + 1e-3 * y.std(axis=0) * rng.standard_normal(y.shape) for y in (x, a)]
    fused = KinematicSmoother().fit_transform(
        Record(displacement=noisy[0], acceleration=noisy[1], fs=500.0)
    )
    assert (np.std(fused.acceleration - a, axis=0) < 2e-3 * a.std(axis=0)).all()


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_blow_in_noise_is_kept(seed):
    """A hammer at the top, 5 % noise: knots 1.5 samples apart may be no better than
    two; those of one keep the blow.
    """
    rng, F = np.random.default_rng(seed), np.zeros((20_000, 2))
    for start in rng.integers(0, 19_900, 7):
        F[start : start + 5, 1] = 2000 * np.hanning(5)
    storeys = {i: [laws.LinearElastic(5e4), laws.LinearViscous(30.0)] for i in (1, 2)}
    exact = simulate(ChainModel([10.0, 8.0], storeys), F, 1 / 500)
    names = ("displacement", "acceleration")
    truth = [getattr(exact, name) for name in names]
    noisy = [y + 0.05 * y.std(axis=0) * rng.standard_normal(y.shape) for y in truth]
    fused = KinematicSmoother().fit_transform(
        Record(**dict(zip(names, noisy)), fs=500.0)
    )
    assert (
        np.std(fused.acceleration - truth[1], axis=0) < 0.05 * truth[1].std(axis=0)
    ).all()


def test_a_spline_is_the_weighted_least_squares_of_the_channels_that_are_measured():
    """Displacement and acceleration that contradict each other; dense least squares on
    splines of another library.
    """
    basis, t = SplineBasis(800, 2.5), np.arange(800)
    x, a = np.sin(0.15 * t), np.cos(0.23 * t)
    spline = BSpline(basis.spacing * np.arange(-7, basis.size + 1), np.eye(basis.size), 7)
    values = np.array([spline(t, nu=order) for order in range(3)])
    exact = np.linalg.lstsq(
        np.vstack([values[0], 3 * values[2]]), np.r_[x, 3 * a], rcond=None
    )[0]
    found = basis.evaluate(basis.solve(np.array([1.0, 0.0, 9.0]), [x, None, a]))
    assert (
        np.abs(found - values @ exact)[:, 100:-100].max() < 1e-6
    )  # apart from what settles the ends


def test_prediction_changes_a_motion_as_the_least_squares_of_all_its_coefficients_does():
    """Two floors that ring and are hit once: filter, and banded equations about the
    blow and at the ends, are exact.
    """
    rng, basis = np.random.default_rng(0), SplineBasis(2000, 2.0)
    filters = np.array(
        [np.eye(2), [[-1.5, 0.2], [0.1, -1.3]], [[0.9, -0.1], [0.0, 0.8]]]
    )
    weights = np.array([[0.2, 0.0, 5.0], [0.1, 0.0, 9.0]])
    force, size = rng.standard_normal((basis.size, 2)), basis.size
    force[500:504] *= 40.0
    ahead = sum(
        np.kron(np.eye(size - 2, size, k=2 - i), g) for i, g in enumerate(filters)
    )
    c = np.linalg.solve(
        np.vstack([np.eye(4, 2 * size), ahead]), force.ravel()
    ) + rng.standard_normal(2 * size)
    errors = (ahead @ (c - np.tile(c.reshape(-1, 2).mean(axis=0), size))).reshape(-1, 2)
    noise = float((filters**2).sum() / 2)
    prior = (ahead.T / np.repeat(error_variance(errors, noise), 2)) @ ahead
    splines = np.stack([basis.evaluate(one) for one in np.eye(size)])
    seen = [
        np.einsum("kot,o,lot->kl", splines, own, splines, optimize=True)
        for own in weights
    ]
    both = prior + sum(
        np.kron(one, np.diag(np.eye(2)[j])) for j, one in enumerate(seen)
    )
    exact = np.linalg.solve(both, -prior @ c)
    found = prior_correction(
        c.reshape(-1, 2), weights, basis, Predictor(filters, noise)
    ).ravel()
    assert (
        np.abs(exact).max() > 0.3
        and np.abs(found - exact).max() < 2e-3 * np.abs(exact).max()
    )
