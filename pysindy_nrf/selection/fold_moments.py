"""Moments of all orders in one pass over the samples, fold by fold."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg
from scipy.linalg import blas

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import Block, Group, LawLayout
from ..chain.sites import Site
from ..chain.structure import Chain
from ..equations.accumulation import GramPass
from ..equations.balances import blocks_of_segment
from ..equations.chain_solve import NotTogether, Solution, groups_of, solve
from ..equations.normal_equations import NormalEquations
from ..exceptions import ChannelError, NRFError, RankWarning
from ..laws.base import ForceLaw
from ..laws.power_series import PowerSeries, exponents_of
from ..records.dataset import Dataset


class Monomials(PowerSeries):
    """Terms v^h s^j of a given list of exponents; see
    :class:`~pysindy_nrf.laws.PowerSeries`.
    """

    def __init__(self, exponents: Iterable[tuple[int, int]]) -> None:
        self.exponents = tuple(
            sorted(set(exponents), key=lambda p: (p[0] + p[1], -p[0]))
        )
        self.degree = max((h + j for h, j in self.exponents), default=0)
        ForceLaw.__init__(self, {}, None)

    def positions(self, order: Any) -> np.ndarray:
        """Where the terms of one order stand among these."""
        place = {pair: i for i, pair in enumerate(self.exponents)}
        return np.array([place[pair] for pair in exponents_of(order)], dtype=int)


_ROWS = 2048  # sampled for the factors of the sites
EVERY = "every"  # stands for all folds, stacked


@dataclass
class Order:
    """One candidate: an order at every storey, and where its columns stand among those
    of all candidates.
    """

    layout: LawLayout
    columns: dict[Site, np.ndarray]
    _groups: dict[SolveOrder, list[Group]] = field(
        default_factory=dict, init=False, repr=False
    )
    _index: dict[Group, np.ndarray] = field(
        default_factory=dict, init=False, repr=False
    )

    def groups(self, solve_order: SolveOrder) -> list[Group]:
        """Groups of columns a solve order needs."""
        if solve_order not in self._groups:
            self._groups[solve_order] = groups_of(self.layout, solve_order)
        return self._groups[solve_order]

    def index(self, group: Group, whole: NormalEquations) -> np.ndarray:
        """Where the columns of a group stand among those of all candidates."""
        if group not in self._index:
            where, *others = whole.positions(group.dofs)
            own = [
                where[s].start + self.columns[s]
                for s in group.sites
                if s in self.columns
            ]
            self._index[group] = np.concatenate(
                [*own, np.array([i for i in others if i is not None])]
            )
        return self._index[group]


class FoldMoments:
    """Gram matrices of the samples that are on the same sides of all folds, of all
    orders that will be asked for.
    """

    def __init__(
        self,
        chain: Chain,
        laws: Mapping[Site, Sequence[ForceLaw]],
        orders: Mapping[Site, Iterable[Any]],
        data: Dataset,
        folds: Sequence[tuple[np.ndarray, np.ndarray]],
        filters: Sequence[Any],
        known_masses: Mapping[int, float],
        strategy: str,
        inner: Any = None,
    ) -> None:
        self.chain, self.laws = chain, {s: tuple(held) for s, held in laws.items()}
        self.data, self.filters, self.inner = data, filters, inner
        self.known_masses, self.strategy = dict(known_masses), strategy
        terms = {
            site: [pair for order in given for pair in exponents_of(order)]
            for site, given in orders.items()
        }
        self.union = {site: Monomials(pairs) for site, pairs in terms.items()}
        self.layout = LawLayout(
            chain, {**{s: (law,) for s, law in self.union.items()}, **self.laws}
        )
        self.groups = self._groups()
        self.factors = self._sampled_factors()
        self.class_of, self.membership = _classes(data.n_samples, folds)
        self.n_folds = len(folds)
        self._solve_orders: dict[Any, SolveOrder] = {}
        self._backs: dict[tuple[int, ...], np.ndarray] = {}
        size = len(self.membership), chain.n_dof
        self.sums, self.counts = (
            np.zeros(size),
            np.zeros(size),
        )  # of the accelerations, for the variance behind R^2
        self._totals: dict[Any, tuple[NormalEquations, np.ndarray, np.ndarray]] = {}
        grams = GramPass(self.layout, self.groups, self.known_masses, n_blocks=size[0])
        self.pieces = grams.add_each(self._blocks()).grams()

    def _groups(self) -> list[Group]:
        solve_order = plan_solve_order(
            self.chain,
            self.data.forced,
            self.data.unknown,
            self.known_masses,
            self.strategy,
            self.layout.acting,
        ).require_complete()
        n = self.chain.n_dof
        # sums of balances that a fold may need, in which some DOF is not forced
        sums = [
            tuple(range(i, n + 1))
            for i in range(1, n)
            if all(j in self.known_masses for j in range(i, n + 1))
        ]
        held = {g.dofs: g for g in groups_of(self.layout, solve_order)}
        return [
            *held.values(),
            *(self.layout.group(dofs) for dofs in sums if dofs not in held),
        ]

    def _sampled_factors(self) -> dict[Site, np.ndarray]:
        """For each searched site the triangular factor that makes its powers orthogonal
        on some of the samples.
        """
        stride = max(1, sum(seg.n_valid for seg in self.data.segments) // _ROWS)
        out = {}
        for site, law in self.union.items():
            if self.layout.counts[site]:
                parts = (
                    seg.motion(site, slice(seg.valid.start, seg.valid.stop, stride))
                    for seg in self.data.segments
                )
                out[site] = _factor(
                    np.concatenate([law.features(part) for part in parts])
                )
        return out

    def _whiten(self, block: Block) -> Block:
        """The same samples with the powers of each searched site divided by its factor:
        products keep their digits.
        """
        for (
            site,
            upper,
        ) in self.factors.items():  # in place: the columns of a block are its own
            blas.dtrsm(
                1.0,
                upper,
                block.terms[self.layout.slices[site]].T,
                side=1,
                overwrite_b=1,
            )
        return Block(block.terms, block.acceleration, block.force)

    def _back(self, dofs: tuple[int, ...]) -> np.ndarray:
        """Accumulated columns of a group times this are its powers."""
        if dofs not in self._backs:
            group = next(g for g in self.groups if g.dofs == dofs)
            blocks = map(
                self.factors.get,
                group.sites,
                (np.eye(self.layout.counts[site]) for site in group.sites),
            )
            self._backs[dofs] = linalg.block_diag(
                *blocks, np.eye(2 if len(group.dofs) == 1 else 1)
            )
        return self._backs[dofs]

    def _blocks(self) -> Iterator[tuple[int, Block]]:
        """All samples, and the class they belong to."""
        for seg, filter in zip(self.data.segments, self.filters):
            classes, at = self.class_of[seg.rows][seg.valid], 0
            for block in map(
                self._whiten, blocks_of_segment(seg, self.layout, filter=filter)
            ):
                here = classes[at : at + block.n_samples]
                at += block.n_samples
                for code in np.unique(here).tolist():
                    part = block.take(here == code)
                    known = np.array(block.known)
                    self.sums[code] += np.where(
                        known, part.acceleration.sum(axis=1), 0.0
                    )
                    self.counts[code] += known * part.n_samples
                    yield code, part

    def total(
        self, fold: Any, side: str = "train"
    ) -> tuple[NormalEquations, np.ndarray, np.ndarray]:
        """Roots of one side of a fold, sums of accelerations and counts; None: of all
        samples, EVERY: stacked.
        """
        key = (fold, side)
        if key not in self._totals:
            if fold is None:
                wanted = np.ones((1, len(self.pieces)))
            else:
                chosen = (self.membership == {"train": 1, "test": 2}[side]) & (
                    self.pieces.n_samples > 0
                )[:, None]
                wanted = 1.0 * chosen.T[slice(None) if fold == EVERY else [fold]]
            empty = np.flatnonzero(~wanted.any(axis=1))
            if empty.size:
                number = empty[0] if fold == EVERY else fold
                raise ChannelError(
                    f"Fold {number} has no {side} samples", "Check the splitter."
                )
            found = self._sums(wanted), wanted @ self.sums, wanted @ self.counts
            self._totals[key] = (
                found if fold == EVERY else (found[0][0], found[1][0], found[2][0])
            )
        return self._totals[key]

    def _sums(self, wanted: np.ndarray) -> NormalEquations:
        """Roots of the monomials, each the sum of so many times each piece."""
        return (
            self.pieces.sum(wanted)
            .roots()
            .transformed(self.layout, {g: self._back(g.dofs) for g in self.groups})
        )

    def order(self, orders: Mapping[Site, Any]) -> Order:
        """A candidate with an order at every searched site."""
        layout = LawLayout(
            self.chain,
            {**{s: (PowerSeries(o),) for s, o in orders.items()}, **self.laws},
        )
        columns = {
            s: (
                self.union[s].positions(orders[s])
                if s in self.union
                else np.arange(layout.counts[s])
            )
            for s in layout.acting
        }
        return Order(layout, columns)

    def cut(
        self, total: NormalEquations, order: Order, groups: Sequence[Group]
    ) -> NormalEquations:
        """A candidate's own columns."""
        return total.transformed(
            order.layout, {g: order.index(g, total) for g in groups}
        )

    def solve_order(self, total: NormalEquations, order: Order) -> SolveOrder:
        """The solve that the forces in some samples allow."""
        forced, unknown = [], []
        for j in range(1, self.chain.n_dof + 1):
            seen = total.sizes[j,] > 0
            pushed = np.linalg.norm(total.matrices[j,][..., -1], axis=-1) > 0
            for held in (seen, pushed):
                if np.any(held) != np.all(held):
                    raise NotTogether()
            if not np.all(seen):
                unknown.append(j)
            elif np.all(pushed):
                forced.append(j)
        key = tuple(forced), tuple(unknown), order.layout.acting, self.inner is not None
        if key not in self._solve_orders:
            known = self.known_masses, self.strategy
            self._solve_orders[key] = plan_solve_order(
                self.chain, *key[:2], *known, *key[2:]
            )
        return self._solve_orders[key].require_complete()

    def fit(
        self, order: Order, fold: Any
    ) -> tuple[Solution, SolveOrder, NormalEquations]:
        """Solve one candidate on the training side of a fold."""
        total = self.total(fold)[0]
        solve_order = self.solve_order(total, order)
        own = self.cut(total, order, order.groups(solve_order))
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            return (
                solve(own, solve_order, self.known_masses, self.inner),
                solve_order,
                own,
            )


def _factor(columns: np.ndarray) -> np.ndarray:
    """Triangular factor of some columns that can be divided by."""
    upper = np.zeros((columns.shape[1],) * 2)
    found = linalg.qr(columns, mode="r", check_finite=False)[0][: len(upper)]
    upper[: len(found)] = found
    least = 1e-9 * np.linalg.norm(upper, axis=0)
    least[least == 0] = 1.0  # nothing moves
    np.fill_diagonal(
        upper, np.where(np.abs(np.diag(upper)) > least, np.diag(upper), least)
    )
    return upper


def _classes(
    size: int, folds: Sequence[tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Class of each row, and on which side of each fold (0 out, 1 train, 2 test) a
    class is.
    """
    sides, changes = [], np.zeros(size, dtype=bool)
    changes[:1] = True
    for train, test in folds:
        side = np.zeros(size, dtype=np.int8)
        side[train] = 1
        if side[test].any():
            raise NRFError(
                "A fold tests on samples it was trained with", "Check the splitter."
            )
        side[test] = 2
        sides.append(side)
        changes[1:] |= side[1:] != side[:-1]
    starts = np.flatnonzero(changes)
    code, membership = (
        np.zeros(len(starts), dtype=np.int64),
        np.zeros((1, 0), dtype=np.int8),
    )
    for side in sides:
        code, unique = pd.factorize(code * 3 + side[starts])
        membership = np.column_stack(
            [membership[unique // 3], (unique % 3).astype(np.int8)]
        )
    return np.repeat(code, np.diff(starts, append=size)), membership
