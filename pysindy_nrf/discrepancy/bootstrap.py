"""Parametric bootstrap: records as a model would have produced them, with the noise of the measured channels."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..data.record import Record
from ..exceptions import NRFError
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.segments import BlockRows, Segment
from ..signals.kinematics import base_acceleration_if_any
from .prepare import Prepared, Workspace, prepare
from .residual import LOUDEST, RARE
from .ruler import Ruler, Trial
from .windows import Windows

_MOTIONS = ("acceleration", "velocity", "displacement")


def simulated(ready: Prepared, trial: Trial, rng: np.random.Generator) -> Ruler | None:
    """The ruler on records that the model of a trial, freed of the bias of noise, would have produced.

    The bias is found by the bootstrap itself (Efron and Tibshirani 1993, chapter 10): what the fit makes of records
    that the model produced, less the model. None where the model has no free run.
    """
    first = _produced(ready, trial, trial.model(), rng)
    if first is None:
        return None
    try:
        again = Trial(first, trial.base, trial.laws)
    except NRFError:
        return first
    unbiased = trial.model_at(2 * trial.masses[0] - again.masses[0], 2 * trial.theta[0] - again.theta[0])
    return _produced(ready, trial, unbiased, rng) or first


def _produced(ready: Prepared, trial: Trial, model: ChainModel, rng: np.random.Generator) -> Ruler | None:
    """The ruler on a free run of a model with the noise of the channels; None where there is none."""
    work = trial.ruler.work
    if (model.masses <= 0).any():
        return None
    fakes = []
    try:
        for i in work.searched:
            levels = levels_of(ready.records[i], ready.noise[i], work.seen_rows(i))
            fakes.append(_record(ready.records[i], work.data.segments[i], model, levels, rng))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is to be said of the channels was said of the measured ones
            known, bands = ([one[i] for i in work.searched] for one in (ready.noise, ready.bands))
            data = prepare(fakes, noise=known, bands=bands).data
    except NRFError:
        return None
    blocks = []
    for number, i in enumerate(work.searched):
        valid = data.segments[number].valid
        later = work.data.segments[i].valid.start - valid.start  # blocks count from the first valid row
        for b in (b for b in work.search if b.segment == i):
            ends = (min(max(row + later, 0), valid.stop - valid.start) for row in (b.rows.start, b.rows.stop))
            blocks.append(BlockRows(number, slice(*ends)))
    fake = Workspace(data, blocks, [], work.known_masses, work.strategy)
    windows = trial.ruler.windows
    other = Windows(data, blocks, windows.length, windows.edges, windows.centred)
    return Ruler(fake, other, trial.ruler.informative, trial.ruler.clear)


def _record(
    record: Record, segment: Segment, model: ChainModel, noise: dict[str, float], rng: np.random.Generator
) -> Record:
    """The record the model would have produced, with fresh noise on the channels that were measured."""
    rows = _measured_rows(record)
    rest = np.zeros(record.n_dof)
    start = None if rows == segment.valid else (rest, rest)  # fusion left out the ends
    quiet = quiet_drive(record, noise)
    driven = replace(segment, F=np.nan_to_num(quiet.force), ag=base_acceleration_if_any(quiet))
    run = free_run_of(model, driven, rows, record.dt, start)
    changes: dict[str, Any] = {}
    for key, prefix in zip(_MOTIONS, "avx"):
        measured = getattr(record, key)
        if measured is None:
            continue
        own = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            own[:, j] += noise.get(f"{prefix}{j + 1}", 0.0) * rng.standard_normal(len(own))
            if np.isnan(measured[:, j]).all():
                own[:, j] = np.nan
        changes[key] = np.full(measured.shape, np.nan)
        changes[key][rows] = own
    changes |= noisy_base(quiet, noise, rng)
    changes["force"] = quiet.force + rng.standard_normal(record.force.shape) * [
        noise.get(f"F{j + 1}", 0.0) for j in range(record.n_dof)
    ]
    return quiet.replace(coordinates="relative", **changes)


def _measured_rows(record: Record) -> slice:
    """From the first to the last row in which all channels of the motion have a value."""
    known = np.ones(record.n_samples, dtype=bool)
    for key in _MOTIONS:
        measured = getattr(record, key)
        if measured is not None:
            used = ~np.isnan(measured).all(axis=0)
            known &= np.isfinite(measured[:, used]).all(axis=1)
    inside = np.flatnonzero(known)
    return slice(int(inside[0]), int(inside[-1]) + 1)


BASE = {"ag": "base_acceleration", "vg": "base_velocity", "xg": "base_displacement"}
_FEWEST = 256
_WINDOW = 64


def quiet_level(signal: np.ndarray, fs: float) -> float:
    """Rms of the white noise under a signal, from its quiet frequencies or its quiet times."""
    from scipy.signal import welch

    signal = signal[np.isfinite(signal)]
    if len(signal) < _FEWEST:
        return 0.0
    size = min(1024, len(signal) // 8)
    _, density = welch(signal, fs, nperseg=size, detrend="constant")
    by_frequency = flat_level(density[1:-1], _dof(2 * len(signal) // size - 1)) * fs / 2
    windows = signal[: len(signal) // _WINDOW * _WINDOW].reshape(-1, _WINDOW)
    by_time = flat_level((windows**2).mean(axis=1), _WINDOW)
    level = float(np.sqrt(min(by_frequency, by_time)))
    return level if level < LOUDEST * float(np.sqrt(np.mean(signal**2))) else 0.0


def denoised(signal: np.ndarray, level: float, fs: float) -> np.ndarray:
    """A signal without the white noise beneath it (Wiener's filter), as far as frequencies tell them apart."""
    from scipy.signal import welch

    if level <= 0 or len(signal) < _FEWEST or not np.isfinite(signal).all():
        return signal
    f, density = welch(signal, fs, nperseg=min(1024, len(signal) // 8), detrend=False)
    # twice the noise taken off: what is left of its scatter would be force
    gain = np.clip(1.0 - 2.0 * level**2 * 2.0 / fs / np.maximum(density, 1e-300), 0.0, 1.0)
    spectrum = np.fft.rfft(signal)
    return np.fft.irfft(spectrum * np.interp(np.fft.rfftfreq(len(signal), 1 / fs), f, gain), len(signal))


def levels_of(record: Record, motion: Mapping[str, float], rows: np.ndarray | None = None) -> dict[str, float]:
    """Noise of every channel of a record."""
    channels, fs = record.channels(), record.fs
    rows = np.ones(record.n_samples, dtype=bool) if rows is None else rows
    levels = {str(k): float(v) for k, v in motion.items()}
    levels |= {f"F{j}": quiet_level(record.force[rows, j - 1], fs) for j in record.forced}
    levels |= {name: quiet_level(np.asarray(channels[name])[rows], fs) for name in BASE if name in channels}
    if record.coordinates == "relative" and (base := levels.get("ag", 0.0)) > 0:
        for name in (k for k in levels if k[0] == "a" and k in motion):
            levels[name] = float(np.sqrt(max(levels[name] ** 2 - base**2, 0.0)))
    return levels


def quiet_drive(record: Record, levels: Mapping[str, float]) -> Record:
    """A record whose forces and base motion are freed of noise, for a free run."""
    changes = {
        key: denoised(np.asarray(getattr(record, key), dtype=float), levels[name], record.fs)
        for name, key in BASE.items()
        if name in levels and getattr(record, key) is not None
    }
    force = np.array(record.force, dtype=float)
    for j in record.forced:
        force[:, j - 1] = denoised(force[:, j - 1], levels.get(f"F{j}", 0.0), record.fs)
    return record.replace(force=force, **changes)


def noisy_base(record: Record, levels: Mapping[str, float], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Fresh noise on the measured motion of the base; fields of the record by name."""
    out = {}
    for name, key in BASE.items():
        if levels.get(name, 0.0) > 0 and getattr(record, key) is not None:
            line = np.asarray(getattr(record, key), dtype=float)
            out[key] = line + levels[name] * rng.standard_normal(len(line))
    return out


def _dof(pieces: int) -> float:
    return 2 * pieces / (1 + 1 / 18)  # Hann windows that overlap by half


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
