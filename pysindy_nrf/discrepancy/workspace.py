"""The records of one search: motions, columns and blocks, with everything that does not depend on the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..laws.base import ForceLaw
from ..laws.shape import Motion, Scales
from ..mechanics.sites import Site
from ..regression.chain_solve import clock_of
from ..regression.segments import BlockRows, Segment, SegmentSet, half_the_rate


class Workspace:
    """The records of one search, with everything that does not depend on the laws.

    Parameters
    ----------
    data : SegmentSet
    search, held : sequence of BlockRows
        Folds of the search, and what is held out; rows count from the first valid row of a record.
    known_masses : mapping of int to float
    strategy : str

    Attributes
    ----------
    filters : list of FairFilter or None
        One for each record: the band in which residuals are looked at; decisions do not read it.
    """

    def __init__(
        self,
        data: SegmentSet,
        search: Sequence[BlockRows],
        held: Sequence[BlockRows],
        known_masses: Mapping[int, float],
        strategy: str,
    ) -> None:
        self.data = data
        self.filters: list[Any] = [None] * len(data.segments)
        self.search, self.held = list(search), list(held)
        self.known_masses, self.strategy = dict(known_masses), strategy
        self.n_dof = data.n_dof
        self.searched = sorted({b.segment for b in search})
        seen = SegmentSet([data.segments[i] for i in self.searched], data.n_samples)
        self.forced, self.unknown = seen.forced, seen.unknown
        self._motions: dict[tuple[Site, int], Motion] = {}
        self._scales: dict[Site, Scales] = {}
        self.known = np.array([~np.isnan(seg.F[seg.valid.start]) for seg in data.segments])

    def with_data(self, data: SegmentSet) -> Workspace:
        """The same rows of other motions (of corrected channels), as far as they are valid."""

        def same(blocks: Sequence[BlockRows]) -> list[BlockRows]:
            out = []
            for b in blocks:
                old, new = self.data.segments[b.segment].valid, data.segments[b.segment].valid
                length = new.stop - new.start
                ends = (int(np.clip(r + old.start - new.start, 0, length)) for r in (b.rows.start, b.rows.stop))
                out.append(BlockRows(b.segment, slice(*ends)))
            return out

        out = Workspace(data, same(self.search), same(self.held), self.known_masses, self.strategy)
        out.filters = self.filters
        return out

    def motion(self, site: Site, segment: int) -> Motion:
        """Motion that a law at a site sees in one record."""
        if (site, segment) not in self._motions:
            seg = self.data.segments[segment]
            self._motions[site, segment] = seg.motion(site, seg.valid)
        return self._motions[site, segment]

    def scales(self, site: Site) -> Scales:
        """Sizes of the motion at a site, from which shape parameters are searched; of the search rows and records."""
        if site not in self._scales:
            parts = [(self.motion(site, b.segment), b.rows) for b in self.search]
            s = np.sqrt(np.mean(np.concatenate([m.s[rows] for m, rows in parts]) ** 2))
            v = np.sqrt(np.mean(np.concatenate([m.v[rows] for m, rows in parts]) ** 2))
            self._scales[site] = float(s), float(v), *clock_of([self.motion(site, i) for i in self.searched])
        return self._scales[site]

    @property
    def fastest(self) -> float:
        """Half the lowest sampling rate of the search, Hz."""
        return half_the_rate(self.data.segments[i] for i in self.searched)

    def columns(self, site: Site, laws: Sequence[ForceLaw], segment: int) -> np.ndarray:
        """Columns of laws along one record, from the raw motion."""
        motion = self.motion(site, segment)
        return np.vstack([law.features(motion).T for law in laws])

    def fixed(self, segment: int) -> np.ndarray:
        """Accelerations and forces of one record, shape (2 n_dof, n_valid_samples); unknown forces are zero."""
        seg = self.data.segments[segment]
        force = np.nan_to_num(seg.F[seg.valid].astype(float).T)
        return np.vstack([seg.a[seg.valid].astype(float).T, force])

    def runs(self, record: int) -> list[slice]:
        """Runs of search rows of a record with no held-out piece in them, counted from its first valid row."""
        runs: list[slice] = []
        for rows in (b.rows for b in self.search if b.segment == record):
            if runs and runs[-1].stop == rows.start:
                runs[-1] = slice(runs[-1].start, rows.stop)
            else:
                runs.append(rows)
        return runs

    def pieces(self, data: SegmentSet | None = None) -> list[tuple[int, Segment]]:
        """The data that the search may see, as contiguous segments with the numbers of their records."""
        return [
            (i, replace(seg, valid=slice(seg.valid.start + rows.start, seg.valid.start + rows.stop)))
            for i, seg in enumerate((data or self.data).segments)
            for rows in self.runs(i)
        ]

    def seen_rows(self, record: int) -> np.ndarray:
        """Which samples of a record the search may look at."""
        segment = self.data.segments[record]
        seen = np.zeros(segment.n_samples, dtype=bool)
        for rows in self.runs(record):
            seen[segment.valid.start + rows.start : segment.valid.start + rows.stop] = True
        return seen
