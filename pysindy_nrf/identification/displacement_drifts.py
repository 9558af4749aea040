"""Displacement sensors that wander, below all frequencies at which something drives.

No acceleration witnesses a drift of a tenth of a millimetre: it is far below its noise.
The equations of motion do. Where neither a force nor an acceleration has power, a chain
stands still, and a displacement that moves leaves its stiffness times the drift.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from ..equations.errors import balance_errors
from ..exceptions import NRFError, NRFWarning
from ..records.checks.transfer_function import detrended, hann
from ..records.dataset import Dataset, Segment
from ..records.quality import QualityNote
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter
from .problem import Problem, least_squares

# Share of the power of an acceleration or a force below the frequency from which on
# something drives.
DRIVEN_FROM = 1e-3
# Edge of the filter over that frequency: it takes 0.4 % there, and next to nothing an
# octave above.
EDGE = 0.5
# Samples from which on neighbouring ones are averaged: a drift is slow.
MAX_SAMPLES = 16384
# Cycles of that frequency in a record, fewer of which say nothing.
MIN_CYCLES = 8
# Rms of the slow part of a displacement, as a share of the displacement, from which on
# it is looked at.
LEAST_SHARE = 3e-3
# Times the largest such share of a force or an acceleration, at least: half of the
# power of the slow part, or more, is then not driven.
ABOVE_DRIVEN = 2.0**0.5
# What the equations of motion leave without the drift, over what they leave with it.
# Permanent displacements of a storey that yields are no drift: they leave more.
LEFT_WITHOUT_DRIFT = 0.5


@dataclass(frozen=True)
class Drift:
    """Slow parts of the displacements of a record.

    Attributes
    ----------
    edge : float
        Frequency below which the displacements wander, Hz.
    sizes : dict of int to float
        Rms of the slow part by DOF, m, where it is clear.
    """

    edge: float
    sizes: dict[int, float]


def without_drifts(problem: Problem, data: Dataset) -> Dataset:
    """The data with displacements above the frequencies at which they wander.

    Notes on the drifts join the quality of the data.

    Parameters
    ----------
    problem : Problem
        Its laws; further ones make the question safer.
    data : Dataset
    """
    drifts = displacement_drifts(problem, data)
    return with_displacements_above(data, drifts) if drifts else data


def displacement_drifts(problem: Problem, data: Dataset) -> dict[int, Drift]:
    """Drifts by number of the record, with which the equations of motion close better.

    Parameters
    ----------
    problem : Problem
    data : Dataset
        Records whose displacements are measured.
    """
    drifts: dict[int, Drift] = {}
    filters = problem.filters(data)
    for number, (segment, record) in enumerate(zip(data.segments, data.records)):
        band_filter = filters[number]
        if band_filter is not None and band_filter.band[0]:
            continue
        drift = _slow_part(segment, record)
        if drift is not None:
            drifts[number] = drift
    if not drifts:
        return {}

    try:
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            before = _pooled_error(problem, data)
            after = _pooled_error(problem, _high_passed(data, drifts))
    except NRFError:
        # the slow part is all that scales the chain
        return {}
    return drifts if after < LEFT_WITHOUT_DRIFT * before else {}


def _pooled_error(problem: Problem, data: Dataset) -> float:
    """What the equations of motion leave beside unknown zeros, percent."""
    zeros = np.zeros(data.n_dof)
    segments = [replace(segment, offsets=zeros) for segment in data.segments]
    centred = replace(data, segments=tuple(segments), fuse_apart=None)
    estimate = least_squares(problem, centred)
    errors = balance_errors(estimate.model, estimate.grams)
    return float(errors.loc["pooled", "error"])


def _slow_part(segment: Segment, record: Record) -> Drift | None:
    """Displacements of a record below the frequencies that drive it, if they move."""
    if segment.dt is None or segment.n_valid < 2 or segment.band is not None:
        return None
    rows = segment.valid
    n_averaged = max(1, segment.n_valid // MAX_SAMPLES)
    dt = n_averaged * segment.dt
    forces = segment.F[rows][:, [j - 1 for j in segment.forced]]
    driven = _averaged(np.hstack([segment.a[rows], forces]), n_averaged)
    lowest = min(_driven_from(line, dt) for line in driven.T)
    if not lowest * segment.n_valid * segment.dt > MIN_CYCLES:
        return None

    edge = EDGE * lowest
    of_drivers = max(_share_below(line, edge, dt) for line in driven.T)
    least = max(LEAST_SHARE, ABOVE_DRIVEN * of_drivers)
    displacements = np.cumsum(_averaged(segment.s[rows], n_averaged), axis=1)
    sizes = {}
    for j, line in enumerate(displacements.T, 1):
        slow = _share_below(line, edge, dt)
        if f"x{j}" in record.measured and slow > least:
            sizes[j] = slow * float(line.std())
    return Drift(edge, sizes) if sizes else None


def _averaged(columns: np.ndarray, n_averaged: int) -> np.ndarray:
    """Means of so many neighbouring samples."""
    n_means = len(columns) // n_averaged
    rows = np.asarray(columns[: n_means * n_averaged], dtype=float)
    return rows.reshape(n_means, n_averaged, -1).mean(axis=1)


def _powers(line: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, Hz, and power of the lines of a signal under a Hann window."""
    centred = line.astype(float) - line.mean()
    lines = np.fft.rfft(hann(len(centred)) * centred)
    return np.fft.rfftfreq(len(centred), dt), np.abs(lines) ** 2


def _driven_from(line: np.ndarray, dt: float) -> float:
    """Frequency from which on a signal has power, Hz; infinite if it does not move."""
    f, power = _powers(detrended(line.astype(float)), dt)
    if not power.sum() > 0:
        return np.inf
    reached = np.cumsum(power) / power.sum()
    return float(f[np.searchsorted(reached, DRIVEN_FROM)])


def _share_below(line: np.ndarray, edge: float, dt: float) -> float:
    """Rms of the part of a signal below a frequency over its rms, its mean aside."""
    f, power = _powers(line, dt)
    share = power[f < edge].sum() / power.sum() if power.sum() > 0 else 0.0
    return float(np.sqrt(share))


# -- data without them ---------------------------------------------------------------


def _high_passed(data: Dataset, drifts: dict[int, Drift]) -> Dataset:
    segments = list(data.segments)
    for number, drift in drifts.items():
        segment = segments[number]
        high_pass = ZeroPhaseFilter((drift.edge, None), 1.0 / segment.step)
        drifts_of_storeys = np.array(segment.s, dtype=float)
        rows = segment.valid
        drifts_of_storeys[rows] = high_pass.apply(drifts_of_storeys[rows])
        segments[number] = replace(segment, s=drifts_of_storeys)
    return replace(data, segments=tuple(segments))


def with_displacements_above(data: Dataset, drifts: dict[int, Drift]) -> Dataset:
    """The data and their records with displacements above their drifts, and notes."""
    high_passed = _high_passed(data, drifts)
    segments, records = list(high_passed.segments), list(data.records)
    for number, drift in drifts.items():
        record = records[number]
        notes = tuple(_note(drift, j, record) for j in drift.sizes)
        segment = segments[number]
        segments[number] = replace(segment, quality=segment.quality + notes)
        records[number] = _record_above(record, drift)

    changed = replace(data, segments=tuple(segments), records=tuple(records))
    again = data.fuse_apart
    if again is None:
        return changed
    return replace(changed, fuse_apart=lambda: _high_passed(again(), drifts))


def _note(drift: Drift, dof: int, record: Record) -> QualityNote:
    size = drift.sizes[dof]
    message = (
        f"x{dof} wanders by {size:.2g} {record.units.length} below {drift.edge:.2g} Hz,"
        " where no force and no acceleration moves it. The displacement above is used"
    )
    witness = "equations of motion"
    return QualityNote("drift", message, f"x{dof}", record.name, size, witness)


def _record_above(record: Record, drift: Drift) -> Record:
    """A record with its displacements above a drift."""
    high_pass = ZeroPhaseFilter((drift.edge, None), record.fs)
    displacement = np.array(record.displacement, dtype=float)
    rows = np.flatnonzero(np.isfinite(displacement).any(axis=1))
    inside = slice(int(rows[0]), int(rows[-1]) + 1)
    displacement[inside] = high_pass.apply(displacement[inside])
    return record.replace(displacement=displacement)
