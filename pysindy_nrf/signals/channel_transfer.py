r"""The transfer between two channels of one DOF, and what it says: delay, gain, sign, or another frame.

Accelerations, velocities and displacements are derived into each other line by line, so neighbouring lines of one
motion differ by gain, sign and delay alone; see :mod:`pysindy_nrf.signals.alignment`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..data.record import Record

ORDER = {"x": 0, "v": 1, "a": 2}
NAMES = {"a": "acceleration", "v": "velocity", "x": "displacement"}
STRONG = 1e-3  # share of a spectrum's peak
LONGEST = 65536  # samples of a channel that are looked at
FINE, MOST = 4, 20  # steps of a sample in which a delay is searched, and samples up to which
CYCLES = 8  # of a line, at least, within the lasting part of a record
CYCLES_OF_A_RUN, DENSE = 3, 4  # the same for runs that are differentiated first; lines of a run for each of its own
NEIGHBOURS = 9  # lines that are averaged
MISFIT = 0.5  # share of a channel that gain, sign and delay leave, from which on it is of another place
BLOCKS = 8  # of lines, over which the scatter of the gain is taken
DELAY, GAIN = 0.05, 0.02  # samples, and share of one, from which on a channel is called misaligned


def against(
    record: Record,
    base: np.ndarray | None,
    one: tuple[str, np.ndarray],
    other: tuple[str, np.ndarray],
    j: int,
    band: Any,
    runs: Sequence[slice] | None,
) -> list[Any]:
    """One row of the table: the second channel against the first, in the frame of reference the record claims."""
    order = ORDER[other[0]] - ORDER[one[0]]
    names = f"{one[0]}{j}", f"{other[0]}{j}"
    if said := _wrong_frame(record, one, other, names):
        return [names[0], *[np.nan] * 6, False, said]
    first, second = (y - base if k == "a" and base is not None else y for k, y in (one, other))
    return _compare(first, second, order, record.fs, band, *names, runs)


def _wrong_frame(
    record: Record, one: tuple[str, np.ndarray], other: tuple[str, np.ndarray], names: tuple[str, str]
) -> str:
    """Whether displacement or velocity is of another frame than the record says."""
    ag = record.base_acceleration
    pair = {k: y for k, y in (one, other)}
    if ag is None or "a" not in pair or len(pair) < 2:
        return ""
    kind = next(k for k in pair if k != "a")
    good = np.isfinite(pair["a"]) & np.isfinite(pair[kind]) & np.isfinite(ag)
    n = min(int(good.sum()), LONGEST)
    if n < 64 or not np.any(ag[good]):
        return ""
    bell = 1 - np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)
    y, a, g = (np.fft.rfft(bell * (line[good][:n] - line[good][:n].mean())) for line in (pair[kind], pair["a"], ag))
    y = y * (2j * np.pi * np.fft.rfftfreq(n, 1 / record.fs)) ** (ORDER["a"] - ORDER[kind])
    use = np.arange(len(y)) > 4
    use &= (np.abs(a) ** 2 > STRONG * (np.abs(a[use]) ** 2).max()) & (np.arange(len(y)) < 0.8 * len(y))
    if use.sum() < 8:
        return ""
    columns = np.column_stack([a[use], g[use]]) / np.abs(y[use])[:, None]
    alpha, beta = np.linalg.lstsq(columns, y[use] / np.abs(y[use]), rcond=None)[0].real
    wanted, turned = (-1.0, 0.0) if record.coordinates == "relative" else (0.0, -1.0)
    if abs(alpha - 1) > 0.3 or abs(beta - turned) > 0.3:
        return ""
    x = names[0] if names[0][0] == kind else names[1]
    if wanted == -1.0:
        return (
            f"{x} moves as a{x[1:]} itself says, not as a{x[1:]} less the base acceleration: {x} is absolute "
            f"(coordinates='absolute'), or a{x[1:]} is relative to the base (add ag to it)"
        )
    return f"{x} moves as a{x[1:]} less the base acceleration says: it is relative to the base (coordinates='relative')"


def _duration(line: np.ndarray) -> float:
    """Samples over which the power of a signal is spread: its square sum squared over the sum of its fourth powers."""
    power = line**2
    return float(power.sum() ** 2 / max((power**2).sum(), np.finfo(float).tiny))


class _Lines(NamedTuple):
    """Spectra of two channels brought to one kind, averaged over neighbouring lines."""

    f: np.ndarray
    cross: np.ndarray
    own: np.ndarray
    theirs: np.ndarray
    size: np.ndarray
    slowest: float
    length: int


def _whole(first: np.ndarray, second: np.ndarray, order: int, fs: float) -> _Lines:
    """Lines of the whole record."""
    from scipy.signal import detrend

    good = np.isfinite(first) & np.isfinite(second)
    y, z = (detrend(line[good][:LONGEST]) for line in (first, second))
    length = len(y)
    bell = _bell(length)
    f = np.fft.rfftfreq(length, 1 / fs)
    Y, Z = np.fft.rfft(bell * y), np.fft.rfft(bell * z)
    # derived line by line before lines are averaged: however steep the spectra, nothing leaks then
    U = Y * np.where(f > 0, 2j * np.pi * f, 1.0) ** order
    # the bell is differentiated too: lines with few cycles under it and under the motion's own decay tell nothing
    lasting = min(_duration(bell * y), _duration(bell * z)) / fs
    sums = _mean(np.conj(U) * Z), _mean(np.abs(U) ** 2), _mean(np.abs(Z) ** 2), _mean(np.abs(Y) ** 2)
    return _Lines(f, *sums, CYCLES / lasting if lasting else np.inf, length)


def _in_runs(first: np.ndarray, second: np.ndarray, order: int, fs: float, runs: Sequence[slice]) -> _Lines:
    """Lines of several runs together."""
    from scipy.signal import detrend

    longest = min(max(run.stop - run.start for run in runs), LONGEST)
    dense = DENSE * longest
    f = np.fft.rfftfreq(dense, 1 / fs)
    turn = np.minimum(2 * np.pi * f / fs, 0.9 * np.pi)
    true = {1: np.where(f > 0, np.sin(turn) / np.where(f > 0, turn, 1.0), 1.0)}
    true[2] = np.where(f > 0, 2 * (1 - np.cos(turn)) / np.where(f > 0, turn, 1.0) ** 2, 1.0)
    total = [np.zeros(len(f), dtype=complex), np.zeros(len(f)), np.zeros(len(f))]
    for run in runs:
        pair = first[run][:longest], second[run][:longest]
        good = np.isfinite(pair[0]) & np.isfinite(pair[1])
        y, z = (_derived(line[good], max(k, 0), fs) for line, k in zip(pair, (order, -order)))
        if len(y) < 2 * NEIGHBOURS:
            continue
        U, Z = (np.fft.rfft(_bell(len(line)) * detrend(line), dense) for line in (y, z))
        if order:
            U, Z = (U / true[order], Z) if order > 0 else (U, Z / true[-order])
        for part, more in zip(total, (np.conj(U) * Z, np.abs(U) ** 2, np.abs(Z) ** 2)):
            part += np.where(f < 0.45 * fs, more, 0.0)  # beyond, a difference tells nothing
    cross, own, theirs = (_mean(part) for part in total)
    return _Lines(f, cross, own, theirs, own, CYCLES_OF_A_RUN * fs / longest, dense)


def _derived(y: np.ndarray, order: int, fs: float) -> np.ndarray:
    """Central differences of first or second order, a sample shorter at either end."""
    if order == 0:
        return y[1:-1]
    if order == 1:
        return (y[2:] - y[:-2]) * (0.5 * fs)
    return (y[2:] - 2 * y[1:-1] + y[:-2]) * fs**2


def _bell(length: int) -> np.ndarray:
    return np.asarray(1 - np.cos(2 * np.pi * (np.arange(length) + 0.5) / length))


def _mean(product: np.ndarray) -> np.ndarray:
    """Mean over neighbouring lines."""
    from scipy.ndimage import uniform_filter1d

    if np.iscomplexobj(product):
        return np.asarray(uniform_filter1d(product.real, NEIGHBOURS) + 1j * uniform_filter1d(product.imag, NEIGHBOURS))
    return np.asarray(uniform_filter1d(product, NEIGHBOURS))


def _compare(
    first: np.ndarray,
    second: np.ndarray,
    order: int,
    fs: float,
    band: Any,
    one: str,
    other: str,
    runs: Sequence[slice] | None,
) -> list[Any]:
    """Fit gain, sign and delay of the second channel against derivatives of the first."""
    lines = _whole(first, second, order, fs) if runs is None else _in_runs(first, second, order, fs, runs)
    f, cross, own, theirs, size, slowest, length = lines
    use = (np.arange(len(f)) > NEIGHBOURS) & (f > slowest) & (f < 0.4 * fs)
    use &= (size > STRONG * size.max()) & (theirs > STRONG * theirs.max())
    if band is not None:
        use &= (f >= band[0]) & (f <= band[1])
    if use.sum() < NEIGHBOURS:  # all that moves is slower than the record can tell
        return [one, *[np.nan] * 6, True, ""]
    coherence = np.zeros(len(f))
    coherence[use] = np.abs(cross[use]) ** 2 / own[use] / theirs[use]
    if (coherence[use] > 0.5).sum() <= 0.2 * use.sum():
        lost = [np.nan] * 5
        said = f"{other} and {one} are not coherent: columns swapped, another floor, or dead?"
        return [one, *lost, float(coherence.max()), False, said]
    use &= coherence > min(0.9, 0.9 * coherence.max())
    if use.sum() < NEIGHBOURS // 2:  # a line or two of noise that happen to look alike
        return [one, *[np.nan] * 5, float(coherence.max()), True, ""]
    w = 2 * np.pi * f[use]
    # between the gains that noise in the one and in the other channel makes too small and too large
    H = cross[use] / np.abs(cross[use]) * np.sqrt(theirs[use] / own[use])
    weight = coherence[use] / np.maximum(1 - coherence[use], 1e-6)
    weight = np.minimum(weight, 1e3)
    # delay: the one that lines all phases up, searched on a grid (a padded transform) and refined
    lined = np.zeros(length // 2 + 1, dtype=complex)
    lined[use] = H / np.abs(H) * weight
    fine = max(FINE, -(-FINE * 256 // length))
    total = np.fft.irfft(lined, fine * length)
    near = np.r_[0 : MOST * fine + 1, len(total) - MOST * fine : len(total)]
    best = int(near[np.argmax(np.abs(total[near]))])
    sign = 1.0 if total[best] > 0 else -1.0
    delay = (best if best <= len(total) // 2 else best - len(total)) / fine / fs
    for _ in range(3):
        phase = np.angle(sign * H * np.exp(1j * w * delay))
        delay -= float((weight * w * phase).sum() / (weight * w**2).sum())
    gain = float(np.exp(np.average(np.log(np.abs(H)), weights=weight)))
    scatter = _scatter(np.log(np.abs(H)), w, weight, coherence[use])
    fitted = sign * gain * np.exp(-1j * w * delay)
    power = theirs[use] * coherence[use]
    misfit = float(np.sqrt((np.abs(H / fitted - 1) ** 2 * power).sum() / power.sum()))
    faults = []
    if sign < 0:
        faults.append("has the opposite sign")
    if abs(delay * fs) > DELAY:
        side = "late" if delay > 0 else "early"
        faults.append(f"is {abs(delay) * 1e3:.3g} ms ({abs(delay * fs):.2f} samples) {side}")
    if abs(gain - 1) > GAIN:
        faults.append(f"is {gain:.3g} times as large")
    message = f"{other} {', '.join(faults)} against {one}" if faults else ""
    if misfit > MISFIT:
        message = (
            f"{other} does not follow {one} as {NAMES[other[0]]} follows {NAMES[one[0]]}: columns swapped, or a "
            "channel of another floor?"
        )
    return [one, delay, delay * fs, gain, scatter, sign, float(np.average(coherence[use])), not message, message]


def _scatter(logs: np.ndarray, w: np.ndarray, weight: np.ndarray, coherence: np.ndarray) -> float:
    """How far from that of all lines the gain is on a part of them, on slow ones, and what noise may have added."""
    count = min(BLOCKS, len(logs) // NEIGHBOURS)
    if count < 3:
        return float("inf")
    parts = np.array_split(np.arange(len(logs)), count)
    means = np.array([np.average(logs[p], weights=weight[p]) for p in parts])
    shares = np.array([weight[p].sum() for p in parts])
    mean = float(np.average(means, weights=shares))
    apart = np.sqrt(np.average((means - mean) ** 2, weights=shares))
    columns = np.column_stack([np.ones(len(w)), (w / w.max()) ** 2]) * np.sqrt(weight)[:, None]
    line = np.linalg.lstsq(columns, logs * np.sqrt(weight), rcond=None)[0]
    left = columns @ line - logs * np.sqrt(weight)
    error = np.sqrt(NEIGHBOURS * np.linalg.pinv(columns.T @ columns)[0, 0] * (left @ left) / len(left))
    bent = max(abs(line[0] - mean) - 2 * error, 0.0)
    noise = np.average(-0.5 * np.log(np.minimum(coherence, 1.0)), weights=weight)
    return float(apart + bent + noise)
