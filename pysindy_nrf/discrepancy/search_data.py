"""The records of one search: what does not depend on the laws of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..chain.sites import Site
from ..diagnosis.evidence import DiagnosedData
from ..diagnosis.evidence.diagnosed_data import MotionColumns
from ..equations.chain_solve import clock_of
from ..laws.base import ForceLaw
from ..laws.shape import Motion, Scales
from ..records.dataset import BlockRows, Dataset, Segment, half_the_rate
from ..records.zero_phase_filter import ZeroPhaseFilter, filters_of
from .folds import Split

# Samples from which on motions are made anew, and spectra have single precision.
LONG_RECORD = 100_000

# A DOF, or a law at a site, and the samples of its rows after thinning.
ThinnedRows = tuple[int | tuple[Site, ForceLaw], int]


@dataclass(frozen=True, eq=False)
class KnownForces:
    """What is known of the forces of a search.

    Attributes
    ----------
    forced : tuple of int
        DOFs on which a force acts.
    unknown : tuple of int
        DOFs whose force is not known in any record.
    balances : ndarray of bool, shape (n_records, n_dof)
        Balances whose force is known.
    """

    forced: tuple[int, ...]
    unknown: tuple[int, ...]
    balances: np.ndarray

    @classmethod
    def of_records(cls, data: Dataset, searched: Sequence[int]) -> KnownForces:
        """The forces of all records, and those of the records that are searched."""
        records = Dataset([data.segments[i] for i in searched], data.n_samples)
        balances = [~np.isnan(s.F[s.valid.start]) for s in data.segments]
        return cls(records.forced, records.unknown, np.array(balances))


class SearchData:
    """Records of a search, its folds and its held-out pieces.

    Parameters
    ----------
    data : Dataset
        Fused records.
    folds : Split
        Counted from the first valid row of each record.
    known_masses : mapping of int to float
        kg.
    full : SearchData, optional
        All samples, where these are excerpts of long records.
    filters : sequence of ZeroPhaseFilter or None, optional
        Of each record, through which residuals are diagnosed; no decision reads them.
    forces : KnownForces, optional
        As the records show them if None.
    origin : SearchData, optional
        The records before their channels were corrected; these if None.

    Attributes
    ----------
    thinned : dict
        Rows in which spectral lines are looked for, made once for all models.
    """

    def __init__(
        self,
        data: Dataset,
        folds: Split,
        known_masses: Mapping[int, float],
        full: SearchData | None = None,
        filters: Sequence[ZeroPhaseFilter | None] | None = None,
        forces: KnownForces | None = None,
        origin: SearchData | None = None,
    ) -> None:
        self.data = data
        self.folds = folds
        self.known_masses = dict(known_masses)
        self.n_dof = data.n_dof
        self.searched = sorted({block.segment for block in folds.search})
        self.filters = filters_of(None, data) if filters is None else list(filters)
        self.thinned: dict[ThinnedRows, np.ndarray] = {}
        self.forces = forces or KnownForces.of_records(data, self.searched)
        self.origin = self if origin is None else origin
        self._full = full
        self._motions: dict[tuple[Site, tuple[int, ...]], Motion] = {}
        self._scales: dict[Site, Scales] = {}
        self._diagnosed_columns: MotionColumns = {}

    @property
    def search(self) -> list[BlockRows]:
        """Folds of the search."""
        return self.folds.search

    @property
    def heldout(self) -> list[BlockRows]:
        """Pieces that only the last line sees."""
        return self.folds.heldout

    @property
    def forced(self) -> tuple[int, ...]:
        """DOFs on which a force acts."""
        return self.forces.forced

    @property
    def full(self) -> SearchData:
        """All samples, of which these may be excerpts."""
        return self if self._full is None else self._full

    @property
    def fastest(self) -> float:
        """Half the lowest sampling rate of the search, Hz."""
        return half_the_rate(self.data.segments[i] for i in self.searched)

    # -- the same records in another way ---------------------------------------

    def diagnosed_in(self, band: tuple[float | None, float | None]) -> SearchData:
        """The same records, residuals diagnosed in one frequency band, Hz."""
        full = None if self._full is None else self._full.diagnosed_in(band)
        return SearchData(
            self.data,
            self.folds,
            self.known_masses,
            full,
            filters_of(band, self.data),
            self.forces,
        )

    def with_data(self, data: Dataset) -> SearchData:
        """The same rows of other motions (of corrected channels), where valid."""
        search = self.same_rows(self.search, data)
        heldout = self.same_rows(self.heldout, data)
        return SearchData(
            data,
            Split(search, heldout),
            self.known_masses,
            self._full,
            self.filters,
            forces=self.forces,
            origin=self.origin,
        )

    def same_rows(self, blocks: Sequence[BlockRows], data: Dataset) -> list[BlockRows]:
        """Blocks of rows counted from the first valid row of other records."""
        out = []
        for block in blocks:
            old = self.data.segments[block.segment].valid
            new = data.segments[block.segment].valid
            rows = _shifted(block.rows, old.start - new.start, new.stop - new.start)
            out.append(BlockRows(block.segment, rows))
        return out

    # -- motions and columns ---------------------------------------------------

    def motion(self, site: Site, *records: int) -> Motion:
        """Motion that a law at a site sees in some records, one after the other."""
        if (site, records) in self._motions:
            return self._motions[site, records]

        segments = [self.data.segments[i] for i in records]
        motion = Motion.joined([seg.motion(site, seg.valid) for seg in segments])
        # of longer records excerpts are searched, and all samples are seldom asked for
        if motion.n_samples < LONG_RECORD or len(records) > 1:
            self._motions[site, records] = motion
        return motion

    def scales(self, site: Site) -> Scales:
        """Sizes of the motion at a site, from which shape parameters are searched."""
        if self._full is not None:
            return self._full.scales(site)

        if site not in self._scales:
            drift, rate = self.drift_and_rate(site)
            clock = clock_of([self.motion(site, i) for i in self.searched])
            self._scales[site] = (_rms(drift), _rms(rate), *clock)
        return self._scales[site]

    def drift_and_rate(self, site: Site) -> tuple[np.ndarray, np.ndarray]:
        """Drift and rate of a site in all rows of the search."""
        motions = {i: self.motion(site, i) for i in self.searched}
        drift = [motions[b.segment].s[b.rows] for b in self.search]
        rate = [motions[b.segment].v[b.rows] for b in self.search]
        return np.concatenate(drift), np.concatenate(rate)

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], records: Sequence[int]
    ) -> np.ndarray:
        """Columns of laws along some records, from the raw motion, one a row."""
        motion = self.motion(site, *records)
        each = [law.features(motion).T for law in laws]
        return np.vstack(each) if len(each) > 1 else each[0]

    def fixed(self, records: Sequence[int]) -> list[np.ndarray]:
        """Accelerations of some records, then forces: 2 n_dof rows of (n_valid,).

        What is unknown of them is zero.
        """
        each = []
        for i in records:
            seg = self.data.segments[i]
            each.append([*seg.a[seg.valid].T, *seg.F[seg.valid].T])

        rows = []
        for parts in zip(*each):
            row = parts[0] if len(parts) == 1 else np.concatenate(parts)
            rows.append(row if np.isfinite(row).all() else np.nan_to_num(row))
        return rows

    # -- rows of the search ----------------------------------------------------

    def runs(self, record: int) -> list[slice]:
        """Runs of search rows of a record without a held-out piece in them.

        Counted from its first valid row.
        """
        runs: list[slice] = []
        for block in self.search:
            if block.segment != record:
                continue
            if runs and runs[-1].stop == block.rows.start:
                runs[-1] = slice(runs[-1].start, block.rows.stop)
            else:
                runs.append(block.rows)
        return runs

    def runs_in_record(self, record: int) -> list[slice]:
        """The same runs, counted from the first row of the record."""
        first = self.data.segments[record].valid.start
        return [slice(first + r.start, first + r.stop) for r in self.runs(record)]

    def pieces(self) -> list[tuple[int, Segment]]:
        """What the search may see: contiguous segments with their records' numbers."""
        out = []
        for i, segment in enumerate(self.data.segments):
            out += [(i, replace(segment, valid=r)) for r in self.runs_in_record(i)]
        return out

    def searched_rows(self, record: int) -> np.ndarray:
        """Mask of the samples of a record that the search may look at."""
        mask = np.zeros(self.data.segments[record].n_samples, dtype=bool)
        for run in self.runs_in_record(record):
            mask[run] = True
        return mask

    def diagnosed(self) -> DiagnosedData:
        """What a diagnosis of the residual may look at."""
        pieces = self.pieces()
        return DiagnosedData(
            self.data,
            [segment for _, segment in pieces],
            [i for i, _ in pieces],
            self.filters,
            self.known_masses,
            self._diagnosed_columns,
        )


def _shifted(rows: slice, shift: int, length: int) -> slice:
    """Rows moved by a number of samples, inside a record of some length."""
    start, stop = np.clip([rows.start + shift, rows.stop + shift], 0, length)
    return slice(int(start), int(stop))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
