"""Frequencies that a harmonic force at a DOF may have: lines of what a model leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import resample

from ..chain.sites import Site
from ..equations.shape_search import balance_lines, driven_at
from ..laws.base import ForceLaw
from ..records.dataset import Segment
from .excerpts import EXCERPTS
from .fitted_model import FittedModel
from .search_data import LONG_RECORD, SearchData

# Samples to a period of the highest frequency of the search, after thinning.
SAMPLES_PER_PERIOD = 2.2
# Multiple of the samples of a search from which on rows are thinned.
THINNED_FROM = 3


def missing_lines(model: FittedModel, dof: int) -> list[float]:
    """Frequencies at which a force may be missing from the balance of a DOF, Hz.

    From what the search may see of the longest record, all samples of it. None above
    the band of the search, where no equation of motion is read.
    """
    data = model.spectra.data.full
    highest = float(model.spectra.windows.edges[-1])
    stretch = _longest_stretch(data, highest)
    rows = np.zeros((model.first_fixed + 2 * data.n_dof, stretch.n_points))

    balance = slice(model.first_fixed + dof - 1, None, data.n_dof)
    rows[balance] = _thinned_once(data, dof, stretch, partial(_fixed, stretch, dof))

    for site in model.layout.group((dof,)).sites:
        columns = []
        for law in model.laws[site]:
            features = partial(_features, stretch, site, law)
            columns.append(_thinned_once(data, (site, law), stretch, features))
        rows[model.layout.slices[site]] = np.vstack(columns)

    known = dof in data.known_masses
    lines = balance_lines(
        rows,
        model.layout,
        model.solution(),
        dof,
        stretch.segment.step * stretch.size / stretch.n_points,
        known or dof in data.forced,
        known,
        driven_at(stretch.segment),
    )
    return [line for line in lines if line <= highest]


@dataclass(frozen=True)
class _Stretch:
    """The part of a record in which lines are looked for."""

    segment: Segment
    # From the first valid row of the record.
    rows: slice
    # 1 in rows of the search, 0 elsewhere: a line is as sharp as the record is long, so
    # what is held out is set to zero rather than cut away.
    searched: np.ndarray
    # Samples after thinning.
    n_points: int

    @property
    def size(self) -> int:
        """Samples of the stretch."""
        return self.rows.stop - self.rows.start

    @property
    def from_start(self) -> slice:
        """Rows of the record from its first valid one to the end of the stretch.

        Laws with a memory follow their path from there.
        """
        first = self.segment.valid.start
        return slice(first, first + self.rows.stop)

    def thinned(self, columns: np.ndarray) -> np.ndarray:
        """Columns from the first valid row, as rows of ``n_points`` samples."""
        rows = columns[self.rows].T * self.searched
        if self.n_points == self.size:
            return rows
        places = np.arange(self.n_points) * self.size // self.n_points
        return resample(rows, self.n_points, axis=1) * self.searched[places]


def _longest_stretch(data: SearchData, highest: float) -> _Stretch:
    """The searched part of the record that has the longest run of search rows."""
    longest = {}
    for record in data.searched:
        longest[record] = max(run.stop - run.start for run in data.runs(record))
    record = max(longest, key=longest.__getitem__)

    runs, segment = data.runs(record), data.data.segments[record]
    start = runs[0].start
    # ten times as sharp as what the search can distinguish
    stop = min(runs[-1].stop, start + LONG_RECORD)
    searched = np.zeros(stop)
    for run in runs:
        searched[run] = 1.0

    size = stop - start
    enough = SAMPLES_PER_PERIOD * size * segment.step * highest
    n_points = next_fast_len(int(enough))
    if size <= n_points or size <= THINNED_FROM * EXCERPTS.n_samples:
        n_points = size
    return _Stretch(segment, slice(start, stop), searched[start:], n_points)


def _thinned_once(
    data: SearchData,
    name: int | tuple[Site, ForceLaw],
    stretch: _Stretch,
    columns: Callable[[], np.ndarray],
) -> np.ndarray:
    """Thinned rows of a DOF or of a law at a site, made once for all models."""
    thinned, key = data.thinned, (name, stretch.n_points)
    if key not in thinned:
        thinned[key] = stretch.thinned(columns())
    return thinned[key]


def _fixed(stretch: _Stretch, dof: int) -> np.ndarray:
    """Acceleration and force of a DOF."""
    segment, rows = stretch.segment, stretch.from_start
    both = [segment.a[rows, dof - 1], segment.F[rows, dof - 1]]
    return np.nan_to_num(np.column_stack(both))


def _features(stretch: _Stretch, site: Site, law: ForceLaw) -> np.ndarray:
    """Columns of a law at a site."""
    return law.features(stretch.segment.motion(site, stretch.from_start))
