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


class Signal:
    """Contiguous records of one signal, means taken off, with their Fourier transforms.

    Parameters
    ----------
    parts : sequence of ndarray
        One for each record.

    Attributes
    ----------
    sizes : list of (int, int)
        Samples and length of the zero-padded transform of each record.
    spectra : list of ndarray of complex
    power : list of ndarray
        Their squared magnitudes.
    energy : float
        Sum of the squares.
    """

    def __init__(self, parts: Parts) -> None:
        from scipy.fft import next_fast_len, rfft

        centred = [x - x.mean() for x in parts]
        self.sizes = [(len(x), next_fast_len(2 * len(x), real=True)) for x in centred]
        self.spectra = [rfft(x, size) for x, (_, size) in zip(centred, self.sizes)]
        self.power = [X.real**2 + X.imag**2 for X in self.spectra]
        self.energy = float(sum(x @ x for x in centred))


def cross_covariance(x: Parts | Signal, y: Parts | Signal, lags: int, first: int | None = None) -> Cross:
    """Cross-covariance of two signals over contiguous records, means taken off."""
    from scipy.fft import irfft

    x, y = (s if isinstance(s, Signal) else Signal(s) for s in (x, y))
    lag = np.arange(-lags if first is None else first, lags + 1)
    total, variance, slope = np.zeros(lag.size), 0.0, 0.0
    for X, Y, p, q, (count, size) in zip(x.spectra, y.spectra, x.power, y.power, x.sizes):
        total += irfft(X.conj() * Y, size)[lag]
        # the sum over lags of both autocovariances is the sum over frequencies of both periodograms
        both = p * q / (size * count)
        both[1:] *= 2
        variance += both.sum()
        slope += np.linspace(0, np.pi, both.size) ** 2 @ both
    omega = np.sqrt(slope / variance) if variance > 0 else 0.0
    return Cross(lag, total, float(np.sqrt(variance)), float(np.sqrt(x.energy * y.energy)), float(omega))


def probability_of_peak(height: float, n_lags: int, omega: float) -> float:
    """Probability that the correlation of independent signals exceeds a height at any lag."""
    from scipy.special import ndtr

    single = 2 * float(ndtr(-height))
    further = min(omega / np.pi * np.exp(-(height**2) / 2), single)
    return float(-np.expm1(np.log1p(-min(single, 1 - 1e-16)) - (n_lags - 1) * further))


def peak_limit(level: float, n_lags: int, omega: float) -> float:
    """Height, in standard deviations, that :func:`probability_of_peak` gives the probability ``level``."""
    from scipy.optimize import brentq

    return float(brentq(lambda h: probability_of_peak(h, n_lags, omega) - level, 1e-3, 40.0))


def whitened_autocorrelation(parts: Parts, density: Sequence[np.ndarray], lags: int) -> tuple[np.ndarray, int]:
    r"""Autocorrelation of a signal after division of its spectrum by a reference, in the reference's band alone."""
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
