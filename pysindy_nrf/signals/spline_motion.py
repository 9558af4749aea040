"""One motion as a B-spline: displacement, velocity and acceleration that are exact derivatives.

``x(t) = sum_k c_k B((t - t_0) / h - k)`` with B the cardinal B-spline of degree 7 and the knots
evenly spaced over the record, h samples apart. Velocity and acceleration are the same
coefficients times the derivatives of B. No periodicity is assumed. Everything is banded: the cost
is linear in the number of samples.

Degree 7, because the second derivative of a spline through the samples is then right to
``(2 pi f / fs)^6 / 30240``: 3e-8 at a twentieth of the sampling rate (degree 5: 1e-5).
"""

from __future__ import annotations

from functools import cached_property
from math import comb

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, solveh_banded
from scipy.sparse import csr_array, diags_array

from ..exceptions import ChannelError

DEGREE = 7
# Weight of the roughness that settles the ends, where fewer samples than coefficients speak.
END_WEIGHT = 1e-8


class SplineBasis:
    """B-spline basis on a record of ``n`` samples; time is counted in samples.

    Parameters
    ----------
    n : int
        Number of samples, at least two.
    spacing : float
        Distance of the knots wanted, samples, at least one. The distance used divides the record
        evenly and is never larger.

    Attributes
    ----------
    h : float
        Distance of the knots, samples.
    size : int
        Number of coefficients.
    """

    def __init__(self, n: int, spacing: float = 1.0) -> None:
        self.n = n
        intervals = max(1, int(np.ceil((n - 1) / spacing - 1e-9)))
        self.h = (n - 1) / intervals
        self.size = intervals + DEGREE

    @cached_property
    def matrices(self) -> tuple[csr_array, csr_array, csr_array]:
        """Values, first and second derivatives at the samples: sparse (n, size) each."""
        return self._derivative(0), self._derivative(1), self._derivative(2)

    def _derivative(self, order: int) -> csr_array:
        degree = DEGREE - order
        # the derivative of a cardinal B-spline is the difference of two of one degree less
        knots = self.h * np.arange(-degree, self.size - order + 1)
        samples = np.minimum(np.arange(self.n, dtype=float), knots[-degree - 1])
        matrix = csr_array(BSpline.design_matrix(samples, knots, degree))
        for size in range(self.size - order + 1, self.size + 1):
            matrix = matrix @ diags_array([-1.0, 1.0], offsets=[0, 1], shape=(size - 1, size)) / self.h
        return csr_array(matrix)

    @cached_property
    def grams(self) -> np.ndarray:
        """Normal matrices of value, first and second derivative, upper banded form, (3, 9, size)."""
        return np.stack([_banded(matrix.T @ matrix) for matrix in self.matrices])

    @cached_property
    def roughness(self) -> np.ndarray:
        """Normal matrix of the 8th difference of the coefficients, upper banded form, (9, size)."""
        k = DEGREE + 1
        if self.size <= k:
            return np.zeros((k + 1, self.size))
        row = [float((-1) ** i * comb(k, i)) for i in range(k + 1)]
        difference = diags_array(row, offsets=range(k + 1), shape=(self.size - k, self.size))
        return _banded(csr_array(difference.T @ difference))

    def symbols(self, w: np.ndarray) -> np.ndarray:
        """Fourier symbols of the three normal matrices inside the record."""
        # averaged over the inner columns: the samples sit differently between the knots
        inner = self.grams[:, :, self.size // 4 : max(self.size // 4 + 1, 3 * self.size // 4)].mean(axis=2)
        k = np.arange(DEGREE + 1, 0, -1)
        return inner[:, -1:] + 2 * inner[:, :-1] @ np.cos(k[:, None] * w)

    def project(self, order: int, values: np.ndarray) -> np.ndarray:
        """Right-hand side of the normal equations of one channel, shape (size, ...)."""
        return self.matrices[order].T @ values

    def normal_matrix(self, weights: np.ndarray) -> np.ndarray:
        """Weighted sum of the normal matrices, upper banded form, (9, size)."""
        band = np.tensordot(weights, self.grams, 1)
        return band + END_WEIGHT * band[-1].mean() * self.roughness

    def solve(self, weights: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        """Coefficients that minimise the weighted squares, shape (size, ...)."""
        for ridge in (0.0, 1e-13, 1e-11, 1e-9):  # heavily oversampled motion takes the last digits
            band = self.normal_matrix(weights)
            band[-1] *= 1.0 + ridge
            try:
                return solveh_banded(band, rhs, overwrite_ab=True, check_finite=False)
            except LinAlgError:
                continue
        raise ChannelError(
            "The motion cannot be told at this sampling rate: its channels are far below their own resolution",
            "Resample to a lower rate, or give noise= levels to KinematicSmoother.",
        )

    def evaluate(self, order: int, coefficients: np.ndarray) -> np.ndarray:
        """The motion (order 0) or its derivatives per sample at the samples."""
        return self.matrices[order] @ coefficients


def _banded(matrix: csr_array) -> np.ndarray:
    out = np.zeros((DEGREE + 2, matrix.shape[0]))
    for k in range(min(DEGREE + 2, matrix.shape[0])):
        out[DEGREE + 1 - k, k:] = matrix.diagonal(k)
    return out
