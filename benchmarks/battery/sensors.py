"""Imperfect but ordinary sensors: what every measuring chain has, and no effect of the
structure.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

# White noise has its own parameter.
FAULTS = ("gain", "cross-axis", "delay", "low-pass", "bits", "jitter", "pink")
GAIN, CROSS_AXIS, DELAY, CORNER, BITS, JITTER, PINK = (
    0.01,
    0.01,
    0.2,
    0.2,
    12,
    0.02,
    0.005,
)


def imperfect(rng, channels: dict, fault: str) -> dict:
    """The channels of a record as such sensors read them.

    Gains scatter by 1 %; a sensor reads 1 % of another DOF's motion; channels are up to
    0.2 samples late; all go through one low-pass at a fifth of the rate; 12 bits of a
    range of 1.25 times the peak; the clock jitters by 2 % of a step; pink noise of 0.5
    %.
    """
    out = dict(channels)
    motions = [
        key for key in ("acceleration", "velocity", "displacement") if key in channels
    ]
    fs = channels["fs"]
    n = len(channels[motions[0]])
    when = np.arange(n) + JITTER * rng.standard_normal(n)
    for key in (*motions, "force"):
        if key not in channels:
            continue
        y = np.array(channels[key], dtype=float)
        live = y.any(axis=0)
        if fault == "gain":
            y = y * (1.0 + GAIN * rng.standard_normal(y.shape[1]))
        elif fault == "cross-axis" and key in motions and y.shape[1] > 1:
            y = y + CROSS_AXIS * rng.choice([-1.0, 1.0]) * np.roll(y, 1, axis=1)
        elif fault == "delay":
            spline = CubicSpline(np.arange(n), y)
            late = DELAY * rng.random(y.shape[1])
            y = np.column_stack(
                [
                    spline(np.clip(np.arange(n) - d, 0, n - 1))[:, j]
                    for j, d in enumerate(late)
                ]
            )
        elif fault == "low-pass":
            y = sosfilt(butter(4, CORNER * fs, fs=fs, output="sos"), y, axis=0)
        elif fault == "bits":
            step = 2.0 * 1.25 * np.abs(y).max(axis=0) / 2**BITS
            y = np.where(live, step * np.round(y / np.where(step > 0, step, 1.0)), 0.0)
        elif fault == "jitter":
            y = CubicSpline(np.arange(n), y)(np.clip(when, 0, n - 1))
        elif fault == "pink":
            y = y + PINK * np.sqrt(np.mean(y**2, axis=0)) * np.column_stack(
                [_pink(rng, n) for _ in range(y.shape[1])]
            )
        out[key] = np.where(live, y, 0.0)
    return out


def _pink(rng, n: int) -> np.ndarray:
    """Noise whose power falls with one over the frequency, rms 1."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    spectrum[0] = 0.0
    y = np.fft.irfft(spectrum, n)
    return y / np.sqrt(np.mean(y**2))
