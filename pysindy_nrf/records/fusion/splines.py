"""Splines on evenly spaced samples: least squares about measured values and
derivatives, in units of samples.

``x(t) = sum_k c_k B((t - t_0) / h - k)``, B the cardinal B-spline of degree 7, knots h
samples apart. No periodicity is assumed; everything is banded, so the cost is linear in
the number of samples. Degree 7 makes the second derivative right to ``(2 pi f / fs)^6 /
30240``.
"""

from collections.abc import Callable, Sequence
from functools import cache, cached_property, lru_cache
from itertools import combinations_with_replacement
from math import comb
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyder
from scipy.interpolate import BSpline, PPoly

from ...exceptions import ChannelError

DEGREE = 7
# The eight splines over one interval between knots: coefficients of the powers of the
# place in it, (power, spline).
PIECES = PPoly.from_spline(BSpline.basis_element(np.arange(DEGREE + 2.0))).c[
    ::-1, -DEGREE - 1 : DEGREE - 1 : -1
]
# Share of the roughness that settles the ends, where fewer samples than coefficients
# speak.
END_WEIGHT = 1e-8


class SplineBasis:
    """B-spline basis on n samples, ``size`` coefficients; knots h <= spacing samples
    apart divide the record evenly.
    """

    def __init__(self, n: int, spacing: float = 1.0) -> None:
        self.n = n
        intervals = max(1, int(np.ceil((n - 1) / spacing - 1e-9)))
        self.h = (n - 1) / intervals
        self.size = intervals + DEGREE

    @cached_property
    def _near(self) -> tuple[np.ndarray, np.ndarray]:
        """The first of the eight splines that are not zero at a sample; values and
        derivatives of these, (n, 3, 8).
        """
        count, last = self.size - DEGREE, self.n - 1
        at = count * np.arange(self.n)
        first = np.minimum(at // last, count - 1)
        powers = np.vander((at - first * last) / last, DEGREE + 1, increasing=True)
        parts = [
            powers[:, : DEGREE + 1 - o] @ polyder(PIECES, o, 1.0 / self.h)
            for o in range(3)
        ]
        return first, np.stack(parts, axis=1)

    @cached_property
    def grams(self) -> np.ndarray:
        """Normal matrices of value, first and second derivative with a roughness each,
        lower banded, (size, 3, 9).
        """
        first, near = self._near
        starts = np.searchsorted(first, np.arange(self.size - DEGREE))
        grams = np.stack(
            [
                _banded(np.ascontiguousarray(near[:, o].T), starts, self.size)
                for o in range(3)
            ],
            axis=1,
        )
        k, count = DEGREE + 1, max(self.size - DEGREE - 1, 0)
        differences = [
            np.full(count, float((-1) ** i * comb(k, i))) for i in range(k + 1)
        ]
        rough = END_WEIGHT * _banded(differences, np.arange(count), self.size)
        return grams + grams[:, :, :1].mean(axis=0) * rough[:, None]

    @cached_property
    def _inner(self) -> np.ndarray:
        """The three normal matrices inside the record, the mean over columns: samples
        sit differently between knots.
        """
        return self.grams[
            self.size // 4 : max(self.size // 4 + 1, 3 * self.size // 4)
        ].mean(axis=0)

    def symbols(self, w: np.ndarray) -> np.ndarray:
        """Fourier symbols of the three normal matrices inside the record."""
        return self._inner[:, :1] + 2 * self._inner[:, 1:] @ np.cos(
            np.arange(1, DEGREE + 2)[:, None] * w
        )

    @cached_property
    def spectrum(self) -> np.ndarray:
        """These symbols at 512 frequencies, evenly over all, not negative."""
        return np.maximum(self.symbols(np.pi * (np.arange(512) + 0.5) / 512), 0.0)

    def normal_matrix(self, weights: np.ndarray, rows: slice) -> np.ndarray:
        """Weighted sum of the normal matrices, lower banded form, some columns of it,
        (9, n_columns).
        """
        return np.einsum("kof,o->fk", self.grams[rows], weights)

    def solve(
        self, weights: np.ndarray, channels: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        """Coefficients that minimise the weighted squares about the channels; None is
        not measured.
        """
        seen = np.array([y is not None for y in channels]) * weights
        given = [channels[int(seen.argmax())] if y is None else y for y in channels]
        rows = (
            self.size + DEGREE + 1
        )  # elimination writes zeros past the last coefficient
        c, band = np.zeros(rows), np.empty((rows, DEGREE + 2))
        for ridge in (
            1.0,
            1.0 + 1e-13,
            1.0 + 1e-11,
            1.0 + 1e-9,
        ):  # heavily oversampled motion takes the last digits
            if compiled()[0](
                *self._near, self.grams, weights, seen, *given, ridge, band, c
            ):
                return c[: self.size]
        what = (
            "The motion cannot be determined at this sampling rate: it changes too"
            " little between samples"
        )
        raise ChannelError(
            what,
            "Resample to a lower rate, or give noise= levels to KinematicSmoother.",
        )

    def evaluate(self, coefficients: np.ndarray) -> np.ndarray:
        """The motion and its derivatives per sample at the samples, (3, n)."""
        return self.add(coefficients, np.ones(self.n), np.zeros((3, self.n)))

    def add(
        self, coefficients: np.ndarray, weight: np.ndarray, out: np.ndarray
    ) -> np.ndarray:
        """Add to ``out`` what :meth:`evaluate` gives, with a weight for each sample."""
        compiled()[1](*self._near, np.ascontiguousarray(coefficients), weight, *out)
        return out

    @cached_property
    def mean(self) -> np.ndarray:
        """Mean of every spline over the samples."""
        first, near = self._near
        return (
            np.bincount(
                (first[:, None] + np.arange(DEGREE + 1)).ravel(),
                near[:, 0].ravel(),
                self.size,
            )
            / self.n
        )


@cache
def compiled() -> tuple[Callable[..., bool], Callable[..., None]]:
    """Least squares and values of a spline. LAPACK takes four times as long: it calls a
    routine for each column.
    """
    from ...common.compiled import address_of, addresses, jit

    order, width = DEGREE + 1, DEGREE + 2  # of the splines; of a column of the band

    def spline_solve(first, near, grams, weights, seen, x, v, a, ridge, band, c):
        """Eliminate the coefficients in turn; False if the normal matrix is not
        positive definite.
        """
        size = grams.shape[0]
        w0, w1, w2, s0, s1, s2 = (
            weights[0],
            weights[1],
            weights[2],
            seen[0],
            seen[1],
            seen[2],
        )
        near, grams, band, c = addresses((near, grams, band, c))
        for k in range(size):
            row, of_x = address_of(band, width * k), address_of(grams, 3 * width * k)
            of_v, of_a = address_of(of_x, width), address_of(of_x, 2 * width)
            for j in range(width):
                row[j] = w0 * of_x[j] + w1 * of_v[j] + w2 * of_a[j]
            row[0] *= ridge
            c[k] = 0.0
        for t in range(first.shape[0]):
            right, of_x = address_of(c, first[t]), address_of(near, 3 * order * t)
            of_v, of_a = address_of(of_x, order), address_of(of_x, 2 * order)
            x_t, v_t, a_t = s0 * x[t], s1 * v[t], s2 * a[t]
            for j in range(order):
                right[j] += x_t * of_x[j] + v_t * of_v[j] + a_t * of_a[j]
        for k in range(size):
            row = address_of(band, width * k)
            if not row[0] > 0.0:
                return False
            inverse, value = 1.0 / row[0], c[k]
            for i in range(1, width):
                share, below = row[i] * inverse, address_of(row, width * i)
                for j in range(width - i):
                    below[j] -= share * row[i + j]
                c[k + i] -= share * value
            row[0] = inverse
        for k in range(size - 1, -1, -1):
            row, value = address_of(band, width * k), c[k]
            for i in range(width - 1, 0, -1):
                value -= row[i] * c[k + i]
            c[k] = value * row[0]
        return True

    def spline_values(first, near, c, weight, out_x, out_v, out_a):
        near, c = addresses((near, c))
        for t in range(first.shape[0]):
            here, of_x = address_of(c, first[t]), address_of(near, 3 * order * t)
            of_v, of_a = address_of(of_x, order), address_of(of_x, 2 * order)
            x = v = a = 0.0
            for j in range(order):
                x, v, a = (
                    x + here[j] * of_x[j],
                    v + here[j] * of_v[j],
                    a + here[j] * of_a[j],
                )
            out_x[t], out_v[t], out_a[t] = (
                out_x[t] + weight[t] * x,
                out_v[t] + weight[t] * v,
                out_a[t] + weight[t] * a,
            )

    return jit(spline_solve), jit(spline_values)


def _banded(rows: Any, starts: np.ndarray, size: int) -> np.ndarray:
    """Lower banded normal matrix: from each of the starts on, ``rows`` hold
    neighbouring columns, one further each.
    """
    out = np.zeros((size, DEGREE + 2))
    for i, j in combinations_with_replacement(
        range(len(rows) if len(starts) else 0), 2
    ):
        out[i : i + len(starts), j - i] += np.add.reduceat(rows[i] * rows[j], starts)
    return out


# Knot distances that are tried, samples.
LADDER = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)


class BasisLadder(dict[float, SplineBasis]):
    """Spline bases of one record length, built when needed and shared by all degrees of
    freedom.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.spacings = [h for h in LADDER if h == 1.0 or (n - 1) / h >= 12]

    def __missing__(self, spacing: float) -> SplineBasis:
        return self.setdefault(spacing, SplineBasis(self.n, spacing))


@lru_cache(
    maxsize=3
)  # the records of a search, those held out and SEARCH; a length has an upper bound
def ladder_of(n: int) -> BasisLadder:
    """Spline bases of a record length, kept for the next records of that length."""
    return BasisLadder(n)
