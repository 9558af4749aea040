"""Noise of measured channels: its level by quiet frequencies or times, a drive freed of
it, fresh noise for a run.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import welch

from ..record import BASES, Record

LOUDEST = 0.2  # of a signal's rms: what is louder is signal, not noise
RARE = 0.01  # chance that a stretch as quiet as noise is none
_FEWEST, _WINDOW = 256, 64  # samples that tell a level, and of a stretch in time


def quiet_level(signal: np.ndarray, fs: float, rows: np.ndarray | None = None) -> float:
    """Rms of the white noise under a signal, from its quiet frequencies or its quiet
    times, in the chosen rows.

    Runs of rows are read one by one: a step from one to the next has power at all
    frequencies.
    """
    known = np.isfinite(signal) if rows is None else np.isfinite(signal) & rows
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    runs = [signal[a:b] for a, b in zip(edges[::2], edges[1::2])]
    count = sum(map(len, runs))
    if count < _FEWEST:
        return 0.0
    size = min(1024, count // 8, max(map(len, runs)))
    densities = [
        welch(run, fs, nperseg=size, detrend="constant")[1]
        for run in runs
        if len(run) >= size
    ]
    pieces = [2 * len(run) // size - 1 for run in runs if len(run) >= size]
    density = np.average(densities, axis=0, weights=pieces)
    by_frequency = (
        flat_level(density[1:-1], 2 * sum(pieces) / (1 + 1 / 18)) * fs / 2
    )  # Hann windows overlap by half
    windows = [
        run[: len(run) // _WINDOW * _WINDOW].reshape(-1, _WINDOW) for run in runs
    ]
    powers = (np.concatenate(windows) ** 2).mean(axis=1)
    level = float(
        np.sqrt(
            min(by_frequency, flat_level(powers, _WINDOW) if len(powers) else np.inf)
        )
    )
    return (
        level if level < LOUDEST * float(np.sqrt(np.mean(signal[known] ** 2))) else 0.0
    )


def denoised(signal: np.ndarray, level: float, fs: float) -> np.ndarray:
    """A signal without the white noise beneath it (Wiener's filter), as far as
    frequencies tell them apart.
    """
    if level <= 0 or len(signal) < _FEWEST or not np.isfinite(signal).all():
        return signal
    f, density = welch(signal, fs, nperseg=min(1024, len(signal) // 8), detrend=False)
    # twice the noise taken off: what is left of its scatter would be force
    gain = np.clip(
        1.0 - 2.0 * level**2 * 2.0 / fs / np.maximum(density, 1e-300), 0.0, 1.0
    )
    spectrum = np.fft.rfft(signal)
    return np.fft.irfft(
        spectrum * np.interp(np.fft.rfftfreq(len(signal), 1 / fs), f, gain), len(signal)
    )


def levels_of(
    record: Record, motion: Mapping[str, float], rows: np.ndarray | None = None
) -> dict[str, float]:
    """Noise of every channel of a record."""
    channels, fs = record.channels(), record.fs
    levels = {str(k): float(v) for k, v in motion.items()}
    levels |= {
        f"F{j}": quiet_level(record.force[:, j - 1], fs, rows) for j in record.forced
    }
    levels |= {
        name: quiet_level(np.asarray(channels[name]), fs, rows)
        for name in BASES.values()
        if name in channels
    }
    if record.coordinates == "relative" and (base := levels.get("ag", 0.0)) > 0:
        for name in (k for k in levels if k[0] == "a" and k in motion):
            levels[name] = float(np.sqrt(max(levels[name] ** 2 - base**2, 0.0)))
    return levels


def quiet_drive(record: Record, levels: Mapping[str, float]) -> Record:
    """A record whose forces and base motion are freed of noise, for a free run."""
    changes = {
        key: denoised(
            np.asarray(getattr(record, key), dtype=float), levels[name], record.fs
        )
        for key, name in BASES.items()
        if name in levels and getattr(record, key) is not None
    }
    force = np.array(record.force, dtype=float)
    for j in record.forced:
        force[:, j - 1] = denoised(force[:, j - 1], levels.get(f"F{j}", 0.0), record.fs)
    return record.replace(force=force, **changes)


def noisy_base(
    record: Record, levels: Mapping[str, float], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Fresh noise on the measured motion of the base; fields of the record by name."""
    out = {}
    for key, name in BASES.items():
        if levels.get(name, 0.0) > 0 and getattr(record, key) is not None:
            line = np.asarray(getattr(record, key), dtype=float)
            out[key] = line + levels[name] * rng.standard_normal(len(line))
    return out


def flat_level(values: np.ndarray, dof: float) -> float:
    """Mean of the lowest part of values that scatters like noise."""
    from scipy.stats import chi2

    values = np.sort(values)
    reach = chi2.ppf(1 - RARE, dof) / dof
    count = max(3, len(values) // 20)
    for _ in range(len(values)):
        more = int(np.searchsorted(values, reach * values[:count].mean(), side="right"))
        if more <= count:
            break
        count = more
    return float(values[:count].mean())
