"""Least squares on Gram matrices: dependent columns, and columns in any units."""

from __future__ import annotations

import numpy as np
import pytest

from pysindy_nrf.diagnosis.gram_least_squares import (
    held_out_residual,
    left_over,
    solved,
)

# rad/s
OMEGA = 60.0


def rows_of_sine(lengths: np.ndarray, noise: float, n_samples: int = 4000):
    """Acceleration, velocity and drift of one sine, and a force that they make."""
    rng = np.random.default_rng(5)
    t = np.arange(n_samples) / 500.0
    drift = np.sin(OMEGA * t)
    rate = OMEGA * np.cos(OMEGA * t)
    columns = np.column_stack([-(OMEGA**2) * drift, rate, drift])
    columns += (
        noise * np.sqrt(np.mean(columns**2, axis=0)) * rng.normal(size=columns.shape)
    )
    force = columns @ [2.0, 30.0, 9e3] + rng.normal(size=n_samples)
    return np.column_stack([columns * lengths, force])


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("length", [1e-9, 1e-4, 1.0, 1e6])
def test_dependent_columns_in_any_units_leave_what_the_noise_leaves(noise, length):
    rows = rows_of_sine(np.array([1.0, length, 1.0 / length]), noise)
    gram = rows.T @ rows
    columns = np.arange(3)

    coefficients = solved(gram, columns)

    scaled = rows[:, :3] / np.abs(rows[:, :3]).max(axis=0)
    best, *_ = np.linalg.lstsq(scaled, rows[:, 3], rcond=1e-10)
    expected = np.sum((rows[:, 3] - scaled @ best) ** 2)
    assert left_over(gram, columns, coefficients) == pytest.approx(expected, rel=1e-3)


def test_the_residual_held_out_does_not_depend_on_units():
    lengths = np.array([1.0, 1e-7, 1e5])
    rows = rows_of_sine(np.ones(3), 0.01)
    halves = np.split(rows, 2)
    in_si = np.array([half.T @ half for half in halves])
    scale = np.append(lengths, 1.0)
    in_others = in_si * scale[:, None] * scale

    columns = np.arange(3)
    assert held_out_residual(in_others, columns) == pytest.approx(
        held_out_residual(in_si, columns), rel=1e-6
    )
