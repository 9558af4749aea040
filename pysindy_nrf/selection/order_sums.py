"""Normal equations of all orders, fold by fold, from one pass over the samples."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.linalg import blas

from ..chain.identifiability import SolveOrder, plan_solve_order
from ..chain.layout import Block, Group, LawLayout
from ..chain.sites import Site
from ..equations.accumulation import ProductSums
from ..equations.balances import blocks_of_segment
from ..equations.chain_solve import NotTogether, Solution, solve
from ..equations.normal_equations import NormalEquations, groups_of
from ..exceptions import RankWarning
from ..identification.problem import Problem
from ..laws.base import ForceLaw
from ..laws.power_series import PowerSeries, exponents_of
from ..records.dataset import Dataset, Segment
from ..records.zero_phase_filter import ZeroPhaseFilter
from .folds import TEST, TRAIN, Fold, FoldClasses
from .one_se_rule import Degree

# Samples that make the powers of a site orthogonal.
N_SAMPLED = 2048
# Share of a column's length below which it depends on those before it.
DEPENDENT = 1e-9


class Monomials(PowerSeries):
    """Terms v^h s^j of a given list of exponents, as in a power series."""

    def __init__(self, exponents: Iterable[tuple[int, int]]) -> None:
        distinct = set(exponents)
        self.exponents = tuple(sorted(distinct, key=lambda p: (p[0] + p[1], -p[0])))
        self.degree = max(map(sum, self.exponents), default=0)
        ForceLaw.__init__(self, {}, None)

    def positions(self, order: Degree) -> np.ndarray:
        """Where the terms of one order stand among these."""
        return np.array([self.exponents.index(pair) for pair in exponents_of(order)])


@dataclass(frozen=True, eq=False)
class Order:
    """One candidate: laws, and which columns of all candidates are theirs.

    Attributes
    ----------
    layout : LawLayout
    columns : dict of Site to ndarray
        Numbers of the columns among those of the site.
    """

    layout: LawLayout
    columns: dict[Site, np.ndarray]


@dataclass(frozen=True)
class FoldSide:
    """Sums over one side of a fold, or over that of every fold, stacked.

    Attributes
    ----------
    grams : NormalEquations
        Roots, of the columns of all candidates.
    acceleration_sums, counts : ndarray of shape (..., n_dof)
        Sums of accelerations, and the samples in which the force of a DOF is known: for
        the variance behind R^2.
    """

    grams: NormalEquations
    acceleration_sums: np.ndarray
    counts: np.ndarray


# DOFs that are forced, DOFs whose force is unknown, sites at which laws act.
_Excitation = tuple[tuple[int, ...], tuple[int, ...], tuple[Site, ...]]


class OrderSums:
    """Sums of the samples that are on the same sides of all folds, for all orders.

    Parameters
    ----------
    problem : Problem
        Chain, known masses, strategy and optimizer.
    laws : mapping of Site to sequence of ForceLaw
        Sites whose laws are given.
    orders : sequence of int or (int, int)
        Orders that will be asked for at every other site.
    data : Dataset
    folds : sequence of (ndarray, ndarray)
    """

    def __init__(
        self,
        problem: Problem,
        laws: Mapping[Site, Sequence[ForceLaw]],
        orders: Sequence[Degree],
        data: Dataset,
        folds: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> None:
        self.problem = problem
        self.chain = problem.chain
        self.laws = {site: tuple(group) for site, group in laws.items()}
        self.data = data
        self.filters = problem.filters(data)
        self.folds = FoldClasses(data.n_samples, folds)

        exponents = [pair for order in orders for pair in exponents_of(order)]
        searched = [site for site in self.chain.sites if site not in self.laws]
        self.union = {site: Monomials(exponents) for site in searched}
        series = {site: (law,) for site, law in self.union.items()}
        self.layout = LawLayout(self.chain, {**series, **self.laws})
        self._solve_orders: dict[_Excitation, SolveOrder] = {}
        self._sides: dict[tuple[Fold, int], FoldSide] = {}
        self._sum_up()

    def _sum_up(self) -> None:
        """Read the samples once: sums by class."""
        shape = (self.folds.n_classes, self.chain.n_dof)
        self._acceleration_sums = np.zeros(shape)
        self._counts = np.zeros(shape)
        known_masses = self.problem.known_masses
        sums = ProductSums(
            self.layout, self.groups, known_masses, n_blocks=self.folds.n_classes
        )
        self.pieces = sums.add_each(self._blocks()).grams()

    @cached_property
    def groups(self) -> list[Group]:
        """Groups of columns that a fold may need.

        In a fold some DOF may not be forced, and sums of equations above it are solved.
        """
        order = plan_solve_order(
            self.chain,
            self.data.forced,
            self.data.unknown,
            self.problem.known_masses,
            self.problem.strategy,
            self.layout.acting,
        ).require_complete()
        groups = groups_of(self.layout, order)
        n_dof = self.chain.n_dof
        for first in range(1, n_dof):
            dofs = tuple(range(first, n_dof + 1))
            weighed = all(dof in self.problem.known_masses for dof in dofs)
            if weighed and self.layout.group(dofs) not in groups:
                groups.append(self.layout.group(dofs))
        return groups

    @cached_property
    def _factors(self) -> dict[Site, np.ndarray]:
        """By searched site the factor that makes its powers orthogonal.

        It is found on some of the samples.
        """
        n_samples = sum(segment.n_valid for segment in self.data.segments)
        stride = max(1, n_samples // N_SAMPLED)
        factors = {}
        for site, law in self.union.items():
            if self.layout.counts[site]:
                columns = []
                for segment in self.data.segments:
                    rows = slice(segment.valid.start, segment.valid.stop, stride)
                    columns.append(law.features(segment.motion(site, rows)))
                factors[site] = _regular_factor(np.concatenate(columns))
        return factors

    def _blocks(self) -> Iterator[tuple[int, Block]]:
        """All samples, and the class they belong to."""
        for segment, filter in zip(self.data.segments, self.filters):
            classes = self.folds.class_of[segment.rows][segment.valid]
            start = 0
            for block in self._orthogonal_blocks(segment, filter):
                of_block = classes[start : start + block.n_samples]
                start += block.n_samples
                for number in np.unique(of_block).tolist():
                    of_class = block.take(of_block == number)
                    self._count(number, of_class)
                    yield number, of_class

    def _count(self, number: int, block: Block) -> None:
        """Add up accelerations and samples of a class, for the variance behind R^2."""
        known = np.array(block.known)
        total = block.acceleration.sum(axis=1)
        self._acceleration_sums[number] += np.where(known, total, 0.0)
        self._counts[number] += known * block.n_samples

    def _orthogonal_blocks(
        self, segment: Segment, filter: ZeroPhaseFilter | None
    ) -> Iterator[Block]:
        """Blocks with the powers of each searched site divided by its factor.

        Products of orthogonal columns keep their digits.
        """
        for block in blocks_of_segment(segment, self.layout, filter=filter):
            for site, upper in self._factors.items():
                # in place: the columns of a block are its own
                columns = block.terms[self.layout.slices[site]].T
                blas.dtrsm(1.0, upper, columns, side=1, overwrite_b=1)
            yield Block(block.terms, block.acceleration, block.force)

    @cached_property
    def _back(self) -> dict[Group, np.ndarray]:
        """By group: the columns that were summed up times this are the powers."""
        changes = {}
        for group in self.groups:
            parts = []
            for site in group.sites:
                plain = np.eye(self.layout.counts[site])
                parts.append(self._factors.get(site, plain))
            parts.append(np.eye(2 if len(group.dofs) == 1 else 1))
            changes[group] = linalg.block_diag(*parts)
        return changes

    def side(self, fold: Fold, side: int) -> FoldSide:
        """Sums of one side of a fold; ``EVERY`` fold stacked, all samples for None."""
        key = (fold, side)
        if key not in self._sides:
            weights = self.folds.weights(fold, side, self.pieces.n_samples)
            if isinstance(fold, int) or fold is None:
                weights = weights[0]
            sums = self.pieces.sum(weights).roots()
            self._sides[key] = FoldSide(
                sums.transformed(self.layout, self._back),
                weights @ self._acceleration_sums,
                weights @ self._counts,
            )
        return self._sides[key]

    def order(self, orders: Mapping[Site, Degree]) -> Order:
        """A candidate with an order at every searched site."""
        series = {site: (PowerSeries(order),) for site, order in orders.items()}
        layout = LawLayout(self.chain, {**series, **self.laws})
        columns = {}
        for site in layout.acting:
            columns[site] = np.arange(layout.counts[site])
            if site in self.union:
                columns[site] = self.union[site].positions(orders[site])
        return Order(layout, columns)

    def uniform_order(self, order: Degree) -> Order:
        """A candidate with one order at every searched site."""
        return self.order(dict.fromkeys(self.union, order))

    def cut(
        self, total: NormalEquations, order: Order, solve_order: SolveOrder
    ) -> NormalEquations:
        """The columns of a candidate alone."""
        groups = groups_of(order.layout, solve_order)
        return total.with_terms(order.layout, order.columns, groups)

    def solve_order(self, total: NormalEquations, order: Order) -> SolveOrder:
        """The solve that the forces in some samples allow.

        Raises NotTogether where the folds of a stack need different ones.
        """
        forced: list[int] = []
        unknown: list[int] = []
        for dof in range(1, self.chain.n_dof + 1):
            force = total.matrices[(dof,)][..., -1]
            acts = _common(np.linalg.norm(force, axis=-1) > 0)
            if not _common(total.sizes[(dof,)] > 0):
                unknown.append(dof)
            elif acts:
                forced.append(dof)

        sparse = self.problem.optimizer is not None
        key = (tuple(forced), tuple(unknown), order.layout.acting)
        if key not in self._solve_orders:
            self._solve_orders[key] = plan_solve_order(
                self.chain,
                forced,
                unknown,
                self.problem.known_masses,
                self.problem.strategy,
                order.layout.acting,
                alone=sparse,
            )
        return self._solve_orders[key].require_complete()

    def fit(
        self, order: Order, fold: Fold
    ) -> tuple[Solution, SolveOrder, NormalEquations]:
        """Solve one candidate on the training side of a fold."""
        total = self.side(fold, TRAIN).grams
        solve_order = self.solve_order(total, order)
        grams = self.cut(total, order, solve_order)
        known_masses, optimizer = self.problem.known_masses, self.problem.optimizer
        with warnings.catch_warnings(action="ignore", category=RankWarning):
            solution = solve(grams, solve_order, known_masses, optimizer)
        return solution, solve_order, grams

    @property
    def fewest_equations(self) -> int:
        """Equations in the smallest training side, one for each sample and DOF."""
        sides = [self.side(fold, TRAIN) for fold in range(self.folds.n_folds)]
        return int(min(side.counts.sum() for side in sides))

    def held_out(self, fold: Fold) -> FoldSide:
        """Sums of the test side of a fold."""
        return self.side(fold, TEST)


def _common(answers: np.ndarray) -> bool:
    """One answer for all folds of a stack."""
    if np.any(answers) != np.all(answers):
        raise NotTogether()
    return bool(np.all(answers))


def _regular_factor(columns: np.ndarray) -> np.ndarray:
    """Triangular factor of some columns that can be divided by."""
    p = columns.shape[1]
    upper = np.zeros((p, p))
    factor = linalg.qr(columns, mode="r", check_finite=False)[0][:p]
    upper[: len(factor)] = factor

    least = DEPENDENT * np.linalg.norm(upper, axis=0)
    least[least == 0] = 1.0  # nothing moves
    pivots = np.diag(upper)
    np.fill_diagonal(upper, np.where(np.abs(pivots) > least, pivots, least))
    return upper
