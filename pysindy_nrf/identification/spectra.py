"""Fourier lines of records, and spectra that vary slowly with frequency.

Densities are two-sided, in the squared unit of the channel per Hz.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import dct, idct

from ..records.dataset import Segment
from ..records.fusion.noise_levels import white_level
from ..records.zero_phase_filter import Band

MAX_BINS = 28
MIN_LINES_PER_BIN = 12
# Lines of noise have an exponential density, whose median is ln 2 times its mean.
MEDIAN_OVER_MEAN = float(np.log(2.0))
# Differences that show the white noise of a channel: high orders hold little motion,
# low ones little of a noise that is not quite white.
DIFFERENCE_ORDERS = (4, 10)


@dataclass(frozen=True)
class SmoothSpectrum:
    """Spectra that vary slowly: ``f`` in Hz, ``values`` (n_bins, n_columns)."""

    f: np.ndarray
    values: np.ndarray

    def __call__(self, f: np.ndarray) -> np.ndarray:
        """Values at some frequencies, (len(f), n_columns); constant beyond the ends."""
        log_f = np.log(np.maximum(f, 1e-300))
        centres = np.log(self.f)
        logs = np.log(np.maximum(self.values, 1e-300))

        columns = [np.interp(log_f, centres, column) for column in logs.T]
        return np.exp(np.column_stack(columns))


def mean_spectrum(
    frequencies: Sequence[np.ndarray], densities: Sequence[np.ndarray]
) -> SmoothSpectrum:
    """Mean density of several records in bins of equal width in log f."""
    return _binned(frequencies, densities, np.mean)


def median_spectrum(
    frequencies: Sequence[np.ndarray], densities: Sequence[np.ndarray]
) -> SmoothSpectrum:
    """Density of noise in bins, from medians: single lines of motion do not count."""
    medians = _binned(frequencies, densities, np.median)
    return replace(medians, values=medians.values / MEDIAN_OVER_MEAN)


def _binned(
    frequencies: Sequence[np.ndarray],
    densities: Sequence[np.ndarray],
    average: Callable[..., np.ndarray],
) -> SmoothSpectrum:
    f = np.concatenate(frequencies)
    order = np.argsort(f, kind="stable")
    f = f[order]
    values = np.concatenate(densities)[order]

    centres = []
    averages = []
    for lines in _bins(f):
        centres.append(np.exp(np.log(f[lines]).mean()))
        averages.append(average(values[lines], axis=0))
    return SmoothSpectrum(np.array(centres), np.array(averages))


def _bins(f: np.ndarray) -> list[slice]:
    """Bins of equal width in log f, those with too few lines joined to the next."""
    inner_edges = np.geomspace(f[0], f[-1], MAX_BINS + 1)[1:-1]

    edges = [0]
    for edge in np.searchsorted(f, inner_edges).tolist():
        if min(edge - edges[-1], len(f) - edge) >= MIN_LINES_PER_BIN:
            edges.append(edge)
    edges.append(len(f))

    return [slice(low, high) for low, high in pairwise(edges)]


def line_frequencies(segment: Segment) -> np.ndarray:
    """Frequencies of a record's Fourier lines without the first, Hz."""
    return np.fft.rfftfreq(segment.n_valid, segment.step)[1:]


def fourier_lines(values: np.ndarray, dt: float, taper: bool = False) -> np.ndarray:
    """Fourier lines of columns without the first, scaled so that |.|^2 is a density."""
    n = len(values)
    if taper:
        phase = 2 * np.pi * (np.arange(n) + 0.5) / n
        window = np.sqrt(2 / 3) * (1 - np.cos(phase))
        values = values * window[:, None]
    return np.fft.rfft(values, axis=0)[1:] * np.sqrt(dt / n)


def relative_velocities(segment: Segment) -> np.ndarray:
    """Velocities of the DOFs relative to the base, shape (n_valid, n_dof)."""
    return np.cumsum(segment.v[segment.valid], axis=1, dtype=float)


def common_band(data: Sequence[Segment], band: Band = None) -> tuple[float, float]:
    """Frequency band that a setting and all records share, Hz."""
    low = 0.0
    high = np.inf
    for limits in (band, *(segment.band for segment in data)):
        if limits is None:
            continue
        if limits[0] is not None:
            low = max(low, limits[0])
        if limits[1] is not None:
            high = min(high, limits[1])
    return float(low), float(high)


def white_density(channel: np.ndarray, dt: float) -> float:
    """Density of the white noise of a channel, from its differences."""
    levels = [white_level(channel.astype(float), order) for order in DIFFERENCE_ORDERS]
    return min(levels) ** 2 * dt


@dataclass(frozen=True)
class Whitener:
    """A zero-phase filter of given squared amplitude in a band (Hz)."""

    weight: SmoothSpectrum
    band: tuple[float, float]

    def amplitude(self, f: np.ndarray) -> np.ndarray:
        """Amplitude at frequencies in Hz."""
        low, high = self.band
        inside = (f >= low) & (f <= high)
        return np.where(inside, np.sqrt(self.weight(f)[:, 0]), 0.0)

    def apply(self, rows: np.ndarray, dt: float) -> np.ndarray:
        """Filter the rows of one record, (n_rows, n_samples)."""
        n = rows.shape[1]
        amplitude = self.amplitude(np.arange(n) / (2 * n * dt))
        return idct(dct(rows, axis=1) * amplitude, axis=1)
