"""A set of laws, every shape parameter with a value, fitted and judged fold by fold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..chain.sites import Site
from ..chain.structure import Chain
from ..diagnosis.offsets import Offsets, offsets_of, with_offsets
from ..equations.chain_solve import Solution, model_of
from ..equations.normal_equations import leave_one_out
from ..equations.protocol import ManySolver
from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..records.dataset import Dataset
from .error_reduction import (
    ErrorReduction,
    Powers,
    residual_share,
    unresolved_power,
)
from .search_data import SearchData
from .spectra import BalanceSpectra

LawsBySite = Mapping[Site, Sequence[ForceLaw]]
PlacedLaw = tuple[Site, ForceLaw]
# Sites of further columns, and their number at each.
SitesAndWidths = tuple[tuple[Site, int], ...]


@dataclass(frozen=True)
class FitSettings:
    """Numbers of the fits."""

    # Iterations of the weights of the bands; they settle in three or four.
    rounds: int = 6
    # Relative change of the weights below which they have settled.
    settled: float = 0.05
    # Weight that a fold keeps when it is left out. The change of the parameters is
    # taken for the rest of all: where one fold alone separates parameters (the
    # transient before a steady state), the others would extrapolate at random.
    weight_left_out: float = 0.1


FIT = FitSettings()


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Laws at the sites of a chain, fitted to spectra; :func:`fit_model` makes one.

    Attributes
    ----------
    base : Chain
        Before the sites of the laws were added to it.
    products : ndarray of shape (n_folds, n_bands, n_rows, n_rows)
        Of all rows: columns of the laws, accelerations, forces.
    weights : ndarray of shape (n_balances, n_bands)
        One over the power of the residual: bands full of noise do not count.
    masses, coefficients : ndarray of shape (n_folds + 1, ...)
        From all folds, then with each fold left out.
    powers : Powers
        On folds that the fit did not see.
    within : ndarray of shape (n_balances, n_bands)
        Power of the residual where all folds are fitted.
    solvers : dict
        Solves with further columns, by their sites and widths.
    """

    spectra: BalanceSpectra
    base: Chain
    layout: LawLayout
    solver: ManySolver
    products: np.ndarray
    weights: np.ndarray
    masses: np.ndarray
    coefficients: np.ndarray
    powers: Powers
    within: np.ndarray
    solvers: dict[SitesAndWidths, ManySolver] = field(default_factory=dict, repr=False)

    # -- what the model is made of ---------------------------------------------

    @property
    def chain(self) -> Chain:
        """The chain with the sites of all laws."""
        return self.layout.chain

    @property
    def laws(self) -> LawsBySite:
        """The laws by site, coefficients aside."""
        return self.layout.laws

    @property
    def first_fixed(self) -> int:
        """Row of a_1; those of all terms stand before it."""
        return self.layout.n_terms

    def with_laws(self, placed: Iterable[PlacedLaw]) -> FittedModel:
        """The model with further laws."""
        laws = dict(self.laws)
        for site, law in placed:
            laws[site] = (*laws.get(site, ()), law)
        return fit_model(self.spectra, self.base, laws)

    def without(self, site: Site, law: ForceLaw) -> FittedModel:
        """The model without one law."""
        remaining = list(self.laws[site])
        remaining.remove(law)
        return fit_model(self.spectra, self.base, {**self.laws, site: remaining})

    def refitted(self, spectra: BalanceSpectra) -> FittedModel:
        """The same laws fitted to other spectra."""
        return fit_model(spectra, self.base, self.laws)

    def on_motions(self, dataset: Dataset) -> FittedModel:
        """The same laws fitted to the same rows of other motions."""
        data = self.spectra.data.with_data(dataset)
        return self.refitted(self.spectra.of_records(data))

    def passive_terms(
        self, sites: Iterable[Site], has_memory: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Terms at some sites that a law added to them may not turn negative.

        These are springs of positive stiffness. With a law with memory they are
        dashpots, too: at frequencies outside the band a negative dashpot feeds more
        energy into the structure than the law takes out, and the free run grows.

        Parameters
        ----------
        sites : iterable of Site
        has_memory : bool
            Whether the law remembers its path.

        Returns
        -------
        columns : ndarray of int
        least : ndarray
            Least coefficient of each: zero, or that of a dashpot that is negative now.
        """
        labels = np.full(self.first_fixed, "", dtype=object)
        for site in set(sites) & set(self.layout.sites):
            column = self.layout.slices[site].start
            for law in self.laws.get(site, ()):
                for term in law.terms():
                    labels[column] = term.label
                    column += 1

        coefficients = self.coefficients[0, : self.first_fixed]
        passive = (labels == "s") & (coefficients > 0)
        if has_memory:
            passive |= labels == "v"
        columns = np.flatnonzero(passive)
        return columns, np.minimum(coefficients[columns], 0.0)

    # -- sums of the products --------------------------------------------------

    @cached_property
    def spectra_of_rows(self) -> np.ndarray:
        """Spectra of the columns of the laws, then of accelerations and forces."""
        return np.vstack(self.spectra.model_rows(self.layout))

    @cached_property
    def row_numbers(self) -> list[int]:
        """Numbers of these rows, the same in every model."""
        return self.spectra.row_numbers(self.layout)

    @cached_property
    def summed(self) -> np.ndarray:
        """Products summed over all folds, (n_bands, n_rows, n_rows)."""
        return self.products.sum(axis=0)

    @cached_property
    def weighted(self) -> np.ndarray:
        """Weighted sums over all folds and bands, (n_balances, n_rows, n_rows)."""
        return np.tensordot(self.weights, self.summed, 1)

    @cached_property
    def scan_shares(self) -> np.ndarray:
        """Residual over reference where all folds are fitted, by balance and band.

        A scan reads all folds, also those in which a force is unknown: both sides of a
        comparison hold them alike.
        """
        residual, reference = self.solver.rows(self.masses[:1], self.coefficients[:1])
        return residual_share(
            quadratic_forms(residual[0], self.summed),
            quadratic_forms(reference[0], self.summed),
        )

    # -- what came out ---------------------------------------------------------

    def chain_model(
        self, masses: np.ndarray | None = None, coefficients: np.ndarray | None = None
    ) -> ChainModel:
        """The fitted chain model, or that with given masses and coefficients."""
        return model_of(self.layout, self.solution(masses, coefficients))

    def solution(
        self, masses: np.ndarray | None = None, coefficients: np.ndarray | None = None
    ) -> Solution:
        """Masses and coefficients from all folds, or those that are given."""
        masses = self.masses[0] if masses is None else masses
        values = self.coefficients[0] if coefficients is None else coefficients
        by_site = {site: values[rows] for site, rows in self.layout.slices.items()}
        return Solution(dict(enumerate(masses.tolist(), 1)), by_site)

    @cached_property
    def offsets(self) -> Offsets:
        """Constants that the model leaves in the equations of motion.

        Of a record that is searched on the samples of the search, of any other on all:
        the zeros of sensors differ from test to test.
        """
        data = self.spectra.data
        pieces = data.pieces()
        for i, segment in enumerate(data.data.segments):
            if i not in data.searched:
                pieces.append((i, segment))
        return offsets_of(self.chain_model(), data.data, pieces)

    @cached_property
    def data_with_offsets(self) -> SearchData:
        """The records with the constants that the model leaves as known offsets."""
        data = self.spectra.data
        if not self.offsets:
            return data
        return data.with_data(with_offsets(data.data, self.offsets))

    @property
    def errors_within(self) -> np.ndarray:
        """Error of each balance on the samples of the fit, percent."""
        return self.spectra.errors(self.powers_within)

    @property
    def powers_within(self) -> Powers:
        """Powers on the samples of the fit."""
        return Powers(self.within[None], self.powers.reference)

    @property
    def error(self) -> float:
        """Error of all balances on folds that the fit did not see, percent."""
        return self.spectra.error(self.powers)

    @property
    def balance_errors(self) -> np.ndarray:
        """Error of each balance on folds that the fit did not see, percent."""
        return self.spectra.errors(self.powers)

    def reduction_from(self, other: FittedModel) -> ErrorReduction:
        """Error reduction from another model to this one."""
        informative = self.spectra.bands.informative
        return ErrorReduction.between(other.powers, self.powers, informative)

    def powers_on(self, spectra: BalanceSpectra) -> Powers:
        """Powers of the fitted model on other samples."""
        products = spectra.products(self.layout)
        residual, reference = self.solver.rows(self.masses[:1], self.coefficients[:1])
        known = spectra.used_folds(self.solver)[:, self.solver.judged, None]
        residual_power = quadratic_forms(residual[0], products)
        reference_power = quadratic_forms(reference[0], products)
        return Powers(
            np.where(known, np.maximum(residual_power, 0.0), 0.0),
            np.where(known, reference_power, 0.0).sum(axis=0),
        )


def fit_model(spectra: BalanceSpectra, chain: Chain, laws: LawsBySite) -> FittedModel:
    """Fit laws to the folds of a search, each fold judged by the others.

    Raises
    ------
    NRFError
        If the columns of the balances depend on each other.
    """
    acting = {site: tuple(there) for site, there in laws.items() if there}
    layout = LawLayout(chain.with_links(acting), acting)
    products = spectra.products(layout)
    where = {s: range(rows.start, rows.stop) for s, rows in layout.slices.items()}
    solver = spectra.solver(layout, where, layout.n_terms)
    problem = FoldProblem(spectra, solver, products)

    weights, within, reference = problem.settled_weights()
    masses, coefficients = problem.solve_folds(weights.used)
    powers = Powers(problem.judge_folds(masses, coefficients), reference)
    if not np.isfinite(powers.residual).all():
        raise NRFError(
            "The columns of the balances depend on each other", "Leave a law out."
        )
    return FittedModel(
        spectra,
        chain,
        layout,
        solver,
        products,
        weights.final,
        masses,
        coefficients,
        powers,
        within,
    )


@dataclass(frozen=True)
class BandWeights:
    """Weights of the bands: those of the last fit, and those that follow from it."""

    used: np.ndarray
    final: np.ndarray


class FoldProblem:
    """Fits of one set of columns to all folds and with each fold left out."""

    def __init__(
        self, spectra: BalanceSpectra, solver: ManySolver, products: np.ndarray
    ) -> None:
        self.informative = spectra.bands.informative
        self.solver = solver
        self.products = products
        # (n_folds, n_groups)
        self.used = spectra.used_folds(solver)

    def settled_weights(self) -> tuple[BandWeights, np.ndarray, np.ndarray]:
        """Weights of the bands, and the powers of residual and reference with them."""
        # what serves each group of balances
        products = np.tensordot(self.used.T, self.products, 1)
        weights = self.informative.astype(float)

        for _ in range(FIT.rounds):
            used = weights
            residual, reference = self._powers(used, products)
            floored = residual + unresolved_power(reference)
            counts = self.informative & (floored > 0)
            weights = np.where(counts, 1.0 / np.maximum(floored, 1e-300), 0.0)
            settled = np.allclose(weights, used, rtol=FIT.settled)
            if settled or not np.isfinite(residual).all():
                break

        return BandWeights(used, weights), residual, reference

    def _powers(self, weights: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Power of residual and reference where all folds are fitted.

        Shape (2, n_balances, n_bands).
        """
        by_group = for_groups(weights, self.solver)
        sums = np.einsum("uk,ukpq->upq", by_group, products, optimize=True)
        fit = self.solver.solve(sums[None])
        rows = np.concatenate(self.solver.rows(*fit))[:, :, None, None]
        power = ((rows @ products[self.solver.judged]) * rows).sum(axis=(-2, -1))
        return np.where(np.isfinite(power), np.maximum(power, 0.0), np.inf)

    def solve_folds(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Masses and coefficients from all folds, then as if each were left out."""
        sums = weighted_sums(self.products, weights, self.solver, self.used)
        return solve_folds(self.solver, sums)

    def judge_folds(self, masses: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Power of the residual on each fold, which the fit did not see.

        Shape (n_folds, n_balances, n_bands).
        """
        residual = self.solver.rows(masses[1:], coefficients[1:])[0][:, None]
        power = ((residual @ self.products) * residual).sum(axis=-1).swapaxes(1, 2)
        power = np.where(np.isfinite(power), np.maximum(power, 0.0), np.inf)
        return np.where(self.used[:, self.solver.judged, None], power, 0.0)


def for_groups(by_balance: np.ndarray, solver: ManySolver) -> np.ndarray:
    """Entries of each group of balances: those of the balance of its lowest DOF."""
    lowest = [group.dofs[0] - 1 for group in solver.groups]
    return by_balance[lowest]


def weighted_sums(
    products: np.ndarray,
    weights: np.ndarray,
    solver: ManySolver,
    used: np.ndarray,
) -> np.ndarray:
    """Products of each fold summed over the bands, for each group of balances.

    Shape (n_folds, n_groups, n_rows, n_rows).
    """
    by_group = for_groups(weights, solver)
    sums = np.einsum("uk,fkpq->fupq", by_group, products, optimize=True)
    return sums * used[:, :, None, None]


def solve_folds(solver: ManySolver, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masses and coefficients from all folds, then as if each had been left out."""
    weight = FIT.weight_left_out
    others = leave_one_out(sums) + weight * sums
    masses, coefficients = solver.solve(
        np.concatenate([sums.sum(axis=0)[None], others])
    )
    for values in (masses, coefficients):
        values[1:] += weight / (1.0 - weight) * (values[1:] - values[0])
    return masses, coefficients


def quadratic_forms(rows: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Power of combinations of rows (n, p) from products (..., n_bands, p, p).

    Shape (..., n, n_bands).
    """
    return np.einsum("ip,...kpq,iq->...ik", rows, products, rows, optimize=True)
