"""Products of the columns of all equations of motion, piece by piece of a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from ...chain.layout import LawLayout
from ...chain.sites import Site
from ...equations.accumulation import pieces_of
from ...equations.normal_equations import NormalEquations
from ...records.dataset import Dataset, Segment
from ..problem import Problem

# What an equation leaves, as a share of its right-hand side, below which it weighs as
# much as any: sensors are not calibrated better (as in ``equations.chain_solve``).
BEST_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class EquationSums:
    """Products of one equation of motion, piece by piece.

    Attributes
    ----------
    products : ndarray of shape (n_pieces, p + 1, p + 1)
        Of its columns with the signs of their sites, and of its right-hand side, last.
    places : ndarray of shape (p,)
        Numbers of its columns among the unknowns of the chain.
    n_samples : float
    """

    products: np.ndarray
    places: np.ndarray
    n_samples: float

    def residual(self, coefficients: np.ndarray) -> float:
        """Mean square that coefficients leave; (n_pieces, n_unknowns), over time."""
        weights = np.column_stack(
            [-coefficients[:, self.places], np.ones(len(coefficients))]
        )
        images = np.matmul(self.products, weights[:, :, None])[:, :, 0]
        return max(float(np.sum(images * weights)), 0.0) / self.n_samples

    @cached_property
    def by_product(self) -> np.ndarray:
        """The products, one row for each pair of columns, (., n_pieces)."""
        flat = self.products.reshape(len(self.products), -1)
        return np.ascontiguousarray(flat.T)

    @cached_property
    def size(self) -> float:
        """Mean square of the right-hand side."""
        return float(self.products[:, -1, -1].sum()) / self.n_samples


@dataclass(frozen=True, eq=False)
class EquationAlongRun(EquationSums):
    """Products of one equation of motion along a free run.

    Its right-hand side is what coefficients ask for along the run, and what they leave
    along the measured motion.

    Attributes
    ----------
    both : ndarray of shape (n_pieces, 2 p + 1, 2 p + 1)
        Of the columns of the run, those of the measured motion, and its right-hand
        side.
    """

    both: np.ndarray

    @classmethod
    def of(
        cls,
        both: np.ndarray,
        places: np.ndarray,
        n_samples: float,
        coefficients: np.ndarray,
    ) -> EquationAlongRun:
        """With coefficients (n_pieces, n_unknowns) of all unknowns."""
        here = coefficients[:, places]
        n_columns = len(places)
        change = np.zeros((len(here), 2 * n_columns + 1, n_columns + 1))
        change[:, :n_columns, :n_columns] = np.eye(n_columns)
        change[:, :n_columns, -1] = here
        change[:, n_columns:-1, -1] = -here
        change[:, -1, -1] = 1.0
        products = change.swapaxes(1, 2) @ both @ change
        return cls(products, places, n_samples, both)

    def with_coefficients(self, coefficients: np.ndarray) -> EquationAlongRun:
        """The same with other coefficients."""
        return self.of(self.both, self.places, self.n_samples, coefficients)

    @property
    def crossed(self) -> np.ndarray:
        """Products of the columns of the run with those of the measured motion."""
        n_columns = len(self.places)
        return self.both[:, :n_columns, n_columns:]


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Numbers of the unknowns of a chain: free masses, then the terms of the sites.

    Attributes
    ----------
    layout : LawLayout
    known_masses : mapping of int to float
        kg, by DOF.
    """

    layout: LawLayout
    known_masses: Mapping[int, float]

    @classmethod
    def of(cls, problem: Problem) -> Unknowns:
        """The unknowns of a problem."""
        return cls(problem.layout, problem.known_masses)

    @property
    def free_masses(self) -> list[int]:
        """DOFs whose mass is unknown."""
        dofs = range(1, self.layout.n_dof + 1)
        return [j for j in dofs if j not in self.known_masses]

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return len(self.free_masses) + self.layout.n_terms

    def of_mass(self, dof: int) -> int:
        """Number of a free mass."""
        return self.free_masses.index(dof)

    def of_site(self, site: Site) -> np.ndarray:
        """Numbers of the terms of a site."""
        terms = self.layout.slices[site]
        return len(self.free_masses) + np.arange(terms.start, terms.stop)


def equation_sums(
    problem: Problem, data: Dataset, edges: np.ndarray
) -> list[EquationSums]:
    """Products of every equation of motion whose force is known.

    Parameters
    ----------
    problem : Problem
    data : Dataset
        Of one record.
    edges : ndarray of shape (n_pieces + 1,)
        Ends of the pieces, in valid samples.
    """
    unknowns = Unknowns.of(problem)
    sums = _sums_of_pieces(problem, data, edges)
    equations = []
    for dofs in _known_equations(sums):
        combine, numbers = _combination(sums, unknowns, dofs)
        products = combine.T @ sums.matrices[dofs] @ combine
        n_samples = float(np.sum(sums.sizes[dofs]))
        equations.append(EquationSums(products, numbers, n_samples))
    return equations


def equation_sums_along(
    problem: Problem,
    data: Dataset,
    edges: np.ndarray,
    run: Segment,
    coefficients: np.ndarray,
) -> list[EquationAlongRun]:
    """The same along a free run, with the residuals along the measured motion.

    Parameters
    ----------
    problem, data, edges
        As for :func:`equation_sums`.
    run : Segment
    coefficients : ndarray of shape (n_pieces, n_unknowns)
        Of the run.
    """
    unknowns = Unknowns.of(problem)
    sums = _sums_of_pieces(problem, data, edges, run)
    equations = []
    for dofs in _known_equations(sums):
        combine, numbers = _combination(sums, unknowns, dofs)
        # of the run the equation has no right-hand side
        both = linalg.block_diag(combine[:-1, :-1], combine)
        order = np.roll(np.arange(len(both)), len(combine) - 1)
        products = both.T @ sums.matrices[dofs][:, order[:, None], order] @ both

        n_samples = float(np.sum(sums.sizes[dofs]))
        equations.append(
            EquationAlongRun.of(products, numbers, n_samples, coefficients)
        )
    return equations


def _sums_of_pieces(
    problem: Problem, data: Dataset, edges: np.ndarray, run: Segment | None = None
) -> NormalEquations:
    """Products of all equations of motion, the columns of a run behind them."""
    layout = problem.layout
    return pieces_of(
        data,
        layout,
        [layout.group((dof,)) for dof in range(1, layout.n_dof + 1)],
        problem.filters(data),
        problem.known_masses,
        None if run is None else [run],
        edges=[edges],
    ).squares()


def _known_equations(sums: NormalEquations) -> list[tuple[int, ...]]:
    """Equations whose forces are known."""
    return [dofs for dofs in sums.groups if np.sum(sums.sizes[dofs]) > 0]


def _combination(
    sums: NormalEquations, unknowns: Unknowns, dofs: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Columns of one equation with their signs, a known mass on the right-hand side.

    Returns
    -------
    combine : ndarray of shape (n_columns, p + 1)
    numbers : ndarray of shape (p,)
        Among the unknowns of the chain.
    """
    places = sums.positions(dofs)
    group = sums.groups[dofs]
    n_columns = places.target + 1
    target = np.zeros(n_columns)
    target[places.target] = 1.0

    columns = []
    numbers = []
    signs = []
    dof = dofs[0]
    assert places.mass is not None  # a single equation has its mass
    if dof in unknowns.known_masses:
        target[places.mass] = -unknowns.known_masses[dof]
    else:
        columns.append(places.mass)
        numbers.append(unknowns.of_mass(dof))
        signs.append(1)
    for site, sign in zip(group.sites, group.signs):
        of_site = unknowns.of_site(site)
        columns.extend(range(places.sites[site].start, places.sites[site].stop))
        numbers.extend(of_site.tolist())
        signs.extend([sign] * len(of_site))

    combine = np.zeros((n_columns, len(columns) + 1))
    combine[columns, np.arange(len(columns))] = signs
    combine[:, -1] = target
    return combine, np.array(numbers, dtype=int)


def weighted_products(
    equations: Sequence[EquationSums], weights: np.ndarray, n_unknowns: int
) -> np.ndarray:
    """Products of all equations together, (n_pieces, n_unknowns + 1, n_unknowns + 1).

    ``weights`` are one over the mean square that each equation leaves.
    """
    n_pieces = len(equations[0].products)
    size = n_unknowns + 1
    # one row for each product of two unknowns, which lie beside each other in memory
    total = np.zeros((size * size, n_pieces))
    for equation, weight in zip(equations, weights):
        places = np.append(equation.places, n_unknowns)
        rows = (places[:, None] * size + places).ravel()
        total[rows] += weight * equation.by_product
    return np.ascontiguousarray(total.T).reshape(n_pieces, size, size)


def weighted_crossed(
    equations: Sequence[EquationAlongRun], weights: np.ndarray, n_unknowns: int
) -> np.ndarray:
    """Products of the columns of a run with the measured ones, of all equations.

    Returns
    -------
    ndarray of shape (n_pieces, n_unknowns, n_unknowns + 1)
    """
    n_pieces = len(equations[0].crossed)
    total = np.zeros((n_pieces, n_unknowns, n_unknowns + 1))
    for equation, weight in zip(equations, weights):
        places = np.append(equation.places, n_unknowns)
        total[:, equation.places[:, None], places] += weight * equation.crossed
    return total


def weights_of(
    equations: Sequence[EquationSums], coefficients: np.ndarray
) -> np.ndarray:
    """One over the mean square that coefficients leave of each equation."""
    residuals = []
    for equation in equations:
        least = BEST_SHARE**2 * equation.size
        residuals.append(max(equation.residual(coefficients), least))
    return 1.0 / np.array(residuals)


def deviance_of(equations: Sequence[EquationSums], coefficients: np.ndarray) -> float:
    """Minus twice the logarithm of the likelihood of white noise, up to a constant."""
    total = 0.0
    for equation in equations:
        least = BEST_SHARE**2 * equation.size
        residual = max(equation.residual(coefficients), least)
        total += equation.n_samples * np.log(residual)
    return total
