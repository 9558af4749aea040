"""Splines on evenly spaced samples, fitted by least squares to values and derivatives.

All in units of samples: ``x(t) = sum_k c_k B((t - t_0) / h - k)``, where B is the
cardinal B-spline of degree 7 and h the distance of the knots. Nothing is taken to be
periodic. Every matrix is banded, so the cost is linear in the number of samples. Degree
7 makes the second derivative right to ``(2 pi f / fs)^6 / 30240``.
"""

from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache
from itertools import combinations_with_replacement
from math import comb

import numpy as np
from numpy.polynomial.polynomial import polyder
from scipy.interpolate import BSpline, PPoly

from ...exceptions import ChannelError

DEGREE = 7
# The eight splines over one interval between knots: coefficients of the powers of the
# position in it, (power, spline).
PIECES = PPoly.from_spline(BSpline.basis_element(np.arange(DEGREE + 2.0))).c[
    ::-1, -DEGREE - 1 : DEGREE - 1 : -1
]
# Share of the roughness that is added to the normal matrices. It settles the ends,
# where fewer samples than coefficients count.
END_ROUGHNESS = 1e-8
# Factors on the diagonal of the normal matrix that are tried until it is positive
# definite: motion that is sampled very fast loses the last digits.
DIAGONAL_FACTORS = (1.0, 1.0 + 1e-13, 1.0 + 1e-11, 1.0 + 1e-9)
# Frequencies at which the spectra of the normal matrices are averaged.
N_FREQUENCIES = 512
# Distances of the knots that are tried, samples.
SPACINGS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
# Intervals between knots that a record must have for a distance to be tried.
MIN_INTERVALS = 12
# Bases kept for the next records of equal length: a search fuses its own records, those
# held out, and the pieces from which noise levels are found.
LENGTHS_KEPT = 3


class SplineBasis:
    """B-splines of degree 7 on a record, for displacement, velocity and acceleration.

    Parameters
    ----------
    n_samples : int
    spacing : float
        Largest distance of the knots, samples. They divide the record evenly.

    Attributes
    ----------
    spacing : float
        Distance of the knots.
    size : int
        Number of coefficients.
    """

    def __init__(self, n_samples: int, spacing: float = 1.0) -> None:
        self.n_samples = n_samples
        self.n_intervals = max(1, int(np.ceil((n_samples - 1) / spacing - 1e-9)))
        self.spacing = (n_samples - 1) / self.n_intervals
        self.size = self.n_intervals + DEGREE

    @cached_property
    def _at_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """First of the eight splines that are not zero at each sample, and their values
        and derivatives, (n_samples, 3, 8).
        """
        last_sample = self.n_samples - 1
        # in whole numbers: a sample on a knot is exactly on it
        position = self.n_intervals * np.arange(self.n_samples)
        first = np.minimum(position // last_sample, self.n_intervals - 1)
        powers = np.vander(
            (position - first * last_sample) / last_sample, DEGREE + 1, increasing=True
        )

        derivatives = [
            powers[:, : DEGREE + 1 - order] @ polyder(PIECES, order, 1.0 / self.spacing)
            for order in range(3)
        ]
        return first, np.stack(derivatives, axis=1)

    @cached_property
    def normal_matrices(self) -> np.ndarray:
        """Normal matrix of value, first and second derivative, each with a little
        roughness, lower banded, (size, 3, 9).
        """
        first, values = self._at_samples
        starts = np.searchsorted(first, np.arange(self.n_intervals))
        matrices = np.stack(
            [
                _banded(np.ascontiguousarray(values[:, order].T), starts, self.size)
                for order in range(3)
            ],
            axis=1,
        )

        # roughness: squares of the differences of order 8 of the coefficients
        order, count = DEGREE + 1, max(self.n_intervals - 1, 0)
        differences = [
            np.full(count, float((-1) ** i * comb(order, i))) for i in range(order + 1)
        ]
        roughness = END_ROUGHNESS * _banded(differences, np.arange(count), self.size)
        mean_diagonal = matrices[:, :, :1].mean(axis=0)
        return matrices + mean_diagonal * roughness[:, None]

    @cached_property
    def _inner_bands(self) -> np.ndarray:
        """Band of the normal matrices inside the record, (3, 9); a mean over columns,
        as samples lie differently between knots.
        """
        start = self.size // 4
        stop = max(start + 1, 3 * self.size // 4)
        return self.normal_matrices[start:stop].mean(axis=0)

    def spectra(self, frequencies: np.ndarray) -> np.ndarray:
        """Spectra of the three normal matrices inside the record.

        Parameters
        ----------
        frequencies : ndarray of shape (n,)
            Radians per coefficient.

        Returns
        -------
        ndarray of shape (3, n)
            What the matrix makes of a harmonic; rounding may leave it below zero.
        """
        lags = np.arange(1, DEGREE + 2)[:, None]
        return self._inner_bands[:, :1] + 2 * self._inner_bands[:, 1:] @ np.cos(
            lags * frequencies
        )

    @cached_property
    def _spectra_evenly(self) -> np.ndarray:
        """Spectra at frequencies that cover all evenly, (3, N_FREQUENCIES)."""
        frequencies = np.pi * (np.arange(N_FREQUENCIES) + 0.5) / N_FREQUENCIES
        return np.maximum(self.spectra(frequencies), 0.0)

    def parameters_spent(self, weights: np.ndarray) -> np.ndarray:
        """Number of parameters that each channel determines, (3,): the trace of its
        part of the smoothing matrix.
        """
        spectra = self._spectra_evenly
        shares = spectra @ (1.0 / (weights @ spectra))
        return self.size * weights * shares / N_FREQUENCIES

    def normal_matrix(self, weights: np.ndarray, columns: slice) -> np.ndarray:
        """Weighted sum of the normal matrices, some columns of the lower band, (9,
        n_columns).
        """
        return np.einsum("kof,o->fk", self.normal_matrices[columns], weights)

    def solve(
        self, weights: np.ndarray, channels: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        """Coefficients that minimise the weighted squares about the channels.

        Parameters
        ----------
        weights : ndarray of shape (3,)
            Of displacement, velocity and acceleration.
        channels : sequence of three ndarrays of shape (n_samples,)
            In units of samples. A channel of None is zero where its weight is not.

        Returns
        -------
        ndarray of shape (size,)

        Raises
        ------
        ChannelError
            If the normal matrix is singular.
        """
        measured = np.array([channel is not None for channel in channels])
        data_weights = measured * weights
        stand_in = channels[int(data_weights.argmax())]
        data = [stand_in if channel is None else channel for channel in channels]

        # elimination writes zeros past the last coefficient
        rows = self.size + DEGREE + 1
        coefficients = np.zeros(rows)
        band = np.empty((rows, DEGREE + 2))
        solve_banded, _ = compiled()
        for factor in DIAGONAL_FACTORS:
            if solve_banded(
                *self._at_samples,
                self.normal_matrices,
                weights,
                data_weights,
                *data,
                factor,
                band,
                coefficients,
            ):
                return coefficients[: self.size]
        raise ChannelError(
            "The motion cannot be determined at this sampling rate: it changes too"
            " little between samples",
            "Resample to a lower rate, or give noise= levels to KinematicSmoother.",
        )

    def evaluate(self, coefficients: np.ndarray) -> np.ndarray:
        """Displacement, velocity and acceleration at the samples, (3, n_samples)."""
        out = np.zeros((3, self.n_samples))
        self.add(coefficients, np.ones(self.n_samples), out)
        return out

    def add(
        self, coefficients: np.ndarray, weight: np.ndarray, out: np.ndarray
    ) -> None:
        """Add to ``out`` what :meth:`evaluate` gives, times a weight for each
        sample.
        """
        _, add_values = compiled()
        add_values(*self._at_samples, np.ascontiguousarray(coefficients), weight, *out)

    @cached_property
    def means(self) -> np.ndarray:
        """Mean of every spline over the samples, (size,)."""
        first, values = self._at_samples
        splines = first[:, None] + np.arange(DEGREE + 1)
        totals = np.bincount(splines.ravel(), values[:, 0].ravel(), self.size)
        return totals / self.n_samples


@cache
def compiled() -> tuple[Callable[..., bool], Callable[..., None]]:
    """Least squares and values of a spline.

    LAPACK takes four times as long: it calls a routine for each column.
    """
    from ...common.compiled import address_of, addresses, jit

    n_splines = DEGREE + 1
    n_band = DEGREE + 2

    # longer than other functions: addresses cannot be passed between compiled functions
    # without cost
    def spline_solve(
        first,
        values,
        matrices,
        weights,
        data_weights,
        x,
        v,
        a,
        diagonal_factor,
        band,
        c,
    ):
        """False if the normal matrix is not positive definite."""
        size = matrices.shape[0]
        weight_x = weights[0]
        weight_v = weights[1]
        weight_a = weights[2]
        data_weight_x = data_weights[0]
        data_weight_v = data_weights[1]
        data_weight_a = data_weights[2]
        values, matrices, band, c = addresses((values, matrices, band, c))

        # normal matrix
        for k in range(size):
            row = address_of(band, n_band * k)
            row_x = address_of(matrices, 3 * n_band * k)
            row_v = address_of(row_x, n_band)
            row_a = address_of(row_x, 2 * n_band)
            for j in range(n_band):
                row[j] = weight_x * row_x[j] + weight_v * row_v[j] + weight_a * row_a[j]
            row[0] *= diagonal_factor
            c[k] = 0.0

        # right-hand side
        for t in range(first.shape[0]):
            right = address_of(c, first[t])
            of_x = address_of(values, 3 * n_splines * t)
            of_v = address_of(of_x, n_splines)
            of_a = address_of(of_x, 2 * n_splines)
            x_t = data_weight_x * x[t]
            v_t = data_weight_v * v[t]
            a_t = data_weight_a * a[t]
            for j in range(n_splines):
                right[j] += x_t * of_x[j] + v_t * of_v[j] + a_t * of_a[j]

        # elimination, then substitution from the last coefficient up
        for k in range(size):
            row = address_of(band, n_band * k)
            if not row[0] > 0.0:
                return False
            inverse = 1.0 / row[0]
            value = c[k]
            for i in range(1, n_band):
                share = row[i] * inverse
                below = address_of(row, n_band * i)
                for j in range(n_band - i):
                    below[j] -= share * row[i + j]
                c[k + i] -= share * value
            row[0] = inverse
        for k in range(size - 1, -1, -1):
            row = address_of(band, n_band * k)
            value = c[k]
            for i in range(n_band - 1, 0, -1):
                value -= row[i] * c[k + i]
            c[k] = value * row[0]
        return True

    def spline_values(first, values, c, weight, out_x, out_v, out_a):
        """Add the weighted values and derivatives."""
        values, c = addresses((values, c))
        for t in range(first.shape[0]):
            local = address_of(c, first[t])
            of_x = address_of(values, 3 * n_splines * t)
            of_v = address_of(of_x, n_splines)
            of_a = address_of(of_x, 2 * n_splines)
            x = 0.0
            v = 0.0
            a = 0.0
            for j in range(n_splines):
                x += local[j] * of_x[j]
                v += local[j] * of_v[j]
                a += local[j] * of_a[j]
            out_x[t] += weight[t] * x
            out_v[t] += weight[t] * v
            out_a[t] += weight[t] * a

    return jit(spline_solve), jit(spline_values)


def _banded(
    rows: np.ndarray | Sequence[np.ndarray], starts: np.ndarray, size: int
) -> np.ndarray:
    """Lower banded normal matrix, (size, 9).

    ``rows[i]`` has the entries of column k + i of the design matrix, for the samples
    from ``starts[k]`` to ``starts[k + 1]``.
    """
    out = np.zeros((size, DEGREE + 2))
    if not len(starts):
        return out
    for i, j in combinations_with_replacement(range(len(rows)), 2):
        products = np.add.reduceat(rows[i] * rows[j], starts)
        out[i : i + len(starts), j - i] += products
    return out


class BasisLadder(dict[float, SplineBasis]):
    """Spline bases of one record length by the distance of their knots, made when
    needed and shared by all degrees of freedom.
    """

    def __init__(self, n_samples: int) -> None:
        self.n_samples = n_samples
        self.spacings = [
            spacing
            for spacing in SPACINGS
            if spacing == 1.0 or (n_samples - 1) / spacing >= MIN_INTERVALS
        ]

    def __missing__(self, spacing: float) -> SplineBasis:
        return self.setdefault(spacing, SplineBasis(self.n_samples, spacing))


# the cache is bounded because longer records are fused in blocks of one length
@lru_cache(maxsize=LENGTHS_KEPT)
def ladder_of(n_samples: int) -> BasisLadder:
    """Spline bases of a record length, kept for the next records of that length."""
    return BasisLadder(n_samples)
