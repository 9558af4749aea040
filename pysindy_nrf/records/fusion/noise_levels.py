"""Noise of measured channels: its level, signals freed of it, fresh noise for a run."""

from collections.abc import Mapping
from math import comb

import numpy as np
from scipy.signal import welch
from scipy.special import erfinv

from ..record import BASES, OF_LETTER, Record

# Share of a signal's rms above which what is found is signal, not noise.
MAX_NOISE_SHARE = 0.2
# Chance that a stretch as quiet as noise is none.
RARE = 0.01
# Samples that a level needs, and samples of the windows in time.
MIN_SAMPLES = 256
WINDOW = 64
# Samples of the longest window in frequency.
MAX_SEGMENT = 1024
# Half-overlapping Hann windows are correlated: 2 K windows count as 2 K / (1 + 1/18)
# degrees of freedom (Welch 1967).
HANN_CORRELATION = 1 / 18
# Share of samples, the quietest ones, from which the noise under friction and blows is
# found: these leave kinks, noise is everywhere.
QUIETEST = 0.1
# Median of the magnitude of a standard normal variable.
NORMAL_MEDIAN = 0.6745


def white_level(y: np.ndarray, order: int = 4) -> float:
    """Level of the white noise that explains the differences of a channel.

    It is its noise, and what motion adds to the differences of that order.
    """
    if len(y) < 4 * order:
        return float(1e-3 * np.sqrt(np.mean(y**2)))
    steps = np.abs(np.diff(y, order))
    # a channel that rests to the last bit for most of the record has noise in the rest
    if 2 * np.count_nonzero(steps) < steps.size:
        steps = steps[steps > 0]
    if not steps.size:
        return 0.0
    return float(np.median(steps) / NORMAL_MEDIAN / np.sqrt(comb(2 * order, order)))


# Order of the differences in which a smooth motion vanishes and white noise stays.
DIFFERENCES_OF_QUIETEST = 10


def level_of_quietest(y: np.ndarray) -> float:
    """Level of the white noise of a channel in its quietest samples."""
    order = DIFFERENCES_OF_QUIETEST
    steps = np.diff(y, order)
    if len(y) < 4 * order or not steps.any():
        return white_level(y, order)
    return rms_of_quietest(steps[steps != 0]) / comb(2 * order, order) ** 0.5


def rms_of_quietest(values: np.ndarray) -> float:
    """Rms of the normal noise that has the same quietest tenth."""
    quiet = np.quantile(np.abs(values), QUIETEST)
    return float(quiet / (2**0.5 * erfinv(QUIETEST)))


def changing_samples(y: np.ndarray) -> slice | np.ndarray:
    """Samples at which a channel changes; all of them, unless it rests to the last bit
    for more than half of the record.
    """
    moves = np.diff(y) != 0
    if 2 * np.count_nonzero(moves) >= moves.size or not moves.any():
        return slice(None)
    return np.r_[moves, False] | np.r_[False, moves]


def quiet_level(signal: np.ndarray, fs: float, rows: np.ndarray | None = None) -> float:
    """Rms of the white noise under a signal, from its quiet frequencies or its quiet
    times.

    Parameters
    ----------
    signal : ndarray of shape (n_samples,)
        NaN where it is not known.
    fs : float
        Sampling rate, Hz.
    rows : ndarray of bool, optional
        The samples that count. Runs of them are read one by one: a step from one to the
        next has power at all frequencies.

    Returns
    -------
    float
        0 if the samples are too few, or what is found is too loud to be noise.
    """
    known = np.isfinite(signal)
    if rows is not None:
        known = known & rows
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    runs = [signal[start:stop] for start, stop in zip(edges[::2], edges[1::2])]
    count = sum(map(len, runs))
    if count < MIN_SAMPLES:
        return 0.0

    power = min(_power_by_frequency(runs, fs), _power_by_time(runs))
    level = float(np.sqrt(power))
    rms = float(np.sqrt(np.mean(signal[known] ** 2)))
    return level if level < MAX_NOISE_SHARE * rms else 0.0


def _power_by_frequency(runs: list[np.ndarray], fs: float) -> float:
    """Power of the white noise that explains the quietest frequencies of some runs."""
    longest = max(map(len, runs))
    segment = min(MAX_SEGMENT, sum(map(len, runs)) // 8, longest)
    runs = [run for run in runs if len(run) >= segment]
    densities = [welch(run, fs, nperseg=segment, detrend="constant")[1] for run in runs]
    windows = [2 * len(run) // segment - 1 for run in runs]
    density = np.average(densities, axis=0, weights=windows)
    freedom = 2 * sum(windows) / (1 + HANN_CORRELATION)
    return flat_level(density[1:-1], freedom) * fs / 2


def _power_by_time(runs: list[np.ndarray]) -> float:
    """Power in the quietest windows of some runs; infinite if none has a window."""
    windows = [run[: len(run) // WINDOW * WINDOW].reshape(-1, WINDOW) for run in runs]
    powers = (np.concatenate(windows) ** 2).mean(axis=1)
    return flat_level(powers, WINDOW) if len(powers) else np.inf


def flat_level(values: np.ndarray, freedom: float) -> float:
    """Mean of the lowest part of values that scatters like noise.

    Parameters
    ----------
    values : ndarray of shape (n,)
        Powers, chi-squared with so many degrees of freedom where they are noise.
    freedom : float
    """
    from scipy.stats import chi2

    values = np.sort(values)
    largest_by_chance = chi2.ppf(1 - RARE, freedom) / freedom
    count = max(3, len(values) // 20)
    for _ in range(len(values)):
        limit = largest_by_chance * values[:count].mean()
        below = int(np.searchsorted(values, limit, side="right"))
        if below <= count:
            break
        count = below
    return float(values[:count].mean())


def denoised(signal: np.ndarray, level: float, fs: float) -> np.ndarray:
    """A signal without the white noise beneath it, by Wiener's filter.

    Parameters
    ----------
    signal : ndarray of shape (n_samples,)
        Returned as it is if it is not finite, or too short.
    level : float
        Rms of the noise.
    fs : float
        Sampling rate, Hz.
    """
    if level <= 0 or len(signal) < MIN_SAMPLES or not np.isfinite(signal).all():
        return signal
    segment = min(MAX_SEGMENT, len(signal) // 8)
    f, density = welch(signal, fs, nperseg=segment, detrend=False)
    # twice the noise is taken off: what is left of its scatter would be force
    noise_density = 2.0 * level**2 / fs
    gain = np.clip(1.0 - 2.0 * noise_density / np.maximum(density, 1e-300), 0.0, 1.0)

    lines = np.fft.rfftfreq(len(signal), 1 / fs)
    spectrum = np.fft.rfft(signal) * np.interp(lines, f, gain)
    return np.fft.irfft(spectrum, len(signal))


def levels_of(
    record: Record, motion: Mapping[str, float], rows: np.ndarray | None = None
) -> dict[str, float]:
    """Noise level of every channel of a record, SI rms.

    Parameters
    ----------
    record : Record
    motion : mapping of str to float
        Levels of the motion channels, as the fusion finds them: where the floors move
        with the base, those of accelerations include that of the base.
    rows : ndarray of bool, optional
        The samples from which those of forces and base are found.
    """
    channels = record.channels()
    levels = {str(name): float(level) for name, level in motion.items()}
    driving = [f"F{j}" for j in record.forced]
    driving += [name for name in BASES.values() if name in channels]
    for name in driving:
        levels[name] = quiet_level(np.asarray(channels[name]), record.fs, rows)

    base = levels.get("ag", 0.0)
    if record.coordinates == "relative" and base > 0:
        for name in motion:
            if name[0] == "a":
                own_power = max(levels[name] ** 2 - base**2, 0.0)
                levels[name] = float(np.sqrt(own_power))
    return levels


def quiet_drive(record: Record, levels: Mapping[str, float]) -> Record:
    """A record whose forces and base motion are freed of noise, for a free run."""
    changes = {}
    for key, name in BASES.items():
        line = getattr(record, key)
        if line is not None and name in levels:
            changes[key] = denoised(
                np.asarray(line, dtype=float), levels[name], record.fs
            )

    force = np.array(record.force, dtype=float)
    for j in record.forced:
        force[:, j - 1] = denoised(force[:, j - 1], levels.get(f"F{j}", 0.0), record.fs)
    return record.replace(force=force, **changes)


def noisy_channels(
    record: Record, levels: Mapping[str, float], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Measured motions and forces with fresh noise on them, by field of the record."""
    changes = {}
    for letter in "avxF":
        measured = getattr(record, OF_LETTER[letter])
        if measured is None:
            continue
        rms = [levels.get(f"{letter}{j}", 0.0) for j in range(1, record.n_dof + 1)]
        scatter = rng.standard_normal(np.shape(measured)) * rms
        changes[OF_LETTER[letter]] = np.asarray(measured, dtype=float) + scatter
    return changes


def noisy_base(
    record: Record, levels: Mapping[str, float], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Measured motion of the base with fresh noise on it, by field of the record."""
    out = {}
    for key, name in BASES.items():
        line = getattr(record, key)
        level = levels.get(name, 0.0)
        if line is not None and level > 0:
            values = np.asarray(line, dtype=float)
            out[key] = values + level * rng.standard_normal(len(values))
    return out
