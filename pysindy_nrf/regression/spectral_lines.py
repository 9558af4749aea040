"""At which frequencies a harmonic force may act that was not measured: candidates for a frequency that is not known.

A line near a resonance dominates the motion. Least squares then bends the coefficients until the line is gone from the
residual, at the price of everything else, so the residual alone does not show it. What shows it is how much better the
balance closes when a frequency is left out and the coefficients are found again.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from .chain_solve import Solution
from .layout import Layout
from .segments import Segment

# Share of a drive's power in one line that makes a test harmonic; bins of the record a line is wide.
_ONE_LINE = 0.6
_BINS = 4.0
# Lines tried of each kind; frequencies at which the columns are looked at for it, in halves of a bin of the record.
_MOST, _LOOKED_AT, _PADDED = 3, 2000, 2


def driving_frequency(drive: np.ndarray, dt: float) -> float:
    """Frequency of a test that is driven by one line, Hz; NaN if the drive is anything else."""
    drive = drive - drive.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(drive * np.hanning(drive.shape[1]))) ** 2).sum(axis=0)
    top = int(np.argmax(power))
    if not power[max(top - 3, 0) : top + 4].sum() > _ONE_LINE * power.sum():
        return float("nan")
    return top / (drive.shape[1] * dt)


def spectral_lines(residual: np.ndarray, dt: float, most: int = _MOST, driven: float = float("nan")) -> list[float]:
    """Frequencies at which a residual has its highest peaks, Hz, by the periodogram of a Hann window."""
    n = len(residual)
    size = 4 * n
    power = np.abs(np.fft.rfft(residual * np.hanning(n), size)) ** 2
    peaks, _ = find_peaks(power, distance=8)
    peaks = peaks[_away(peaks / (size * dt), driven) * n * dt > _BINS]
    best = peaks[np.argsort(-power[peaks])][:most]
    return [float(k / (size * dt)) for k in best if k > 0]


def hidden_lines(
    columns: np.ndarray, target: np.ndarray, dt: float, most: int = _MOST, driven: float = float("nan")
) -> list[float]:
    """Frequencies without which a refitted balance closes best, Hz."""
    rows = np.vstack([columns, target])
    n = rows.shape[1]
    seen = int(np.count_nonzero(rows.any(axis=0)))
    size = np.sqrt(np.mean(rows**2, axis=1, keepdims=True))
    rows = rows / np.where(size > 0, size, 1.0)
    gram = rows @ rows.T
    lines = np.fft.rfft(rows, _PADDED * n, axis=1)
    values, vectors = np.linalg.eigh(gram)
    use = values > 1e-12 * values[-1]
    leverage = (np.abs((vectors[:, use] / np.sqrt(values[use])).T @ lines) ** 2).sum(axis=0)
    bins = np.arange(1, len(leverage))
    bins = bins[_away(bins / (_PADDED * n * dt), driven) * n * dt > _BINS]
    bins = bins[np.argsort(-leverage[bins])][:_LOOKED_AT]
    # a sine and a cosine of each frequency, taken out of all columns
    near = lines[:, bins].T
    left = gram - (2.0 / max(seen, 1)) * (near[:, :, None] * near[:, None].conj()).real
    x, xy = left[:, :-1, :-1], left[:, :-1, -1:]
    rest = left[:, -1, -1] - (xy * (np.linalg.pinv(x, rcond=1e-12, hermitian=True) @ xy)).sum(axis=(1, 2))
    found: list[int] = []
    for k in bins[np.argsort(rest)].tolist():
        if all(abs(k - other) > _PADDED for other in found):
            found.append(k)
            if len(found) == most:
                break
    return [k / (_PADDED * n * dt) for k in found]


def balance_lines(
    rows: np.ndarray,
    layout: Layout,
    solution: Solution,
    dof: int,
    dt: float,
    scaled: bool,
    weighed: bool,
    driven: float = float("nan"),
) -> list[float]:
    """Frequencies at which a force may be missing from one balance, Hz: lines of its residual, and hidden ones."""
    a, force = rows[layout.n_terms + dof - 1], rows[layout.n_terms + layout.n_dof + dof - 1]
    left = solution.masses[dof] * a - force
    own: list[np.ndarray] = []
    others: list[np.ndarray] = []
    for site in layout.group((dof,)).sites:
        columns = rows[layout.slices[site]]
        left = left + site.incidence(dof) * (solution.coefficients[site] @ columns)
        (own if str(site) == f"storey {dof}" else others).append(columns)
    free = [*own, *others, *([] if weighed else [a[None]])] if scaled else own
    found = spectral_lines(left, dt, _MOST, driven)
    return found + hidden_lines(np.vstack(free), left, dt, _MOST, driven) if free else found


def driven_at(segment: Segment, rows: slice = slice(None)) -> float:
    """Frequency of a harmonic test, Hz; NaN for any other."""
    drive = np.nan_to_num(segment.F[segment.valid].T.astype(float))[:, rows]
    drive = drive[drive.any(axis=1)]
    if not len(drive) and segment.ag is not None:
        drive = segment.ag[segment.valid].astype(float)[None, rows]
    return driving_frequency(drive, segment.dt) if len(drive) and segment.dt else np.nan


def _away(f: np.ndarray, driven: float) -> np.ndarray:
    """Distance from the multiples of a frequency, Hz."""
    if not 0.0 < driven < np.inf:
        return np.full(len(f), np.inf)
    return np.abs(f / driven - np.round(f / driven)) * driven
