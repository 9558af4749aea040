"""At which frequencies an unmeasured harmonic force may act.

A line near a resonance dominates the motion. Least squares then bends the coefficients until the line is gone from the
residual, at the price of everything else, so the residual alone does not show it. What shows it is how much better the
balance closes when a frequency is left out and the coefficients are found again.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from ..segments import Segment
from ..sites import Site
from .catalogue import Candidate
from .search import FREQUENCY
from .stage import Stage, Trial

# Share of a drive's power in one line that makes a test harmonic; bins of the record a line is wide.
_ONE_LINE = 0.6
_BINS = 4.0
# Lines tried of each kind; frequencies at which the columns are looked at for it, in halves of a bin of the record.
_MOST, _LOOKED_AT, _PADDED = 3, 2000, 2


def driving_frequency(drive: np.ndarray, dt: float) -> float:
    """Frequency of a test that is driven by one line, Hz; NaN if the drive is anything else.

    Parameters
    ----------
    drive : ndarray of shape (n_channels, n_samples)
        Measured forces, or the acceleration of the base.
    dt : float
        s.

    Returns
    -------
    float
    """
    drive = drive - drive.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(drive * np.hanning(drive.shape[1]))) ** 2).sum(axis=0)
    top = int(np.argmax(power))
    if not power[max(top - 3, 0) : top + 4].sum() > _ONE_LINE * power.sum():
        return float("nan")
    return top / (drive.shape[1] * dt)


def spectral_lines(residual: np.ndarray, dt: float, most: int = _MOST, driven: float = float("nan")) -> list[float]:
    """Frequencies at which a residual has its highest peaks, Hz, by the periodogram of a Hann window.

    Parameters
    ----------
    residual : ndarray of shape (n_samples,)
    dt : float
        s.
    most : int
    driven : float
        Frequency of a harmonic test, Hz: there, and at its multiples, any nonlinear law has lines.

    Returns
    -------
    list of float
    """
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
    """Frequencies without which a refitted balance closes best, Hz.

    Parameters
    ----------
    columns : ndarray of shape (n_columns, n_samples)
        With free coefficients.
    target : ndarray of shape (n_samples,)
    dt : float
        s.
    most : int
    driven : float
        As in :func:`spectral_lines`.

    Returns
    -------
    list of float

    Examples
    --------
    A force of 1 N at the resonance of 7 Hz is not in the record of a broad force; it fills the motion:

    >>> import numpy as np
    >>> from pysindy_nrf.discrepancy.spectral_lines import hidden_lines
    >>> t, rng = np.arange(0, 20, 0.01), np.random.default_rng(0)
    >>> x = rng.standard_normal(2000) + 30 * np.sin(2 * np.pi * 7 * t)
    >>> y = rng.standard_normal(2000) - 30 * np.sin(2 * np.pi * 7 * t)
    >>> force = x + y + np.cos(2 * np.pi * 7 * t)
    >>> found = hidden_lines(np.array([x + 0.1 * rng.standard_normal(2000), y]), force, 0.01, most=1)
    >>> np.round(found, 1).tolist()
    [7.0]
    """
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


def lines_of(trial: Trial) -> dict[Site, list[float]]:
    """Frequencies to try at each DOF, from what the search may see of the longest record.

    Parameters
    ----------
    trial : Trial

    Returns
    -------
    dict of Site to list of float
    """
    work = trial.work
    spans = {i: work.data.segments[i].valid for i in work.searched}
    longest = max(spans, key=lambda i: spans[i].stop - spans[i].start)
    seg = work.data.segments[longest]
    if seg.dt is None:
        return {}
    runs = work.runs(longest)
    # a line is as sharp as the record is long: what is held out is zero, not cut away
    inside = np.zeros(seg.valid.stop - seg.valid.start)
    for run in runs:
        inside[run] = 1.0
    whole = slice(runs[0].start, runs[-1].stop)
    rows = (trial.stage.rows(longest) * inside)[:, whole]
    driven = _driven(trial, seg, longest, max(runs, key=lambda r: r.stop - r.start))
    solution = trial.solve(range(len(work.search)))
    tail, n, out = trial.stage.tail, work.n_dof, {}
    for j in range(1, n + 1):
        group = trial.layout.group((j,))
        a, force = rows[tail + j - 1], rows[tail + n + j - 1]
        left = solution.masses[j] * a - force
        own: list[np.ndarray] = []
        others: list[np.ndarray] = []
        for site in group.sites:
            columns = rows[trial.layout.slices[site]]
            left = left + site.incidence(j) * (solution.coefficients[site] @ columns)
            (own if str(site) == f"storey {j}" else others).append(columns)
        scaled = j in work.forced or j in work.known_masses
        mass = [] if j in work.known_masses else [a[None]]
        # without a force or a mass something must give the scale: the storeys above
        free = [*own, *others, *mass] if scaled else own
        found = spectral_lines(left, seg.dt, _MOST, driven)
        if free:
            found += hidden_lines(np.vstack(free), left, seg.dt, _MOST, driven)
        out[Site(f"dof {j}")] = found
    return out


def lines_for(stage: Stage, candidate: Candidate) -> dict[Site, list[float]]:
    """The same for one candidate: nothing unless a frequency is among what it is to be found by.

    Parameters
    ----------
    stage : Stage
    candidate : Candidate

    Returns
    -------
    dict of Site to list of float
    """
    return lines_of(stage.trial()) if FREQUENCY in candidate.law.free_shape else {}


def _driven(trial: Trial, seg: Segment, number: int, widest: slice) -> float:
    """Frequency of a harmonic test; NaN for any other."""
    drive = np.nan_to_num(seg.F[seg.valid].T.astype(float))[:, widest]
    drive = drive[drive.any(axis=1)]
    if not len(drive) and seg.ag is not None:
        drive = seg.ag[seg.valid].astype(float)[None, widest]
    return driving_frequency(drive, seg.dt) if len(drive) and seg.dt else np.nan


def _away(f: np.ndarray, driven: float) -> np.ndarray:
    """Distance from the multiples of a frequency, Hz."""
    if not np.isfinite(driven):
        return np.full(len(f), np.inf)
    return np.abs(f / driven - np.round(f / driven)) * driven


__all__ = ["driving_frequency", "hidden_lines", "lines_of", "spectral_lines"]
