"""Frequencies at which a harmonic force may be missing from an equation of motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import find_peaks

from ..chain.layout import Layout
from ..records.dataset import Segment
from .solution import Solution

# Share of the power in lines from which on a test is harmonic, and in the weakest of
# them. Of 400 records of noise 50 bins wide 1.5 % were taken for lines, of wider ones
# none.
HARMONIC_SHARE = 0.6
LEAST_SHARE_OF_A_LINE = 0.2
# Bins of the record on each side of a line that belong to it.
BINS_OF_A_LINE = 3
# Bins of the record from a multiple of a driving frequency within which no line is
# looked for.
BINS_AROUND_DRIVE = 4.0
# Lines of each kind that are tried.
MAX_LINES = 3
# Frequencies at which columns are refitted beside a line, and length of their
# transforms in lengths of the record.
MAX_FREQUENCIES_REFITTED = 2000
PADDING = 2
# Length of the transform of a residual in lengths of the record, and bins of it between
# two peaks.
RESIDUAL_PADDING = 4
BINS_BETWEEN_PEAKS = 8
# Share of the largest eigenvalue below which a combination of columns is round-off.
EIGENVALUE_CUT = 1e-12


def driving_lines(drive: np.ndarray, dt: float) -> tuple[float, ...]:
    """Frequencies of a test that is driven by lines, Hz; none for any other drive.

    ``drive`` is (n_channels, n_samples).
    """
    n_samples = drive.shape[1]
    centred = drive - drive.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centred * np.hanning(n_samples))
    power = (np.abs(spectrum) ** 2).sum(axis=0)
    total = power.sum()

    lines = []
    while True:
        top = int(np.argmax(power))
        bins = slice(max(top - BINS_OF_A_LINE, 0), top + BINS_OF_A_LINE + 1)
        if not power[bins].sum() > LEAST_SHARE_OF_A_LINE * total:
            break
        lines.append(top / (n_samples * dt))
        power[bins] = 0.0

    of_lines = total - power.sum()
    return tuple(lines) if of_lines > HARMONIC_SHARE * total else ()


def driven_at(segment: Segment) -> tuple[float, ...]:
    """Frequencies of a harmonic test, Hz; none for any other."""
    forces = segment.F[segment.valid].T.astype(float)
    drive = np.nan_to_num(forces)
    drive = drive[drive.any(axis=1)]
    if not len(drive) and segment.ag is not None:
        drive = segment.ag[segment.valid].astype(float)[None]
    if not len(drive) or not segment.dt:
        return ()
    return driving_lines(drive, segment.dt)


def spectral_lines(
    residual: np.ndarray,
    dt: float,
    max_lines: int = MAX_LINES,
    driven: Sequence[float] = (),
) -> list[float]:
    """Frequencies of the highest peaks of a residual, Hz, by a Hann periodogram."""
    n_samples = len(residual)
    size = RESIDUAL_PADDING * n_samples
    power = np.abs(np.fft.rfft(residual * np.hanning(n_samples), size)) ** 2
    peaks, _ = find_peaks(power, distance=BINS_BETWEEN_PEAKS)

    frequencies = peaks / (size * dt)
    bins_away = _away(frequencies, driven) * n_samples * dt
    peaks = peaks[bins_away > BINS_AROUND_DRIVE]
    highest = peaks[np.argsort(-power[peaks])][:max_lines]
    return (highest[highest > 0] / (size * dt)).tolist()


def hidden_lines(
    columns: Sequence[np.ndarray],
    target: np.ndarray,
    dt: float,
    driven: Sequence[float],
) -> list[float]:
    """Frequencies without which a refitted equation closes best, Hz.

    A line may hide in the coefficients that were fitted without it.
    """
    rows = np.vstack([*columns, target])
    n_samples = rows.shape[1]
    n_used = int(np.count_nonzero(rows.any(axis=0)))
    rms = np.sqrt(np.mean(rows**2, axis=1, keepdims=True))
    rows /= np.where(rms > 0, rms, 1.0)
    gram = rows @ rows.T
    lines = _transforms(rows)

    bins = np.arange(1, lines.shape[1])
    frequencies = bins / (PADDING * n_samples * dt)
    bins_away = _away(frequencies, driven) * n_samples * dt
    bins = bins[bins_away > BINS_AROUND_DRIVE]
    leverage = _leverage(gram, lines)
    bins = bins[np.argsort(-leverage[bins])][:MAX_FREQUENCIES_REFITTED]

    # a sine and a cosine of each frequency, taken out of all columns
    near = lines[:, bins].T.astype(complex)
    explained = (near[:, :, None] * near[:, None].conj()).real
    without_line = gram - (2.0 / max(n_used, 1)) * explained
    residual = _residual_squares(without_line)

    chosen: list[int] = []
    for k in bins[np.argsort(residual)].tolist():
        apart = [abs(k - other) > PADDING for other in chosen]
        if len(chosen) < MAX_LINES and all(apart):
            chosen.append(k)
    return [k / (PADDING * n_samples * dt) for k in chosen]


def _transforms(rows: np.ndarray) -> np.ndarray:
    """Padded transforms of rows, (n_rows, n_bins).

    One row at a time: those of long records are large.
    """
    size = PADDING * rows.shape[1]
    lines = np.empty((len(rows), size // 2 + 1), dtype=np.complex64)
    for k, row in enumerate(rows):
        lines[k] = np.fft.rfft(row, size)
    return lines


def _leverage(gram: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """How much of a line of each frequency the columns explain."""
    values, vectors = np.linalg.eigh(gram)
    clear = values > EIGENVALUE_CUT * values[-1]
    directions = (vectors[:, clear] / np.sqrt(values[clear])).T.astype(np.float32)
    leverage = np.zeros(lines.shape[1], dtype=np.float32)
    for direction in directions:
        leverage += np.abs(direction @ lines) ** 2
    return leverage


def _residual_squares(grams: np.ndarray) -> np.ndarray:
    """Squares that the columns leave of the last one, for each sum of products."""
    columns = grams[:, :-1, :-1]
    cross = grams[:, :-1, -1:]
    inverse = np.linalg.pinv(columns, rcond=EIGENVALUE_CUT, hermitian=True)
    return grams[:, -1, -1] - (cross * (inverse @ cross)).sum(axis=(1, 2))


def balance_lines(
    rows: np.ndarray,
    layout: Layout,
    solution: Solution,
    dof: int,
    dt: float,
    scaled: bool,
    weighed: bool,
    driven: Sequence[float] = (),
) -> list[float]:
    """Frequencies at which a force may be missing from an equation of motion, Hz.

    They are lines of its residual, and hidden ones. ``rows`` are
    ``[terms | a | F]``; ``scaled``, whether a measured force scales the equation;
    ``weighed``, whether the mass is known.
    """
    a = rows[layout.n_terms + dof - 1]
    force = rows[layout.n_terms + layout.n_dof + dof - 1]
    residual = solution.masses[dof] * a - force
    of_storey: list[np.ndarray] = []
    others: list[np.ndarray] = []
    for site in layout.group((dof,)).sites:
        columns = rows[layout.slices[site]]
        explained = solution.coefficients[site] @ columns
        residual = residual + site.incidence(dof) * explained
        group = of_storey if str(site) == f"storey {dof}" else others
        group.append(columns)

    free = list(of_storey)
    if scaled:
        free += others
        if not weighed:
            free.append(a[None])
    lines = spectral_lines(residual, dt, driven=driven)
    if free:
        lines += hidden_lines(free, residual, dt, driven)
    return lines


def _away(f: np.ndarray, driven: Sequence[float]) -> np.ndarray:
    """Distance from the multiples of the nearest of some frequencies, Hz."""
    away = np.full(len(f), np.inf)
    for frequency in driven:
        if frequency > 0.0:
            multiple = f / frequency
            distance = np.abs(multiple - np.round(multiple)) * frequency
            away = np.minimum(away, distance)
    return away
