"""Columns and Gram matrices of the search: computed once, extended by each candidate.

A candidate law adds a few columns; its cross products with the columns that are there cost one
small matrix product, after which every refit is a matter of matrices of a dozen rows.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..chain import Chain
from ..chain_solve import Solution, groups_of, solve
from ..errors import pooled_error
from ..exceptions import NRFError, RankWarning
from ..identifiability import plan_walk
from ..laws.base import ForceLaw, Motion
from ..layout import LawLayout
from ..moments import Moments
from ..segments import SegmentSet
from ..sites import Site
from .splits import BlockRows

Laws = Mapping[Site, tuple[ForceLaw, ...]]


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
    """

    def __init__(
        self,
        data: SegmentSet,
        filters: Sequence[Any],
        search: Sequence[BlockRows],
        held: Sequence[BlockRows],
        known_masses: Mapping[int, float],
        strategy: str,
    ) -> None:
        self.data, self.filters = data, list(filters)
        self.search, self.held = list(search), list(held)
        self.known_masses, self.strategy = dict(known_masses), strategy
        self.n_dof = data.n_dof
        seen = SegmentSet([data.segments[i] for i in sorted({b.segment for b in search})], data.n_samples)
        self.forced, self.unknown = seen.forced, seen.unknown
        self._motions: dict[Site, list[Motion]] = {}
        self._fixed = []
        for i, seg in enumerate(data.segments):
            a = self.filtered(i, seg.a[seg.valid].astype(float).T)
            force = seg.F[seg.valid].astype(float).T
            known = ~np.isnan(force[:, 0])
            force[known] = self.filtered(i, force[known]) if known.any() else force[known]
            force[~known] = 0.0
            self._fixed.append(np.vstack([a, force]))
        self.known = np.array([~np.isnan(seg.F[seg.valid.start]) for seg in data.segments])

    def filtered(self, segment: int, rows: np.ndarray) -> np.ndarray:
        """Rows of one record through its fair filter."""
        filter = self.filters[segment]
        return np.ascontiguousarray(rows if filter is None else filter.apply(rows.T).T)

    def motions(self, site: Site) -> list[Motion]:
        """Motion that a law at a site sees, for each record."""
        if site not in self._motions:
            self._motions[site] = [seg.motion(site, seg.valid) for seg in self.data.segments]
        return self._motions[site]

    def scales(self, site: Site) -> tuple[float, float, float]:
        """Rms drift (m), rms rate (m/s) and longest record (s) of the search at a site."""
        motions = self.motions(site)
        parts = [(motions[b.segment].s[b.rows], motions[b.segment].v[b.rows]) for b in self.search]
        s, v = (np.sqrt(np.mean(np.concatenate([p[i] for p in parts]) ** 2)) for i in range(2))
        chosen = [motions[i] for i in {b.segment for b in self.search}]
        length = max((float(m.t[-1] - m.t[0]) for m in chosen if m.t is not None), default=1.0)
        return float(s), float(v), length

    def columns(self, site: Site, law: ForceLaw) -> list[np.ndarray]:
        """Columns of a law, built from the raw motion and then filtered like the rest.

        Returns
        -------
        list of ndarray of shape (n_terms, n_valid_samples)
        """
        return [self.filtered(i, np.ascontiguousarray(law.features(m).T)) for i, m in enumerate(self.motions(site))]

    def fixed(self, segment: int) -> np.ndarray:
        """Accelerations and forces of one record, shape (2 n_dof, n_valid_samples)."""
        return self._fixed[segment]

    @property
    def blocks(self) -> list[BlockRows]:
        """Search blocks, then held-out blocks."""
        return self.search + self.held


@dataclass
class Trial:
    """A set of laws with its Gram matrices, ready to be solved on any choice of blocks.

    Attributes
    ----------
    work : Workspace
    layout : LawLayout
    grams : ndarray of shape (n_blocks, p, p)
        Columns ``[terms | a | F]``, search blocks first, then the held-out ones.
    sizes : ndarray of shape (n_blocks,)
    """

    work: Workspace
    layout: LawLayout
    grams: np.ndarray
    sizes: np.ndarray

    def __post_init__(self) -> None:
        known = dict(self.work.known_masses)
        self.walk = plan_walk(
            self.layout.chain, self.work.forced, self.work.unknown, known, self.work.strategy, self.layout.acting
        ).require_complete()
        self._groups = groups_of(self.layout, self.walk)
        self._last: tuple[np.ndarray, Moments] | None = None
        self._seen = np.array([self.work.known[b.segment] for b in self.work.blocks])

    def moments(self, blocks: Sequence[int]) -> Moments:
        """Moments of some blocks."""
        chosen = np.asarray(blocks)
        if self._last is not None and np.array_equal(self._last[0], chosen):
            return self._last[1]
        cache: dict[bytes, tuple[np.ndarray, int]] = {}

        def gram(dofs: tuple[int, ...]) -> tuple[np.ndarray, int]:
            mine = chosen[self._seen[chosen][:, [j - 1 for j in dofs]].all(axis=1)]
            key = mine.tobytes()
            if key not in cache:
                cache[key] = self.grams[mine].sum(axis=0), int(self.sizes[mine].sum())
            return cache[key]

        self._last = chosen, Moments.from_gram(self.layout, self._groups, gram, self.work.known_masses)
        return self._last[1]

    def solve(self, blocks: Sequence[int]) -> Solution:
        """Masses and coefficients from some blocks.

        Raises
        ------
        NRFError
            If the columns depend on each other.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("error", RankWarning)
            try:
                return solve(self.moments(blocks), self.walk, self.work.known_masses)
            except RankWarning as warning:
                raise NRFError(str(warning)) from None

    def error(self, solution: Solution, blocks: Sequence[int]) -> float:
        """Pooled balance error on some blocks, percent NRMSE."""
        return pooled_error(solution.masses, solution.coefficients, self.moments(blocks))

    def search_fit(self) -> tuple[float, Solution]:
        """Pooled balance error on the search blocks after fitting to all of them (percent NRMSE), and the fit."""
        every = range(len(self.work.search))
        solution = self.solve(every)
        return pooled_error(solution.masses, solution.coefficients, self.moments(every)), solution

    def search_error(self) -> float:
        """Pooled balance error on the search blocks it was fitted to, percent NRMSE."""
        return self.search_fit()[0]

    def fold_errors(self) -> np.ndarray:
        """Pooled balance error on each search block after fitting to the others, percent NRMSE."""
        every = np.arange(len(self.work.search))
        return np.array([self.error(self.solve(every[every != k]), [k]) for k in every])


class Stage:
    """The laws of the current model with their columns; candidates are tried on top of it.

    Parameters
    ----------
    work : Workspace
    chain : Chain
    laws : mapping of Site to sequence of ForceLaw
        Every shape parameter has its value.
    """

    def __init__(self, work: Workspace, chain: Chain, laws: Laws) -> None:
        self.work, self.chain, self.laws = work, chain, dict(laws)
        rows: list[list[np.ndarray]] = [[] for _ in work.data.segments]
        self._at: dict[tuple[Site, int], int] = {}
        at = 0
        for site, held in self.laws.items():
            for i, law in enumerate(held):
                self._at[site, i], at = at, at + len(law.terms())
                for part, columns in zip(rows, work.columns(site, law)):
                    part.append(columns)
        self._tail = at
        self._rows = [np.vstack([*part, work.fixed(i)]) for i, part in enumerate(rows)]
        self._grams = np.array([self._view(b) @ self._view(b).T for b in work.blocks])
        self._sizes = np.array([b.rows.stop - b.rows.start for b in work.blocks])

    def _view(self, block: BlockRows) -> np.ndarray:
        return self._rows[block.segment][:, block.rows]

    def trial(
        self, site: Site | None = None, law: ForceLaw | None = None, drop: Sequence[tuple[Site, int]] = ()
    ) -> Trial:
        """The current laws, with one more or without some.

        Parameters
        ----------
        site : Site, optional
        law : ForceLaw, optional
            The candidate.
        drop : sequence of (Site, int)
            Laws to leave out, by site and number.

        Returns
        -------
        Trial

        Raises
        ------
        NRFError
            If the laws cannot stand beside each other or cannot be identified.
        """
        kept = {
            s: [(self._at[s, i], one) for i, one in enumerate(held) if (s, i) not in drop]
            for s, held in self.laws.items()
        }
        grams, chain = self._grams, self.chain
        if law is not None and site is not None:
            kept.setdefault(site, []).append((len(grams[0]), law))
            grams = self._extended(self.work.columns(site, law))
            if site.kind == "link":
                chain = chain.with_links([site])
        layout = LawLayout(chain, {s: tuple(one for _, one in held) for s, held in kept.items()})
        index = [at + k for s in layout.sites for at, one in kept.get(s, ()) for k in range(len(one.terms()))]
        index += range(self._tail, self._tail + 2 * self.work.n_dof)
        return Trial(self.work, layout, grams[np.ix_(np.arange(len(grams)), index, index)], self._sizes)

    def _extended(self, columns: list[np.ndarray]) -> np.ndarray:
        k, p = len(columns[0]), len(self._rows[0])
        out = np.empty((len(self.work.blocks), p + k, p + k))
        out[:, :p, :p] = self._grams
        for b, block in enumerate(self.work.blocks):
            new = columns[block.segment][:, block.rows]
            cross = self._view(block) @ new.T
            out[b, :p, p:], out[b, p:, :p] = cross, cross.T
            out[b, p:, p:] = new @ new.T
        if not np.isfinite(out).all():
            raise NRFError("The columns of the law overflow")
        return out
