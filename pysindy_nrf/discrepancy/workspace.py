"""Columns and Gram matrices of the search: computed once, extended by each candidate.

A candidate law adds a few columns; its cross products with the columns that share a balance with it
cost one small matrix product for all its shapes together, after which every refit is a matter of
matrices of a dozen rows.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ..chain import Chain
from ..chain_solve import Solution, groups_of, solve
from ..errors import pooled_error
from ..exceptions import NRFError, RankWarning
from ..identifiability import plan_walk
from ..laws.base import ForceLaw, Motion
from ..layout import LawLayout
from ..model import ChainModel
from ..moments import Moments
from ..regressor import _valued
from ..segments import SegmentSet
from ..sites import Site
from .admissible import admissible
from .projection import Projection
from .splits import BlockRows

Laws = Mapping[Site, tuple[ForceLaw, ...]]

# Bytes of columns of candidates that are kept from one step of the loop to the next.
CACHE = 200_000_000
# Shapes whose columns are built at once.
_AT_ONCE = 32


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
        self.searched = sorted({b.segment for b in search})
        seen = SegmentSet([data.segments[i] for i in self.searched], data.n_samples)
        self.forced, self.unknown = seen.forced, seen.unknown
        self._motions: dict[tuple[Site, int], Motion] = {}
        self._scales: dict[Site, tuple[float, float, float]] = {}
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
        sizes = [b.rows.stop - b.rows.start for b in self.search]
        self.sizes = np.array(sizes, dtype=float)
        ends = np.cumsum([0, *sizes])
        self.spans = [slice(int(lo), int(hi)) for lo, hi in zip(ends[:-1], ends[1:])]

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

    def motions(self, site: Site) -> list[Motion]:
        """Motion that a law at a site sees, for each record."""
        return [self.motion(site, i) for i in range(len(self.data.segments))]

    def scales(self, site: Site) -> tuple[float, float, float]:
        """Rms drift (m), rms rate (m/s) and longest record (s) of the search at a site."""
        if site not in self._scales:
            parts = [(self.motion(site, b.segment), b.rows) for b in self.search]
            s = np.sqrt(np.mean(np.concatenate([m.s[rows] for m, rows in parts]) ** 2))
            v = np.sqrt(np.mean(np.concatenate([m.v[rows] for m, rows in parts]) ** 2))
            chosen = [self.motion(site, i) for i in self.searched]
            length = max((float(m.t[-1] - m.t[0]) for m in chosen if m.t is not None), default=1.0)
            self._scales[site] = float(s), float(v), length
        return self._scales[site]

    def columns(self, site: Site, laws: Sequence[ForceLaw], segment: int) -> np.ndarray:
        """Columns of laws along one record, built from the raw motion and then filtered like the rest.

        Parameters
        ----------
        site : Site
        laws : sequence of ForceLaw
        segment : int

        Returns
        -------
        ndarray of shape (n_terms of all laws, n_valid_samples)
        """
        motion = self.motion(site, segment)
        return self.filtered(segment, np.vstack([law.features(motion).T for law in laws]))

    def search_columns(self, site: Site, laws: Sequence[ForceLaw], keep: bool = False) -> np.ndarray:
        """The same along all search blocks, one behind the other.

        Parameters
        ----------
        site : Site
        laws : sequence of ForceLaw
        keep : bool
            Remember them: the next step of the loop will ask for the same.

        Returns
        -------
        ndarray of shape (n_terms of all laws, n_search_samples)

        Raises
        ------
        NRFError
            If they are not finite.
        """
        key = (site, tuple(laws))
        if keep and key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        parts = {i: self.columns(site, laws, i) for i in self.searched}
        out = np.concatenate([parts[b.segment][:, b.rows] for b in self.search], axis=1)
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
        return np.concatenate([self._fixed[b.segment][:, b.rows] for b in self.search], axis=1)

    @property
    def blocks(self) -> list[BlockRows]:
        """Search blocks, then held-out blocks."""
        return self.search + self.held

    def uses(self, groups: Sequence[tuple[int, ...]]) -> tuple[dict[tuple[int, ...], int], np.ndarray]:
        """Which search blocks serve which group of balances: those in which all its forces are known.

        Parameters
        ----------
        groups : sequence of tuple of int
            DOFs.

        Returns
        -------
        uses : dict
            From a group to a row of ``members``.
        members : ndarray of bool of shape (n_uses, n_search_blocks)
        """
        seen = self.known[[b.segment for b in self.search]]
        rows: dict[bytes, int] = {}
        out, members = {}, []
        for dofs in groups:
            mine = seen[:, [j - 1 for j in dofs]].all(axis=1)
            if mine.tobytes() not in rows:
                rows[mine.tobytes()] = len(members)
                members.append(mine)
            out[dofs] = rows[mine.tobytes()]
        return out, np.array(members)


def leave_one_out(grams: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Sums over all blocks but one, from both ends, so that what is zero stays zero.

    Parameters
    ----------
    grams : ndarray of shape (n_blocks, p, p) or (n_blocks,)
    members : ndarray of bool of shape (n_uses, n_blocks)

    Returns
    -------
    ndarray of shape (n_blocks, n_uses, ...)
    """
    own = members.T.reshape(members.T.shape + (1,) * (grams.ndim - 1)) * grams[:, None]
    zero = np.zeros_like(own[:1])
    before = np.concatenate([zero, np.cumsum(own[:-1], axis=0)])
    after = np.concatenate([zero, np.cumsum(own[:0:-1], axis=0)])[::-1]
    return before + after


class Trial:
    """A set of laws with its Gram matrices, ready to be solved on any choice of blocks.

    Attributes
    ----------
    work : Workspace
    layout : LawLayout
    """

    def __init__(self, stage: Stage) -> None:
        self.stage, self.work, self.layout, self.walk = stage, stage.work, stage.layout, stage.walk
        self._groups = groups_of(self.layout, self.walk)
        self._last: tuple[np.ndarray, Moments] | None = None
        self._seen = np.array([self.work.known[b.segment] for b in self.work.blocks])

    @cached_property
    def grams(self) -> np.ndarray:
        """Columns ``[terms | a | F]``, search blocks first, then the held-out ones: (n_blocks, p, p)."""
        stage, work = self.stage, self.work
        out = [stage.grams]
        rows: dict[int, np.ndarray] = {}
        for block in work.held:
            if block.segment not in rows:
                rows = {block.segment: stage.rows(block.segment)}
            part = rows[block.segment][:, block.rows]
            out.append((part @ part.T)[None])
        return np.concatenate(out)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Samples of each block."""
        return np.array([b.rows.stop - b.rows.start for b in self.work.blocks])

    def moments(self, blocks: Sequence[int]) -> Moments:
        """Moments of some blocks."""
        chosen = np.asarray(blocks)
        if self._last is not None and np.array_equal(self._last[0], chosen):
            return self._last[1]
        cache: dict[bytes, tuple[np.ndarray, int]] = {}
        grams = self.stage.grams if chosen.max(initial=0) < len(self.work.search) else self.grams

        def gram(dofs: tuple[int, ...]) -> tuple[np.ndarray, int]:
            mine = chosen[self._seen[chosen][:, [j - 1 for j in dofs]].all(axis=1)]
            key = mine.tobytes()
            if key not in cache:
                cache[key] = grams[mine].sum(axis=0), int(self.sizes[mine].sum())
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
                raise NRFError(str(warning), "Leave the law out of the catalogue.") from None

    def model(self) -> ChainModel:
        """The chain model fitted to all search blocks.

        Raises
        ------
        NRFError
            If the columns depend on each other.
        """
        return model_of(self, self.solve(range(len(self.work.search))))

    def error(self, solution: Solution, blocks: Sequence[int]) -> float:
        """Pooled balance error on some blocks, percent NRMSE."""
        return pooled_error(solution.masses, solution.coefficients, self.moments(blocks))

    def search_error(self) -> float:
        """Pooled balance error on the search blocks it was fitted to, percent NRMSE."""
        return self.stage.slot().search_error()

    def fold_errors(self) -> np.ndarray:
        """Pooled balance error on each search block after fitting to the others, percent NRMSE."""
        return self.stage.slot().folds()


def model_of(trial: Trial, solution: Solution) -> ChainModel:
    """The chain model of a solved trial.

    Parameters
    ----------
    trial : Trial
    solution : Solution

    Returns
    -------
    ChainModel
    """
    layout = trial.layout
    laws = {s: _valued(layout.laws.get(s, ()), solution.coefficients.get(s)) for s in layout.sites}
    return ChainModel([solution.masses[j] for j in range(1, layout.n_dof + 1)], laws, layout.chain)


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
        self.work = work
        self.chain = chain.with_links([s for s, held in laws.items() if held and s.kind == "link"])
        self.laws = {s: tuple(held) for s, held in laws.items()}
        self.layout = LawLayout(self.chain, self.laws)
        self.walk = self._walk(self.layout)
        self.at: dict[tuple[Site, int], int] = {}
        at = 0
        for site in self.layout.sites:
            for i, law in enumerate(self.laws.get(site, ())):
                self.at[site, i], at = at, at + len(law.terms())
        self.tail = at
        self.columns = np.vstack(
            [*(work.search_columns(s, [law]) for s in self.layout.sites for law in self.laws.get(s, ())),
             work.search_fixed]
        )  # fmt: skip
        self.grams = np.array([(part := self.columns[:, rows]) @ part.T for rows in work.spans])

    def _walk(self, layout: LawLayout):
        work = self.work
        return plan_walk(
            layout.chain, work.forced, work.unknown, dict(work.known_masses), work.strategy, layout.acting
        ).require_complete()

    def rows(self, segment: int) -> np.ndarray:
        """All columns ``[terms | a | F]`` along one record."""
        parts = [self.work.columns(s, self.laws[s], segment) for s in self.layout.sites if self.laws.get(s)]
        return np.vstack([*parts, self.work.fixed(segment)])

    def trial(self) -> Trial:
        """The current laws, ready to be solved."""
        return Trial(self)

    def with_law(self, site: Site, law: ForceLaw, drop: Sequence[tuple[Site, int]] = ()) -> Stage:
        """A stage with one law more, and without some.

        Parameters
        ----------
        site : Site
        law : ForceLaw
        drop : sequence of (Site, int)
            Laws to leave out, by site and number.

        Returns
        -------
        Stage
        """
        kept = self.without(drop)
        kept[site] = (*kept.get(site, ()), law)
        return Stage(self.work, self.chain, kept)

    def without(self, drop: Sequence[tuple[Site, int]]) -> dict[Site, tuple[ForceLaw, ...]]:
        """The laws without some."""
        return {
            s: tuple(law for i, law in enumerate(held) if (s, i) not in drop) for s, held in self.laws.items()
        }

    def slot(
        self, site: Site | None = None, law: ForceLaw | None = None, drop: Sequence[tuple[Site, int]] = ()
    ) -> Slot:
        """A place for a law on top of the current ones, whatever the values of its shape parameters.

        Parameters
        ----------
        site : Site, optional
        law : ForceLaw, optional
            None: the current laws alone.
        drop : sequence of (Site, int)
            Laws to leave out.

        Returns
        -------
        Slot

        Raises
        ------
        NRFError
            If the laws cannot stand beside each other or cannot be identified.
        """
        return Slot(self, site, law, drop)


class Slot:
    """A place for one law on top of a stage; see :meth:`Stage.slot`.

    All methods take the law with values for its shape parameters, or none where the slot has no law.
    """

    def __init__(
        self, stage: Stage, site: Site | None, law: ForceLaw | None, drop: Sequence[tuple[Site, int]]
    ) -> None:
        self.stage, self.site, self.work = stage, site, stage.work
        kept = {
            s: [(stage.at[s, i], one) for i, one in enumerate(held) if (s, i) not in drop]
            for s, held in stage.laws.items()
        }
        chain = stage.chain
        self._size = len(stage.columns)
        self.width = 0
        if law is not None and site is not None:
            self.width = len(law.terms())
            kept.setdefault(site, []).append((self._size, law))
            if site.kind == "link":
                chain = chain.with_links([site])
        if law is None and not drop:
            layout, walk = stage.layout, stage.walk
        else:
            layout = LawLayout(chain, {s: tuple(one for _, one in held) for s, held in kept.items()})
            walk = stage._walk(layout)
        where = {s: [at + k for at, one in kept.get(s, ()) for k in range(len(one.terms()))] for s in layout.sites}
        uses, self._members = self.work.uses([g.dofs for g in groups_of(layout, walk)])
        self._project = Projection(layout, walk, self.work.known_masses, where, stage.tail, uses)
        near = [g for g in self._project.groups if site in g.sites] if self.width else []
        rows = {c for g in near for s in g.sites for c in where[s]}
        rows |= {stage.tail + k * self.work.n_dof + j - 1 for g in near for j in g.dofs for k in range(2)}
        self._near = sorted(c for c in rows if c < self._size)

    def errors(self, laws: Sequence[ForceLaw], keep: bool = False) -> np.ndarray:
        """Pooled error on the search blocks after fitting to all of them, for each law.

        Parameters
        ----------
        laws : sequence of ForceLaw
            The law of the slot with values of its shape parameters.
        keep : bool
            Remember the columns.

        Returns
        -------
        ndarray of shape (n_laws,)
            Percent NRMSE; infinite where the law cannot be told from the others, overflows or cannot be.
        """
        out = []
        for start in range(0, len(laws), _AT_ONCE):
            out.append(self._errors(laws[start : start + _AT_ONCE], keep))
        return np.concatenate(out) if out else np.zeros(0)

    def _errors(self, laws: Sequence[ForceLaw], keep: bool) -> np.ndarray:
        try:
            columns = self.work.search_columns(self.site, laws, keep)
        except NRFError:
            if len(laws) == 1:
                return np.full(1, np.inf)
            return np.concatenate([self._errors([law], keep) for law in laws])
        total = self.extended(columns, [slice(0, columns.shape[1])] if len(self._members) == 1 else self.work.spans)
        if total.shape[1] > 1:
            total = np.einsum("ub,mbij->muij", self._members.astype(float), total)
        errors, theta, _ = self._project(total, sizes=np.tile(self._members @ self.work.sizes, (len(total), 1)))
        sizes = np.sqrt(np.clip(np.diagonal(total[:, 0], axis1=1, axis2=2)[:, self._size :], 0.0, None))
        for i, law in enumerate(laws):
            if np.isfinite(errors[i]) and not admissible(law, theta[i, self._size :], sizes[i]):
                errors[i] = np.inf
        return errors

    def extended(self, columns: np.ndarray, spans: Sequence[slice]) -> np.ndarray:
        """Gram matrices with the columns of each law behind those of the stage.

        Parameters
        ----------
        columns : ndarray of shape (n_laws * width, n_search_samples)
        spans : sequence of slice

        Returns
        -------
        ndarray of shape (n_laws, n_spans, p, p)
        """
        size, width, near = self._size, self.width, self._near
        count = len(columns) // width
        out = np.zeros((count, len(spans), size + width, size + width))
        grams = self.stage.grams
        out[:, :, :size, :size] = grams if len(spans) == len(grams) else grams.sum(axis=0)
        beside = self.stage.columns[near]
        for b, rows in enumerate(spans):
            new = columns[:, rows]
            cross = (beside[:, rows] @ new.T).reshape(len(near), count, width).transpose(1, 0, 2)
            out[:, b, near, size:] = cross
            out[:, b, size:, near] = cross.transpose(1, 0, 2)
            own = new.reshape(count, width, -1)
            out[:, b, size:, size:] = own @ own.transpose(0, 2, 1)
        return out

    def _blocks(self, law: ForceLaw | None) -> np.ndarray:
        if law is None:
            return self.stage.grams
        return self.extended(self.work.search_columns(self.site, [law]), self.work.spans)[0]

    def search_error(self, law: ForceLaw | None = None) -> float:
        """Pooled error on the search blocks after fitting to all of them, percent NRMSE."""
        total = np.einsum("ub,bij->uij", self._members.astype(float), self._blocks(law))
        return float(self._project(total[None], sizes=(self._members @ self.work.sizes)[None])[0][0])

    def folds(self, law: ForceLaw | None = None) -> np.ndarray:
        """Pooled error on each search block after fitting to the others, percent NRMSE.

        Raises
        ------
        NRFError
            If the law overflows.
        """
        return self.fold_parts(law)[0]

    def fold_parts(self, law: ForceLaw | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, with the coefficients of each fold and the squares of each balance; see :class:`Projection`."""
        grams = self._blocks(law)
        fit = leave_one_out(grams, self._members)
        judge = self._members.T[:, :, None, None] * grams[:, None]
        return self._project(fit, judge, self._members.T * self.work.sizes[:, None])

    def jackknife(self, law: ForceLaw | None = None) -> np.ndarray:
        """Coefficients after fitting to all search blocks but one, shape (n_blocks, p)."""
        return self.fold_parts(law)[1]
