"""Grow a general law at a site: a sparse sum of the atoms of a class.

Atoms are added one by one, and earlier ones exchanged. All are columns of the same
products, so that a trial costs one small solve.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..chain.sites import Site
from ..equations.protocol import ManySolver
from ..laws.atoms import SumOfAtoms
from .error_reduction import ErrorReduction, Powers, mean_reduction, residual_share
from .fitted_model import FittedModel, FoldProblem, for_groups, quadratic_forms
from .model_extension import ModelExtension
from .signs import SIGNS


@dataclass(frozen=True)
class GrowthSettings:
    """When a general law is large enough."""

    # Cross-validated error reduction that a further atom must bring, dB, beside its own
    # standard error.
    least_addition: float = 0.25
    # The same for an exchange, dB.
    least_exchange: float = 0.05
    # Atoms of a law at most: two strengths of three sizes.
    max_atoms: int = 6
    # The best atoms on the samples of the fit, of which the best on left-out folds is
    # taken.
    finalists: int = 3


GROWTH = GrowthSettings()
Subset = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Trial:
    """A model with some atoms of a dictionary, fitted and judged fold by fold."""

    atoms: Subset
    weights: np.ndarray
    powers: Powers
    # Share that all folds leave where all are fitted, by balance and band.
    shares: np.ndarray


def grown_law(
    model: FittedModel, site: Site, dictionary: SumOfAtoms
) -> SumOfAtoms | None:
    """The sum of atoms that leaves least at a site; None if no atom helps.

    Parameters
    ----------
    model : FittedModel
        To which it is added.
    site : Site
    dictionary : SumOfAtoms
        A law of all atoms that may be chosen.
    """
    trials = AtomTrials(model, site, dictionary)
    current = trials.start()
    while len(current.atoms) < GROWTH.max_atoms:
        larger = trials.with_one_more(current)
        if larger is None:
            break
        current = trials.exchanged(larger)
    if not current.atoms:
        return None
    atoms = [dictionary.atoms[k] for k in sorted(current.atoms)]
    return type(dictionary)(atoms)


class AtomTrials:
    """Fits of a model with some atoms of a dictionary at a site.

    Parameters
    ----------
    model : FittedModel
    site : Site
    dictionary : SumOfAtoms
    """

    def __init__(self, model: FittedModel, site: Site, dictionary: SumOfAtoms) -> None:
        self.model = model
        self.site = site
        self.dictionary = dictionary
        spectra = model.spectra
        columns = spectra.columns(site, [dictionary], spectra.precision)
        rows = model.spectra_of_rows
        self.n_rows = len(rows)
        self.products = spectra.windows.products(rows, columns)
        self.informative = spectra.bands.informative
        symbols = [term.symbol for term in dictionary.terms()]
        self.is_signed = np.isin(symbols, dictionary.nonnegative)

    @cached_property
    def _summed(self) -> np.ndarray:
        """Products summed over all folds."""
        return self.products.sum(axis=0)

    # -- steps of the growth ---------------------------------------------------

    def start(self) -> Trial:
        """The model without an atom."""
        model = self.model
        return Trial((), model.weights, model.powers, model.scan_shares)

    def with_one_more(self, current: Trial) -> Trial | None:
        """The best trial with one atom more; None if none helps enough."""
        subsets = []
        for k in range(len(self.is_signed)):
            if k not in current.atoms:
                subsets.append((*current.atoms, k))
        least = GROWTH.least_addition if current.atoms else 0.0
        best = self._best(subsets, current, least)
        if best is None:
            return None
        addition = self._reduction(current, best)
        if current.atoms and addition.value < addition.standard_error:
            return None
        return best

    def exchanged(self, current: Trial) -> Trial:
        """The trial after each of its earlier atoms was exchanged for a better one."""
        for earlier in current.atoms[:-1]:
            remaining = tuple(k for k in current.atoms if k != earlier)
            subsets = []
            for k in range(len(self.is_signed)):
                if k not in current.atoms:
                    subsets.append((*remaining, k))
            better = self._best(subsets, current, GROWTH.least_exchange, finalists=1)
            if better is not None:
                current = better
        return current

    def _best(
        self,
        subsets: Sequence[Subset],
        current: Trial,
        least: float,
        finalists: int = GROWTH.finalists,
    ) -> Trial | None:
        """The best of some subsets on left-out folds, by at least so many dB."""
        if not subsets:
            return None
        screened = self.screened(np.array(subsets), current)
        best, largest = None, least
        for number in np.argsort(-screened)[:finalists]:
            if screened[number] <= least:
                break
            trial = self.validated(subsets[number])
            if trial is None:
                continue
            value = self._reduction(current, trial).value
            if value > largest:
                best, largest = trial, value
        return best

    def _reduction(self, before: Trial, after: Trial) -> ErrorReduction:
        return ErrorReduction.between(before.powers, after.powers, self.informative)

    # -- fits ------------------------------------------------------------------

    def screened(self, subsets: np.ndarray, current: Trial) -> np.ndarray:
        """Error reductions of subsets of equal size on the samples of the fit, dB.

        Minus infinity where a sign cannot be real.
        """
        reductions = [
            self._screened_batch(batch, current) for batch in self._batches(subsets)
        ]
        return np.concatenate(reductions)

    def _batches(self, subsets: np.ndarray) -> Iterator[np.ndarray]:
        """Subsets whose products stay in memory together."""
        size = self.n_rows + subsets.shape[1]
        at_once = max(1, int(4e6 / (self.products.shape[1] * size**2)))
        for start in range(0, len(subsets), at_once):
            yield subsets[start : start + at_once]

    def _screened_batch(self, subsets: np.ndarray, current: Trial) -> np.ndarray:
        solver = self._solver(subsets.shape[1])
        rows = self._rows_of(subsets)
        weighted = np.tensordot(for_groups(current.weights, solver), self._summed, 1)
        sums = _sub_blocks(weighted, rows)
        masses, coefficients = solver.solve(sums)
        residual, reference = solver.rows(masses, coefficients)

        products = _sub_blocks(self._summed, rows)
        powers = []
        for combination in (residual, reference):
            along = (combination[:, None] @ products) * combination[:, None]
            powers.append(np.maximum(along.sum(axis=-1), 0.0).swapaxes(1, 2))
        shares = residual_share(*powers)
        shares = np.where(np.isfinite(shares), shares, np.inf)
        reductions = mean_reduction(current.shares, shares, self.informative)
        possible = self._admissible(subsets, coefficients)
        return np.where(possible & np.isfinite(reductions), reductions, -np.inf)

    def _admissible(self, subsets: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Where no atom that cannot be negative is, and no passive term turns so."""
        squares = self._summed.diagonal(0, 1, 2).sum(axis=0)
        sizes = np.sqrt(squares)
        atoms = coefficients[:, self.n_rows :] * sizes[self.n_rows + subsets]
        wrong = self.is_signed[subsets] & (atoms < 0)

        has_memory = self.dictionary.has_memory
        columns, least = self.model.passive_terms([self.site], has_memory)
        forces = (coefficients[:, columns] - least) * sizes[columns]
        limit = -SIGNS.wrong_share * np.abs(atoms).max(axis=1, keepdims=True)
        return ~wrong.any(axis=1) & (forces >= limit).all(axis=1)

    def validated(self, subset: Subset) -> Trial | None:
        """The fit of a subset with its own weights; None if columns are dependent."""
        rows = self._rows_of(np.array([subset]))[0]
        products = self.products[:, :, rows][..., rows]
        solver = self._solver(len(subset))
        problem = FoldProblem(self.model.spectra, solver, products)
        weights, within, reference = problem.settled_weights()
        masses, coefficients = problem.solve_folds(weights.used)
        powers = Powers(problem.judge_folds(masses, coefficients), reference)
        if not np.isfinite(powers.residual).all():
            return None
        residual, of_reference = solver.rows(masses[:1], coefficients[:1])
        summed = products.sum(axis=0)
        shares = residual_share(
            np.maximum(quadratic_forms(residual[0], summed), 0.0),
            quadratic_forms(of_reference[0], summed),
        )
        return Trial(subset, weights.final, powers, shares)

    def _rows_of(self, subsets: np.ndarray) -> np.ndarray:
        """Rows of the products of the model with each subset, (n_subsets, n_rows)."""
        of_model = np.tile(np.arange(self.n_rows), (len(subsets), 1))
        return np.hstack([of_model, self.n_rows + subsets])

    def _solver(self, n_atoms: int) -> ManySolver:
        atoms = self.dictionary.atoms[:n_atoms]
        law = type(self.dictionary)(atoms)
        return ModelExtension(self.model, [(self.site, law)]).solver


def _sub_blocks(matrices: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Blocks of matrices (n, p, p) at several sets of rows, (n_sets, n, q, q)."""
    blocks = matrices[:, rows[:, :, None], rows[:, None, :]]
    return blocks.swapaxes(0, 1)
