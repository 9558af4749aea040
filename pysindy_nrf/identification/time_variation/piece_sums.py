"""Products of the columns of all equations of motion, piece by piece of a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...chain.layout import LawLayout
from ...chain.sites import Site
from ...equations.accumulation import pieces_of
from ...equations.normal_equations import NormalEquations
from ...records.dataset import Dataset
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
        squares = np.einsum("pi,pij,pj->", weights, self.products, weights)
        return max(float(squares), 0.0) / self.n_samples

    @property
    def size(self) -> float:
        """Mean square of the largest column or of the right-hand side."""
        power = np.einsum("pii->i", self.products)
        return float(power[-1]) / self.n_samples


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
) -> tuple[Unknowns, list[EquationSums]]:
    """Products of every equation of motion whose force is known.

    Parameters
    ----------
    problem : Problem
    data : Dataset
        Of one record.
    edges : ndarray of shape (n_pieces + 1,)
        Ends of the pieces, in valid samples.
    """
    layout = problem.layout
    unknowns = Unknowns(layout, problem.known_masses)
    groups = [layout.group((dof,)) for dof in range(1, layout.n_dof + 1)]
    sums = pieces_of(
        data, layout, groups, problem.filters(data), problem.known_masses, edges=[edges]
    ).squares()
    equations = [
        _of_equation(sums, unknowns, group.dofs)
        for group in groups
        if np.sum(sums.sizes[group.dofs]) > 0
    ]
    return unknowns, equations


def _of_equation(
    sums: NormalEquations, unknowns: Unknowns, dofs: tuple[int, ...]
) -> EquationSums:
    """Products of one equation, a known mass on the right-hand side."""
    places = sums.positions(dofs)
    group = sums.groups[dofs]
    n_columns = sums.matrices[dofs].shape[-1]
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
    products = combine.T @ sums.matrices[dofs] @ combine
    return EquationSums(
        products, np.array(numbers, dtype=int), float(np.sum(sums.sizes[dofs]))
    )


def weighted_products(
    equations: list[EquationSums], weights: np.ndarray, n_unknowns: int
) -> np.ndarray:
    """Products of all equations together, (n_pieces, n_unknowns + 1, n_unknowns + 1).

    ``weights`` are one over the mean square that each equation leaves.
    """
    n_pieces = len(equations[0].products)
    total = np.zeros((n_pieces, n_unknowns + 1, n_unknowns + 1))
    for equation, weight in zip(equations, weights):
        places = np.append(equation.places, n_unknowns)
        total[:, places[:, None], places] += weight * equation.products
    return total


def weights_of(equations: list[EquationSums], coefficients: np.ndarray) -> np.ndarray:
    """One over the mean square that coefficients leave of each equation."""
    residuals = []
    for equation in equations:
        least = BEST_SHARE**2 * equation.size
        residuals.append(max(equation.residual(coefficients), least))
    return 1.0 / np.array(residuals)


def deviance_of(equations: list[EquationSums], coefficients: np.ndarray) -> float:
    """Minus twice the logarithm of the likelihood of white noise, up to a constant."""
    total = 0.0
    for equation in equations:
        least = BEST_SHARE**2 * equation.size
        residual = max(equation.residual(coefficients), least)
        total += equation.n_samples * np.log(residual)
    return total
