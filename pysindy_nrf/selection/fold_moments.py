"""Moments of all orders in one pass over the samples, fold by fold, in orthogonal polynomials."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy import linalg
from scipy.linalg import blas

from ..exceptions import ChannelError, NRFError, RankWarning
from ..laws.base import ForceLaw, Term
from ..laws.power_series import PowerSeries, exponents_of
from ..laws.shape import Motion
from ..mechanics.chain import Chain
from ..mechanics.identifiability import SolveOrder, plan_solve_order
from ..mechanics.sites import Site
from ..regression.chain_solve import NotTogether, Solution, groups_of, solve
from ..regression.gram_pass import GramPass
from ..regression.grams import BlockGrams
from ..regression.layout import Block, Group, LawLayout, cut_at
from ..regression.segments import SegmentSet


class Monomials(PowerSeries):
    """Terms v^h s^j of a given list of exponents; see :class:`~pysindy_nrf.laws.PowerSeries`."""

    def __init__(self, exponents: Iterable[tuple[int, int]]) -> None:
        self.exponents = tuple(sorted(set(exponents), key=lambda p: (p[0] + p[1], -p[0])))
        self.degree = max((h + j for h, j in self.exponents), default=0)
        ForceLaw.__init__(self, {}, None)

    def positions(self, order: Any) -> np.ndarray:
        """Where the terms of one order stand among these."""
        place = {pair: i for i, pair in enumerate(self.exponents)}
        return np.array([place[pair] for pair in exponents_of(order)], dtype=int)

    def features(self, motion: Motion, state: Any = None) -> np.ndarray:
        """Columns, by one multiplication each."""
        return self._products(*(
            _powers(x, max((p[i] for p in self.exponents), default=0)) for i, x in enumerate((motion.v, motion.s))
        ))  # fmt: skip

    def _products(self, of_v: np.ndarray, of_s: np.ndarray) -> np.ndarray:
        """Column (h, j) is row h of the first times row j of the second."""
        out = np.empty((len(self.exponents), of_v.shape[1]))
        for row, (h, j) in zip(out, self.exponents):
            np.multiply(of_v[h], of_s[j], out=row)
        return out.T


def _powers(x: np.ndarray, highest: int) -> np.ndarray:
    out = np.ones((highest + 1, len(x)))
    for k in range(1, highest + 1):
        np.multiply(out[k - 1], x, out=out[k])
    return out


class Polynomials:
    """1 and y times the polynomials orthogonal on a sample with the weight y^2 (Gautschi, 2004, sec. 2.2)."""

    def __init__(self, x: np.ndarray, highest: int) -> None:
        self.highest = highest
        self.scale = float(np.sqrt(np.mean(x**2))) if x.size else 0.0
        self.scale = self.scale or 1.0  # nothing moves
        self.a, self.b = np.zeros((2, max(highest, 1)))
        y = x / self.scale
        p, below, size = y, np.zeros(len(y)), 0.0
        for k in range(1, highest):
            squares = float(p @ p)
            if not squares:
                break  # fewer different values than powers
            self.a[k] = (y * p) @ p / squares
            self.b[k] = squares / size if size else 0.0
            p, below, size = (y - self.a[k]) * p - self.b[k] * below, p, squares

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values, shape (highest + 1, n)."""
        out = np.ones((self.highest + 1, len(x)))
        if self.highest:
            np.divide(x, self.scale, out=out[1])
        for k in range(1, self.highest):
            np.subtract(out[1], self.a[k], out=out[k + 1])
            out[k + 1] *= out[k]
            if k > 1:
                out[k + 1] -= self.b[k] * out[k - 1]
        return out

    @cached_property
    def powers(self) -> np.ndarray:
        """Coefficients of the powers of x in the polynomials: x^h is the sum over k of powers[k, h] p_k."""
        size = self.highest + 1
        times_y = np.diag(np.ones(self.highest), -1)  # y p_k = p_{k+1} + a_k p_k + b_k p_{k-1}
        inside = np.arange(1, self.highest)
        times_y[inside, inside] = self.a[1:]
        times_y[inside[:-1], inside[1:]] = self.b[2:]
        out = np.eye(size)
        for h in inside:
            out[:, h + 1] = times_y @ out[:, h]
        return out * self.scale ** np.arange(size)


class OrthogonalPowers(Monomials):
    """Products P_h(v) Q_j(s) that span the powers v^h s^j, orthogonal on a sample of the motion."""

    def __init__(self, exponents: Iterable[tuple[int, int]], v: np.ndarray, s: np.ndarray) -> None:
        super().__init__(exponents)
        self._v, self._s = (
            Polynomials(x, max((p[i] for p in self.exponents), default=0)) for i, x in enumerate((v, s))
        )

    def terms(self) -> tuple[Term, ...]:
        """One term for each product."""
        return tuple(Term(f"q_{h}_{j}", f"P{h}(v) Q{j}(s)", "N") for h, j in self.exponents)

    def features(self, motion: Motion, state: Any = None) -> np.ndarray:
        """Columns, by one multiplication each."""
        return self._products(self._v(motion.v), self._s(motion.s))

    def recurrence(self) -> tuple[list[tuple[int, int, int, int]], list[tuple[float, float, float]]]:
        """Along s from one column to the next, and along v where there is no s."""
        place = {pair: i for i, pair in enumerate(self.exponents)}
        rows, numbers = [], []
        for (h, j), i in place.items():
            along, k = (self._s, j) if j else (self._v, h)
            below, second = ((h, j - n) if j else (h - n, 0) for n in (1, 2))
            rows.append((i, int(j > 0), place.get(below, -1), place[second] if k > 2 else -1))
            numbers.append((1.0 / along.scale, -float(along.a[k - 1]), -float(along.b[k - 1]) if k > 2 else 0.0))
        return rows, numbers

    @property
    def change(self) -> np.ndarray:
        """The columns times this are the powers, shape (n_terms, n_terms)."""
        h, j = np.array(self.exponents).reshape(-1, 2).T
        return self._v.powers[np.ix_(h, h)] * self._s.powers[np.ix_(j, j)]


_ROWS = 2048  # sampled for the bases of the sites
_SOUND = 1e3  # condition number of unit columns whose Gram matrix keeps the digits that are asked for
EVERY = "every"  # stands for all folds, stacked
PIECES = 20  # at least, over all records: blocks for the effective number of samples


@dataclass
class Order:
    """One candidate: an order at every storey, and where its columns stand among those of all candidates."""

    layout: LawLayout
    columns: dict[Site, np.ndarray]
    _groups: dict[SolveOrder, list[Group]] = field(default_factory=dict, init=False, repr=False)
    _index: dict[Group, np.ndarray] = field(default_factory=dict, init=False, repr=False)

    def groups(self, solve_order: SolveOrder) -> list[Group]:
        """Groups of columns a solve order needs."""
        if solve_order not in self._groups:
            self._groups[solve_order] = groups_of(self.layout, solve_order)
        return self._groups[solve_order]

    def index(self, group: Group, whole: BlockGrams) -> np.ndarray:
        """Where the columns of a group stand among those of all candidates."""
        if group not in self._index:
            where, *others = whole.positions(group.dofs)
            own = [where[s].start + self.columns[s] for s in group.sites if s in self.columns]
            self._index[group] = np.concatenate([*own, np.array([i for i in others if i is not None])])
        return self._index[group]

    @property
    def n_terms(self) -> int:
        """Number of terms of all sites."""
        return self.layout.n_terms


class FoldMoments:
    """Gram matrices of the pieces into which the folds cut the data, of all orders that will be asked for."""

    def __init__(
        self, chain: Chain, laws: Mapping[Site, Sequence[ForceLaw]], orders: Mapping[Site, Iterable[Any]],
        data: SegmentSet, folds: Sequence[tuple[np.ndarray, np.ndarray]], filters: Sequence[Any],
        known_masses: Mapping[int, float], strategy: str, inner: Any = None,
    ) -> None:  # fmt: skip
        self.chain, self.laws = chain, {s: tuple(held) for s, held in laws.items()}
        self.data, self.filters, self.inner = data, filters, inner
        self.known_masses, self.strategy = dict(known_masses), strategy
        terms = {site: [pair for order in given for pair in exponents_of(order)] for site, given in orders.items()}
        self.union = {site: Monomials(pairs) for site, pairs in terms.items()}
        self.layout = LawLayout(chain, {**{s: (law,) for s, law in self.union.items()}, **self.laws})
        self.groups = self._groups()
        self.basis: dict[Site, OrthogonalPowers] = {}
        self.factors: dict[Site, np.ndarray] = {}
        self._choose_bases()
        self.accumulated = LawLayout(chain, {**{s: (law,) for s, law in self.basis.items()}, **self.laws})
        self.class_of, self.membership = _classes(data.n_samples, folds)
        self.n_folds = len(folds)
        self._solve_orders: dict[Any, SolveOrder] = {}
        self._accumulate("gram")

    def _groups(self) -> list[Group]:
        solve_order = plan_solve_order(
            self.chain, self.data.forced, self.data.unknown, self.known_masses, self.strategy, self.layout.acting
        ).require_complete()
        n = self.chain.n_dof
        # sums of balances that a fold may need, in which some DOF is not forced
        sums = [tuple(range(i, n + 1)) for i in range(1, n) if all(j in self.known_masses for j in range(i, n + 1))]
        held = {g.dofs: g for g in groups_of(self.layout, solve_order)}
        return [*held.values(), *(self.layout.group(dofs) for dofs in sums if dofs not in held)]

    def _choose_bases(self) -> None:
        """Polynomials for each searched site from some rows, and the triangular factor of what they leave dependent."""
        whole = sum(seg.n_valid for seg in self.data.segments)
        stride = max(1, whole // _ROWS)
        for site, law in self.union.items():
            if not self.layout.counts[site]:
                continue
            parts = [seg.motion(site, slice(seg.valid.start, seg.valid.stop, stride)) for seg in self.data.segments]
            sample = Motion(np.concatenate([part.s for part in parts]), np.concatenate([part.v for part in parts]))
            self.basis[site] = OrthogonalPowers(law.exponents, sample.v, sample.s)
            columns = self.basis[site].features(sample)
            if not _sound(columns):
                self.factors[site] = _factor(columns)

    def _whiten(self, block: Block) -> Block:
        if not self.factors:
            return block
        terms = np.array(block.terms, order="C")
        for site, upper in self.factors.items():
            where = self.accumulated.slices[site]
            terms[where] = blas.dtrsm(1.0, upper, terms[where].T, side=1, lower=0).T
        return Block(terms, block.acceleration, block.force)

    def _back(self, dofs: tuple[int, ...]) -> np.ndarray:
        """Accumulated columns of a group times this are its monomials."""
        if dofs not in self._backs:
            group, blocks = next(g for g in self.groups if g.dofs == dofs), []
            for site in group.sites:
                change = self.basis[site].change if site in self.basis else np.eye(self.layout.counts[site])
                whitened = site in self.factors and self.kind == "gram"
                blocks.append(self.factors[site] @ change if whitened else change)
            self._backs[dofs] = linalg.block_diag(*blocks, np.eye(2 if len(group.dofs) == 1 else 1))
        return self._backs[dofs]

    def _accumulate(self, kind: str) -> None:
        self.kind = kind
        self._backs: dict[tuple[int, ...], np.ndarray] = {}
        groups = [self.accumulated.group(g.dofs) for g in self.groups]
        self.piece_class: list[int] = []
        self.sums: list[np.ndarray] = []  # of the accelerations, for the variance behind R^2
        self.counts: list[np.ndarray] = []
        self._totals: dict[Any, tuple[BlockGrams, np.ndarray, np.ndarray]] = {}
        self.pieces = GramPass(self.accumulated, groups, self.known_masses, kind).add_each(self._blocks()).grams()

    def _blocks(self) -> Iterator[tuple[int, Block]]:
        """All samples, and the number of the piece they belong to."""
        whole = sum(seg.n_valid for seg in self.data.segments)
        for seg, filter in zip(self.data.segments, self.filters):
            classes = self.class_of[seg.rows][seg.valid]
            cuts = _cuts(classes, max(whole // PIECES, 256) if self.kind == "gram" else whole)
            shuffled: dict[int, int] = {}  # piece of each class
            blocks = seg.blocks(self.accumulated, filter=filter)
            if self.kind == "gram":
                blocks = map(self._whiten, blocks)
            if cuts is not None:
                first = len(self.piece_class)
                for low in cuts:
                    self._open(int(classes[low]))
                yield from (self._counted(*part) for part in cut_at(cuts, blocks, first))
                continue
            at = 0
            for block in blocks:
                here = classes[at : at + block.n_samples]
                for code in np.unique(here):
                    if code not in shuffled:
                        shuffled[code] = self._open(int(code))
                    yield self._counted(shuffled[code], block.take(here == code))
                at += block.n_samples

    def _open(self, code: int) -> int:
        self.piece_class.append(code)
        self.sums.append(np.zeros(self.chain.n_dof))
        self.counts.append(np.zeros(self.chain.n_dof))
        return len(self.piece_class) - 1

    def _counted(self, piece: int, block: Block) -> tuple[int, Block]:
        """A block of a piece, with its accelerations summed up and its samples counted."""
        n, known = block.n_samples, np.array(block.known)
        self.sums[piece] += np.where(known, block.acceleration @ np.ones(n), 0.0)
        self.counts[piece] += known * n
        return piece, block

    def sharpen(self) -> None:
        """Accumulate once more by streamed QR, where the residual is too small for a Gram matrix."""
        if self.kind == "gram":
            self._accumulate("root")

    def total(self, fold: Any, side: str = "train") -> tuple[BlockGrams, np.ndarray, np.ndarray]:
        """Roots of one side of a fold, sums of accelerations and counts; None: of all samples, EVERY: stacked."""
        key = (fold, side)
        if key not in self._totals:
            if fold is None:
                wanted = np.ones((1, len(self.pieces)))
            else:
                chosen = self.membership[self.piece_class] == {"train": 1, "test": 2}[side]
                wanted = 1.0 * chosen.T[slice(None) if fold == EVERY else [fold]]
            empty = np.flatnonzero(~wanted.any(axis=1))
            if empty.size:
                number = empty[0] if fold == EVERY else fold
                raise ChannelError(f"Fold {number} has no {side} samples", "Check the splitter.")
            found = self._sums(wanted), wanted @ np.array(self.sums), wanted @ np.array(self.counts)
            self._totals[key] = found if fold == EVERY else (found[0][0], found[1][0], found[2][0])
        return self._totals[key]

    def sum_of(self, pieces: Iterable[int]) -> BlockGrams:
        """Roots of some pieces, in the monomials themselves; a piece may be there several times."""
        return self._sums(np.bincount(list(pieces), minlength=len(self.pieces))[None].astype(float))[0]

    def _sums(self, wanted: np.ndarray) -> BlockGrams:
        """Roots of the monomials, each the sum of so many times each piece."""
        return self.pieces.sum(wanted).roots().transformed(self.layout, {g: self._back(g.dofs) for g in self.groups})

    def order(self, orders: Mapping[Site, Any]) -> Order:
        """A candidate with an order at every searched site."""
        laws = {**{s: (PowerSeries(o),) for s, o in orders.items()}, **self.laws}
        layout = LawLayout(self.chain, laws)
        columns = {
            s: self.union[s].positions(orders[s]) if s in self.union else np.arange(layout.counts[s])
            for s in layout.acting
        }
        return Order(layout, columns)

    def cut(self, total: BlockGrams, order: Order, groups: Sequence[Group]) -> BlockGrams:
        """A candidate's own columns."""
        return total.transformed(order.layout, {g: order.index(g, total) for g in groups})

    def solve_order(self, total: BlockGrams, order: Order, inner: Any = None) -> SolveOrder:
        """The solve that the forces in some samples and an optimizer allow."""
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
        key = tuple(forced), tuple(unknown), order.layout.acting, inner is not None
        if key not in self._solve_orders:
            known = self.known_masses, self.strategy
            self._solve_orders[key] = plan_solve_order(self.chain, *key[:2], *known, *key[2:])
        return self._solve_orders[key].require_complete()

    def fit(
        self, order: Order, fold: Any, inner: Any = None, total: BlockGrams | None = None
    ) -> tuple[Solution, SolveOrder, BlockGrams]:
        """Solve one candidate on the training side of a fold."""
        total, inner = self.total(fold)[0] if total is None else total, inner or self.inner
        solve_order = self.solve_order(total, order, inner)
        own = self.cut(total, order, order.groups(solve_order))
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            return solve(own, solve_order, self.known_masses, inner), solve_order, own

    def piece_norms(self, order: Order, dofs: tuple[int, ...], weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squared length of a combination of a candidate's columns in each piece, and the samples behind it."""
        group = next(g for g in self.groups if g.dofs == dofs)
        back = self._back(dofs)
        whole = np.zeros(back.shape[1])
        whole[order.index(group, self.total(None)[0])] = weights
        return self.pieces.norms(dofs, (back @ whole)[:, None])[:, 0] ** 2, self.pieces.sizes[dofs]


def _factor(columns: np.ndarray) -> np.ndarray:
    """Triangular factor of some columns that can be divided by."""
    upper = np.zeros((columns.shape[1],) * 2)
    found = linalg.qr(columns, mode="r", check_finite=False)[0][: len(upper)]
    upper[: len(found)] = found
    least = 1e-9 * np.linalg.norm(upper, axis=0)
    least[least == 0] = 1.0  # nothing moves
    np.fill_diagonal(upper, np.where(np.abs(np.diag(upper)) > least, np.diag(upper), least))
    return upper


def _sound(columns: np.ndarray) -> bool:
    """Whether columns of unit length are far from dependent."""
    gram = columns.T @ columns
    size = np.sqrt(np.diag(gram))
    if not size.all():
        return False
    squares = np.linalg.eigvalsh(gram / size / size[:, None])  # of the singular values
    return bool(squares[-1] < _SOUND**2 * squares[0])


def _classes(size: int, folds: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Class of each row, and on which side of each fold (0 out, 1 train, 2 test) a class is."""
    sides, changes = [], np.zeros(size, dtype=bool)
    changes[:1] = True
    for train, test in folds:
        side = np.zeros(size, dtype=np.int8)
        side[train] = 1
        if side[test].any():
            raise NRFError("A fold tests on samples it was trained with", "Check the splitter.")
        side[test] = 2
        sides.append(side)
        changes[1:] |= side[1:] != side[:-1]
    starts = np.flatnonzero(changes)
    code, membership = np.zeros(len(starts), dtype=np.int64), np.zeros((1, 0), dtype=np.int8)
    for side in sides:
        code, unique = pd.factorize(code * 3 + side[starts])
        membership = np.column_stack([membership[unique // 3], (unique % 3).astype(np.int8)])
    return np.repeat(code, np.diff(starts, append=size)), membership


def _cuts(classes: np.ndarray, longest: int) -> np.ndarray | None:
    """Where pieces start, or None if the folds are too fine to be cut into pieces."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(classes)) + 1])
    if len(starts) > 8 and len(classes) / len(starts) < 64:
        return None
    ends = ((lo, hi, max(1, round((hi - lo) / longest))) for lo, hi in zip(starts, [*starts[1:], len(classes)]))
    return np.concatenate([np.linspace(*part, endpoint=False).astype(int) for part in ends])
