"""A spectral line of a residual that stands out of its surroundings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...laws.shape import Motion
from ...records.fusion.noise_levels import RARE

# How many neighbouring lines of a Hann window count as one: 1 + 2 ((2/3)^2 + (1/6)^2).
HANN_OVERLAP = 35 / 18
# Samples below which no line is looked for.
LEAST_SAMPLES = 64
# Lines about a line that are its surroundings.
SURROUNDINGS = 101
# Lowest and highest lines that are left out.
END_LINES = 3
# Points between two lines at which its frequency is found.
FINE_POINTS = 81


def spectral_line(residuals: Sequence[np.ndarray], motions: Sequence[Motion]) -> float:
    """Frequency of the highest line of a residual that stands out, Hz.

    In the longest record. NaN if none does.

    Parameters
    ----------
    residuals : sequence of ndarray of shape (n_samples,)
        One for each record.
    motions : sequence of Motion
        With their times, s.

    Returns
    -------
    float

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.diagnosis import spectral_line
    >>> from pysindy_nrf.laws import Motion
    >>> t = np.arange(1000) / 100
    >>> noise = np.random.default_rng(0).standard_normal(1000)
    >>> line = np.cos(2 * np.pi * 11.37 * t)
    >>> round(spectral_line([line + 0.1 * noise], [Motion(t, t, t=t)]), 1)
    11.4
    """
    longest = int(np.argmax([len(residual) for residual in residuals]))
    residual, t = residuals[longest], motions[longest].t
    n = len(residual)
    windowed = residual * np.hanning(n)
    power = np.abs(np.fft.rfft(windowed)) ** 2
    if t is None or n < LEAST_SAMPLES or not power.any():
        return float("nan")

    peak, is_rare = _peak(power)
    if not is_rare:
        return float("nan")
    dt = (t[-1] - t[0]) / (n - 1)
    return _fine_frequency(windowed, peak, dt)


def _peak(power: np.ndarray) -> tuple[int, bool]:
    """The line that stands out most, and whether chance makes such a line rarely."""
    from scipy.ndimage import median_filter

    size = min(SURROUNDINGS, len(power) // 2 * 2 - 1)
    around = median_filter(power, size=size, mode="mirror") / np.log(2)
    ratio = power / np.maximum(around, 1e-12 * power.max())
    ratio[:END_LINES] = 0.0
    ratio[-END_LINES:] = 0.0
    peak = int(ratio.argmax())

    # an exponential over a scale that is itself estimated: F with 2 and 2 k degrees of
    # freedom
    k = size * np.log(2) ** 2 / HANN_OVERLAP
    expected = len(power) * (1.0 + ratio[peak] / k) ** -k
    return peak, bool(expected <= RARE)


def _fine_frequency(windowed: np.ndarray, peak: int, dt: float) -> float:
    """Frequency of a peak between the lines beside it, Hz."""
    from scipy.signal import zoom_fft

    n = len(windowed)
    low, high = (peak - 1) / (n * dt), (peak + 1) / (n * dt)
    fine = zoom_fft(windowed, [low, high], FINE_POINTS, fs=1 / dt, endpoint=True)
    frequencies = np.linspace(low, high, FINE_POINTS)
    return float(frequencies[np.abs(fine).argmax()])
