"""Splines and their prior against dense least squares."""

import numpy as np
from scipy.interpolate import BSpline

from pysindy_nrf.records.fusion.joint_fusion import (
    Predictor,
    error_variance,
    prior_correction,
)
from pysindy_nrf.records.fusion.splines import SplineBasis


def test_a_spline_is_the_weighted_least_squares_of_what_is_measured():
    """Displacement and acceleration that contradict each other."""
    basis, t = SplineBasis(800, 2.5), np.arange(800)
    x, a = np.sin(0.15 * t), np.cos(0.23 * t)
    knots = basis.spacing * np.arange(-7, basis.size + 1)
    spline = BSpline(knots, np.eye(basis.size), 7)
    values = np.array([spline(t, nu=order) for order in range(3)])
    matrix = np.vstack([values[0], 3 * values[2]])
    exact = values @ np.linalg.lstsq(matrix, np.r_[x, 3 * a], rcond=None)[0]

    coefficients = basis.solve(np.array([1.0, 0.0, 9.0]), [x, None, a])
    samples = basis.evaluate(coefficients)
    # a little roughness settles the ends
    assert np.abs(samples - exact)[:, 100:-100].max() < 1e-6


def test_the_prior_changes_a_motion_as_dense_least_squares_do():
    """Two floors that ring and are hit once: filter, and banded equations about the
    blow and at the ends.
    """
    rng, basis = np.random.default_rng(0), SplineBasis(2000, 2.0)
    size = basis.size
    filters = np.array(
        [np.eye(2), [[-1.5, 0.2], [0.1, -1.3]], [[0.9, -0.1], [0.0, 0.8]]]
    )
    weights = np.array([[0.2, 0.0, 5.0], [0.1, 0.0, 9.0]])
    predict = sum(
        np.kron(np.eye(size - 2, size, k=2 - i), g) for i, g in enumerate(filters)
    )

    # a motion that such filters make of noise and a blow, measured with noise
    force = rng.standard_normal((size, 2))
    force[500:504] *= 40.0
    recursion = np.vstack([np.eye(4, 2 * size), predict])
    motion = np.linalg.solve(recursion, force.ravel())
    motion += rng.standard_normal(2 * size)

    mean = np.tile(motion.reshape(-1, 2).mean(axis=0), size)
    errors = (predict @ (motion - mean)).reshape(-1, 2)
    noise = float((filters**2).sum() / 2)
    variance = np.repeat(error_variance(errors, noise), 2)
    prior = (predict.T / variance) @ predict
    splines = np.stack([basis.evaluate(unit) for unit in np.eye(size)])
    data = sum(
        np.kron(
            np.einsum("kot,o,lot->kl", splines, weight, splines, optimize=True),
            np.diag(np.eye(2)[j]),
        )
        for j, weight in enumerate(weights)
    )
    exact = np.linalg.solve(prior + data, -prior @ motion)

    predictor = Predictor(filters, noise)
    correction = prior_correction(motion.reshape(-1, 2), weights, basis, predictor)
    largest = np.abs(exact).max()
    assert largest > 0.3
    assert np.abs(correction.ravel() - exact).max() < 2e-3 * largest
