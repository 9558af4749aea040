"""The current model on the search data, and the places where a further law can stand.

A candidate law adds a few columns; its cross products with the columns that share a balance with it
cost one small matrix product for all its shapes together, after which every refit is a matter of
matrices of a dozen rows.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from ..exceptions import NRFError, RankWarning
from ..laws.base import ForceLaw
from ..mechanics.chain import Chain
from ..mechanics.identifiability import SolveOrder, plan_solve_order
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import Solution, groups_of, model_of, solve
from ..regression.errors import pooled_error
from ..regression.grams import BlockGrams
from ..regression.layout import LawLayout
from .admissible import admissible
from .projection import Projection
from .workspace import Workspace, leave_out_by_use

Laws = Mapping[Site, tuple[ForceLaw, ...]]

# Shapes whose columns are built at once.
_AT_ONCE = 32


class Trial:
    """A set of laws with its Gram matrices, ready to be solved on any choice of blocks.

    Attributes
    ----------
    work : Workspace
    layout : LawLayout
    """

    def __init__(self, stage: Stage) -> None:
        self.stage, self.work, self.layout, self.solve_order = stage, stage.work, stage.layout, stage.solve_order
        self._groups = groups_of(self.layout, self.solve_order)
        self._last: tuple[np.ndarray, BlockGrams] | None = None
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

    def total(self, blocks: Sequence[int]) -> BlockGrams:
        """Gram matrices of some blocks, summed."""
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

        self._last = chosen, BlockGrams.from_shared(self.layout, self._groups, gram, self.work.known_masses)
        return self._last[1]

    def solve(self, blocks: Sequence[int]) -> Solution:
        """Masses and coefficients from some blocks."""
        with warnings.catch_warnings():
            warnings.simplefilter("error", RankWarning)
            try:
                return solve(self.total(blocks), self.solve_order, self.work.known_masses)
            except RankWarning as warning:
                raise NRFError(str(warning), "Leave the law out of the catalogue.") from None

    def model(self) -> ChainModel:
        """The chain model fitted to all search blocks."""
        return model_of(self.layout, self.solve(range(len(self.work.search))))

    def error(self, solution: Solution, blocks: Sequence[int]) -> float:
        """Pooled balance error on some blocks, percent NRMSE."""
        return pooled_error(solution.masses, solution.coefficients, self.total(blocks))

    def search_error(self) -> float:
        """Pooled balance error on the search blocks it was fitted to, percent NRMSE."""
        return self.stage.slot().search_error()

    def fold_errors(self) -> np.ndarray:
        """Pooled balance error on each search block after fitting to the others, percent NRMSE."""
        return self.stage.slot().folds()


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
        self.solve_order = self._solve_order(self.layout)
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

    def _solve_order(self, layout: LawLayout) -> SolveOrder:
        work = self.work
        return plan_solve_order(
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
        """A stage with one law more, and without some."""
        kept = self.without(drop)
        kept[site] = (*kept.get(site, ()), law)
        return Stage(self.work, self.chain, kept)

    def with_values(self, place: tuple[Site, int], law: ForceLaw) -> Stage:
        """A stage in which one law has other shape parameters."""
        site, number = place
        changed = tuple(law if i == number else one for i, one in enumerate(self.laws[site]))
        return Stage(self.work, self.chain, {**self.laws, site: changed})

    def without(self, drop: Sequence[tuple[Site, int]]) -> dict[Site, tuple[ForceLaw, ...]]:
        """The laws without some."""
        return {
            s: tuple(law for i, law in enumerate(held) if (s, i) not in drop) for s, held in self.laws.items()
        }

    def slot(
        self, site: Site | None = None, law: ForceLaw | None = None, drop: Sequence[tuple[Site, int]] = ()
    ) -> Slot:
        """A place for a law on top of the current ones, whatever the values of its shape parameters."""
        return Slot(self, site, law, drop)


class Slot:
    """A place for one law on top of a stage; see :meth:`Stage.slot`."""

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
            layout, solve_order = stage.layout, stage.solve_order
        else:
            layout = LawLayout(chain, {s: tuple(one for _, one in held) for s, held in kept.items()})
            solve_order = stage._solve_order(layout)
        where = {s: [at + k for at, one in kept.get(s, ()) for k in range(len(one.terms()))] for s in layout.sites}
        uses, self._members = self.work.uses([g.dofs for g in groups_of(layout, solve_order)])
        self._project = Projection(layout, solve_order, self.work.known_masses, where, stage.tail, uses)
        near = [g for g in self._project.groups if site in g.sites] if self.width else []
        rows = {c for g in near for s in g.sites for c in where[s]}
        rows |= {stage.tail + k * self.work.n_dof + j - 1 for g in near for j in g.dofs for k in range(2)}
        self._near = sorted(c for c in rows if c < self._size)

    def errors(self, laws: Sequence[ForceLaw], keep: bool = False) -> np.ndarray:
        """Pooled error on the search blocks after fitting to all of them, for each law."""
        out = []
        for start in range(0, len(laws), _AT_ONCE):
            out.append(self._errors(laws[start : start + _AT_ONCE], keep))
        return np.concatenate(out) if out else np.zeros(0)

    def _columns(self, laws: Sequence[ForceLaw], keep: bool = False) -> np.ndarray:
        assert self.site is not None  # a slot for a law has a place
        return self.work.search_columns(self.site, laws, keep)

    def _errors(self, laws: Sequence[ForceLaw], keep: bool) -> np.ndarray:
        try:
            columns = self._columns(laws, keep)
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
        """Gram matrices with the columns of each law behind those of the stage."""
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
        return self.extended(self._columns([law]), self.work.spans)[0]

    def search_error(self, law: ForceLaw | None = None) -> float:
        """Pooled error on the search blocks after fitting to all of them, percent NRMSE."""
        total = np.einsum("ub,bij->uij", self._members.astype(float), self._blocks(law))
        return float(self._project(total[None], sizes=(self._members @ self.work.sizes)[None])[0][0])

    def folds(self, law: ForceLaw | None = None) -> np.ndarray:
        """Pooled error on each search block after fitting to the others, percent NRMSE."""
        return self.fold_parts(law)[0]

    def fold_parts(self, law: ForceLaw | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same, with the coefficients of each fold and the squares of each balance; see :class:`Projection`."""
        grams = self._blocks(law)
        fit = leave_out_by_use(grams, self._members)
        judge = self._members.T[:, :, None, None] * grams[:, None]
        return self._project(fit, judge, self._members.T * self.work.sizes[:, None])

    def jackknife(self, law: ForceLaw | None = None) -> np.ndarray:
        """Coefficients after fitting to all search blocks but one, shape (n_blocks, p)."""
        return self.fold_parts(law)[1]
