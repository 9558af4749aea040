"""Correlation tests between signals with a spectrum of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Parts = Sequence[np.ndarray]


@dataclass
class Cross:
    r"""Cross-covariance of two signals and what it would be if they were independent.

    Attributes
    ----------
    lag : ndarray of int
        tau, samples; positive where x leads y.
    total : ndarray
        ``sum_t x(t) y(t + tau)``.
    spread : float
        Standard deviation of ``total`` under independence by Bartlett's formula,
        ``Var = N sum_k gamma_x(k) gamma_y(k)``. It holds for signals of any colour: a filtered
        signal needs no whitening.
    energy : float
        ``sqrt(sum x^2 sum y^2)``.
    omega : float
        Rms angular frequency (rad per sample) of ``total`` under independence, as a function of the lag.
    """

    lag: np.ndarray
    total: np.ndarray
    spread: float
    energy: float
    omega: float

    @property
    def moves(self) -> bool:
        """Whether both signals move."""
        return self.spread > 0 and self.energy > 0


def cross_covariance(x: Parts, y: Parts, lags: int, first: int | None = None) -> Cross:
    """Cross-covariance of two signals over contiguous records, means taken off.

    Parameters
    ----------
    x, y : sequence of ndarray
        One pair for each record.
    lags : int
        Largest lag, samples.
    first : int, optional
        Smallest lag; ``-lags`` if None.

    Returns
    -------
    Cross
    """
    from scipy.fft import irfft, next_fast_len, rfft

    lag = np.arange(-lags if first is None else first, lags + 1)
    total, variance, slope, energy = np.zeros(lag.size), 0.0, 0.0, np.zeros(2)
    for a, b in zip(x, y):
        a, b = a - a.mean(), b - b.mean()
        size = next_fast_len(2 * len(a), real=True)
        X, Y = rfft(a, size), rfft(b, size)
        total += irfft(X.conj() * Y, size)[lag]
        # the sum over lags of both autocovariances is the sum over frequencies of both periodograms
        both = (X.real**2 + X.imag**2) * (Y.real**2 + Y.imag**2) / (size * len(a))
        both[1:] *= 2
        variance += both.sum()
        slope += np.linspace(0, np.pi, both.size) ** 2 @ both
        energy += a @ a, b @ b
    omega = np.sqrt(slope / variance) if variance > 0 else 0.0
    return Cross(lag, total, float(np.sqrt(variance)), float(np.sqrt(energy[0] * energy[1])), float(omega))


def probability_of_peak(height: float, n_lags: int, omega: float) -> float:
    """Probability that the correlation of independent signals exceeds a height at any lag.

    Parameters
    ----------
    height : float
        In standard deviations.
    n_lags : int
    omega : float
        See :class:`Cross`: neighbouring lags of slow signals are not independent (Rice's formula).

    Returns
    -------
    float
    """
    from scipy.stats import norm

    single = 2 * norm.sf(height)
    further = min(omega / np.pi * np.exp(-(height**2) / 2), single)
    return float(-np.expm1(np.log1p(-min(single, 1 - 1e-16)) - (n_lags - 1) * further))


def peak_limit(level: float, n_lags: int, omega: float) -> float:
    """Height, in standard deviations, that :func:`probability_of_peak` gives the probability ``level``."""
    from scipy.optimize import brentq

    return float(brentq(lambda h: probability_of_peak(h, n_lags, omega) - level, 1e-3, 40.0))


def whitened_autocorrelation(parts: Parts, density: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    r"""Autocorrelation of a signal after division of its spectrum by a reference, in the reference's band alone.

    .. math:: \phi(\tau) = \sum_k r_k \cos(\pi k \tau / M) / \sum_k r_k, \quad r_k = I_k / S_k

    over the M frequencies with ``S_k > max S / 4`` (beyond, what leaks from the band outweighs the
    rest): they are spread over the whole axis, so that noise of the reference's colour becomes white and
    :math:`\phi` has the standard deviation ``1/sqrt(2 M)``.

    Parameters
    ----------
    parts : sequence of ndarray
    density : sequence of ndarray
        Reference spectrum of each record at the frequencies of ``rfft``, of any level.
    lags : int

    Returns
    -------
    phi : ndarray of shape (lags,)
        From lag 1.
    n : int
        2 M: the number of white samples it is worth.
    """
    lag = np.arange(1, lags + 1)
    top, bottom, n = np.zeros(lags), 0.0, 0
    for e, S in zip(parts, density):
        ratio = np.abs(np.fft.rfft(e - e.mean()))[1:] ** 2
        S = S[1:]
        inside = np.flatnonzero(S > 0.25 * S.max())
        ratio = ratio[inside] / S[inside]
        k = (np.arange(len(ratio)) + 0.5) / len(ratio)
        top += np.cos(np.pi * np.outer(lag, k)) @ ratio
        bottom += ratio.sum()
        n += 2 * len(ratio)
    return (top / bottom if bottom > 0 else top), n
