"""Imperfect but ordinary sensors: what every measuring chain has, and no effect."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

# White noise has its own parameter.
FAULTS = ("gain", "cross-axis", "delay", "low-pass", "bits", "jitter", "pink")
GAIN = 0.01  # scatter of the gains
CROSS_AXIS = 0.01  # share of another DOF's motion
DELAY = 0.2  # samples at most
CORNER = 0.2  # of a low-pass, as a share of the rate
BITS = 12
RANGE = 1.25  # of the converter, as a share of the peak
JITTER = 0.02  # of the clock, as a share of a step
PINK = 0.005  # noise as a share of the rms
MOTIONS = ("acceleration", "velocity", "displacement")


def imperfect(rng, channels: dict, fault: str) -> dict:
    """The channels of a record as such sensors read them."""
    out = dict(channels)
    n = len(channels["acceleration"])
    clock = np.arange(n) + JITTER * rng.standard_normal(n)
    apply = reader(rng, fault, clock, channels["fs"])

    for key in (*MOTIONS, "force"):
        if key not in channels:
            continue
        y = np.array(channels[key], dtype=float)
        if fault == "cross-axis":
            read = y if key == "force" else with_neighbour(rng, y)
        else:
            read = apply(y)
        out[key] = np.where(y.any(axis=0), read, 0.0)
    return out


def reader(rng, fault: str, clock: np.ndarray, fs: float) -> Callable:
    """How sensors with this fault read a channel of all DOFs."""
    return {
        "gain": lambda y: y * (1.0 + GAIN * rng.standard_normal(y.shape[1])),
        "delay": lambda y: delayed(y, DELAY * rng.random(y.shape[1])),
        "low-pass": lambda y: low_passed(y, fs),
        "bits": quantised,
        "jitter": lambda y: read_at(y, clock),
        "pink": lambda y: y + PINK * np.sqrt(np.mean(y**2, axis=0)) * pink(rng, y),
    }.get(fault)


def with_neighbour(rng, y: np.ndarray) -> np.ndarray:
    """Each channel with a little of the next one."""
    if y.shape[1] == 1:
        return y
    return y + CROSS_AXIS * rng.choice([-1.0, 1.0]) * np.roll(y, 1, axis=1)


def delayed(y: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Each channel late by a part of a sample."""
    rows = np.arange(len(y))
    columns = [read_at(y[:, j], rows - late) for j, late in enumerate(samples)]
    return np.column_stack(columns)


def read_at(y: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A channel between its samples."""
    return CubicSpline(np.arange(len(y)), y)(np.clip(rows, 0, len(y) - 1))


def low_passed(y: np.ndarray, fs: float) -> np.ndarray:
    return sosfilt(butter(4, CORNER * fs, fs=fs, output="sos"), y, axis=0)


def quantised(y: np.ndarray) -> np.ndarray:
    """A channel by a converter of some bits; one that is zero stays."""
    step = 2.0 * RANGE * np.abs(y).max(axis=0) / 2**BITS
    return step * np.round(y / np.where(step > 0, step, 1.0))


def pink(rng, y: np.ndarray) -> np.ndarray:
    """Noise of rms 1 for each column; its power falls with one over the frequency."""
    columns = []
    for _ in range(y.shape[1]):
        spectrum = np.fft.rfft(rng.standard_normal(len(y)))
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        spectrum[0] = 0.0
        column = np.fft.irfft(spectrum, len(y))
        columns.append(column / np.sqrt(np.mean(column**2)))
    return np.column_stack(columns)
