"""Random excitations of the battery: noise, hammer blows, sweeps, earthquakes."""

from __future__ import annotations

import numpy as np

EXCITATIONS = ("random", "hammer", "sweep", "earthquake")


def draw_loads(
    rng, kind: str, n_columns: int, n: int, fs: float, f: np.ndarray
) -> np.ndarray:
    """Columns of one kind of excitation over natural frequencies f (Hz), any scale."""
    low, high = 0.4 * f[0], min(1.4 * f[-1], 0.2 * fs)
    t = np.arange(n) / fs
    if kind == "random":
        columns = [band_noise(rng, n, fs, low, high) for _ in range(n_columns)]
        return np.column_stack(columns)
    if kind == "hammer":
        return hammer_blows(rng, t, n_columns, high)
    if kind == "sweep":
        return sweeps(rng, t, n_columns, low, high)

    out = np.zeros((n, n_columns))
    for j in range(n_columns):
        out[:, j] = earthquake(rng, t, fs, (low, high), f)
    return out


def band_noise(rng, n: int, fs: float, low: float, high: float) -> np.ndarray:
    """Gaussian noise between two frequencies (Hz), rms 1."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    f = np.fft.rfftfreq(n, 1 / fs)
    spectrum[(f < low) | (f > high)] = 0.0
    y = np.fft.irfft(spectrum, n)
    return y / np.sqrt(np.mean(y**2))


def hammer_blows(rng, t: np.ndarray, n_columns: int, high: float) -> np.ndarray:
    """Half-sines, on each column in turn, whose spectrum reaches to ``high`` (Hz)."""
    width = 0.7 / high
    n_hits = max(6, 3 * n_columns) + int(rng.integers(0, 4))
    out = np.zeros((len(t), n_columns))
    for hit in range(n_hits):
        start = t[-1] * (hit + rng.uniform(0.02, 0.4)) / n_hits
        inside = (t >= start) & (t <= start + width)
        size = rng.uniform(0.6, 1.4) * rng.choice([-1, 1])
        blow = np.sin(np.pi * (t[inside] - start) / width)
        out[inside, hit % n_columns] += size * blow
    return out


def sweeps(rng, t: np.ndarray, n_columns: int, low: float, high: float) -> np.ndarray:
    """Logarithmic sweeps, up or down, that fade in."""
    out = np.zeros((len(t), n_columns))
    for j in range(n_columns):
        begin = low * rng.uniform(0.8, 1.2)
        end = high * rng.uniform(0.8, 1.0)
        rate = np.log(end / begin) / t[-1]
        phase = 2 * np.pi * begin * (np.exp(rate * t) - 1) / rate
        y = np.sin(phase + rng.uniform(0, 2 * np.pi))
        upwards = rng.random() < 0.5 or n_columns == 1
        out[:, j] = y if upwards else y[::-1]

    ramp = np.clip(t / (0.03 * t[-1]), 0, 1)
    return out * (np.sin(0.5 * np.pi * ramp) ** 2)[:, None]


def earthquake(
    rng, t: np.ndarray, fs: float, band: tuple[float, float], f: np.ndarray
) -> np.ndarray:
    """Noise through a Kanai-Tajimi filter, under an envelope."""
    low, high = band
    white = np.fft.rfft(rng.standard_normal(len(t)))
    ground = np.exp(rng.uniform(np.log(0.7 * f[0]), np.log(1.2 * f[-1])))
    line = np.fft.rfftfreq(len(t), 1 / fs)
    gain = kanai_tajimi(line / ground)
    gain[(line < 0.3 * low) | (line > high)] = 0.0
    y = np.fft.irfft(white * gain, len(t))

    u = t / t[-1]
    rise = np.clip(u / 0.15, 0, 1) ** 2
    return y * rise * np.exp(-2.5 * np.clip(u - 0.4, 0, None))


def kanai_tajimi(r: np.ndarray) -> np.ndarray:
    """Gain of the filter over the frequency ratio, high-passed."""
    z = 0.5  # damping ratio of the ground
    damping = (2 * z * r) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.sqrt((1 + damping) / ((1 - r**2) ** 2 + damping))
        return ground * r**2 / np.sqrt(1 + r**4)


def base_motion(ag: np.ndarray, fs: float, low: float) -> tuple[np.ndarray, ...]:
    """Acceleration, velocity and displacement of a base, without content below low/3.

    ``low`` is in Hz.
    """
    f = np.fft.rfftfreq(len(ag), 1 / fs)
    inside = f > low / 3
    w = 2 * np.pi * np.where(inside, f, 1.0)
    spectrum = np.where(inside, np.fft.rfft(ag), 0.0)
    motions = (spectrum, spectrum / (1j * w), -spectrum / w**2)
    return tuple(np.fft.irfft(motion, len(ag)) for motion in motions)
