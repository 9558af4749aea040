"""The records of one search: motions, columns and blocks, with everything that does not depend on the model."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..laws.shape import Motion, Scales
from ..mechanics.sites import Site
from ..regression.chain_solve import clock_of
from ..regression.grams import leave_one_out
from ..regression.segments import BlockRows, Segment, SegmentSet, half_the_rate
from .splits import joined

# Bytes of columns of candidates that are kept from one step of the loop to the next.
CACHE = 200_000_000


class Workspace:
    """The records of one search, with everything that does not depend on the laws.

    Parameters
    ----------
    data : SegmentSet
    filters : sequence of FairFilter or None
        One for each record.
    search, held : sequence of BlockRows
    known_masses : mapping of int to float
    strategy : str
    kept : ndarray of bool, shape (n_search_samples,), optional
        Samples of the search blocks, one behind the other, that take part in a fit; all if None.
    """

    def __init__(
        self,
        data: SegmentSet,
        filters: Sequence[Any],
        search: Sequence[BlockRows],
        held: Sequence[BlockRows],
        known_masses: Mapping[int, float],
        strategy: str,
        kept: np.ndarray | None = None,
    ) -> None:
        self.data, self.filters, self.kept = data, list(filters), kept
        self.search, self.held = list(search), list(held)
        self.known_masses, self.strategy = dict(known_masses), strategy
        self.n_dof = data.n_dof
        self.searched = sorted({b.segment for b in search})
        seen = SegmentSet([data.segments[i] for i in self.searched], data.n_samples)
        self.forced, self.unknown = seen.forced, seen.unknown
        self._motions: dict[tuple[Site, int], Motion] = {}
        self._scales: dict[Site, Scales] = {}
        self._cache: OrderedDict[Any, np.ndarray] = OrderedDict()
        self._cached = 0
        self._fixed = []
        for i, seg in enumerate(data.segments):
            a = self.filtered(i, seg.a[seg.valid].astype(float).T)
            force = seg.F[seg.valid].astype(float).T
            known = ~np.isnan(force[:, 0])
            force[known] = self.filtered(i, force[known]) if known.any() else force[known]
            force[~known] = 0.0
            self._fixed.append(np.vstack([a, force]))
        self.known = np.array([~np.isnan(seg.F[seg.valid.start]) for seg in data.segments])
        ends = np.cumsum([0, *(b.rows.stop - b.rows.start for b in self.search)])
        self.spans = [slice(int(lo), int(hi)) for lo, hi in zip(ends[:-1], ends[1:])]
        counts = [rows.stop - rows.start if kept is None else np.count_nonzero(kept[rows]) for rows in self.spans]
        self.sizes = np.array(counts, dtype=float)

    def only(self, kept: np.ndarray) -> Workspace:
        """The same records, of which only some samples of the search blocks take part in a fit."""
        return Workspace(
            self.data, self.filters, self.search, self.held, self.known_masses, self.strategy, kept
        )

    def _of_search(self, parts: Mapping[int, np.ndarray]) -> np.ndarray:
        """Rows along all search blocks, one behind the other; zero where a sample takes no part."""
        out = np.concatenate([parts[b.segment][:, b.rows] for b in self.search], axis=1)
        return out if self.kept is None else out * self.kept

    def filtered(self, segment: int, rows: np.ndarray) -> np.ndarray:
        """Rows of one record through its fair filter."""
        filter = self.filters[segment]
        return np.ascontiguousarray(rows if filter is None else filter.apply(rows.T).T)

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

    def runs(self, record: int) -> list[slice]:
        """Runs of search rows of a record with no held-out piece in them, counted from its first valid row."""
        return joined(b.rows for b in self.search if b.segment == record)

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
        for b in self.search:
            if b.segment == record:
                seen[segment.valid.start + b.rows.start : segment.valid.start + b.rows.stop] = True
        return seen

    def columns(self, site: Site, laws: Sequence[ForceLaw], segment: int) -> np.ndarray:
        """Columns of laws along one record, built from the raw motion and then filtered like the rest."""
        motion = self.motion(site, segment)
        return self.filtered(segment, np.vstack([law.features(motion).T for law in laws]))

    def search_columns(self, site: Site, laws: Sequence[ForceLaw], keep: bool = False) -> np.ndarray:
        """The same along all search blocks, one behind the other."""
        key = (site, tuple(laws))
        if keep and key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        out = self._of_search({i: self.columns(site, laws, i) for i in self.searched})
        if not np.isfinite(out).all():
            raise NRFError("The columns of the law overflow", "Leave it out of the catalogue.")
        if keep and out.nbytes < CACHE // 4:
            self._cache[key] = out
            self._cached += out.nbytes
            while self._cached > CACHE:
                self._cached -= self._cache.popitem(last=False)[1].nbytes
        return out

    def fixed(self, segment: int) -> np.ndarray:
        """Accelerations and forces of one record, shape (2 n_dof, n_valid_samples)."""
        return self._fixed[segment]

    @cached_property
    def search_fixed(self) -> np.ndarray:
        """The same along all search blocks."""
        return self._of_search(dict(enumerate(self._fixed)))

    @property
    def blocks(self) -> list[BlockRows]:
        """Search blocks, then held-out blocks."""
        return self.search + self.held

    def uses(self, groups: Sequence[tuple[int, ...]]) -> tuple[dict[tuple[int, ...], int], np.ndarray]:
        """Which search blocks serve which group of balances: those in which all its forces are known."""
        seen = self.known[[b.segment for b in self.search]]
        rows: dict[bytes, int] = {}
        out: dict[tuple[int, ...], int] = {}
        members: list[np.ndarray] = []
        for dofs in groups:
            mine = np.asarray(seen[:, [j - 1 for j in dofs]].all(axis=1))
            if mine.tobytes() not in rows:
                rows[mine.tobytes()] = len(members)
                members.append(mine)
            out[dofs] = rows[mine.tobytes()]
        return out, np.array(members)


def leave_out_by_use(grams: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Sums over all blocks but one, from both ends, so that what is zero stays zero."""
    own = members.T.reshape(members.T.shape + (1,) * (grams.ndim - 1)) * grams[:, None]
    return leave_one_out(own)
