"""A place for further laws added to a fitted model: where a scan tries many at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..chain.layout import LawLayout, Layout
from ..equations.protocol import ManySolver
from ..laws.base import ForceLaw
from .error_reduction import mean_reduction, residual_share
from .fitted_model import (
    FittedModel,
    PlacedLaw,
    for_groups,
    solve_folds,
    weighted_sums,
)
from .spectra import ScanProducts

# Numbers in the spectra of a scan that are in memory at once.
NUMBERS_AT_ONCE = 500_000


@dataclass(frozen=True)
class Extensions:
    """A model with each of several laws added, all fitted to the samples of the fit.

    Attributes
    ----------
    reductions : ndarray of shape (n_points,)
        Error reductions, dB.
    passive_forces : ndarray of shape (n_points, n_passive)
        Of the springs and dashpots next to the laws, above the least that they may
        have; negative where a law replaces one.
    forces : ndarray of shape (n_points, n_terms)
        Of the terms of the added laws.
    """

    reductions: np.ndarray
    passive_forces: np.ndarray
    forces: np.ndarray


@dataclass(frozen=True)
class _Products:
    """Products of the columns of laws.

    Attributes
    ----------
    with_rows : ndarray of shape (n_bands, n_rows, n_points, n_columns)
        With the rows of the model; zero where a row stands in other balances.
    with_columns : ndarray of shape (n_points, n_bands, n_columns, n_columns)
        With each other.
    """

    with_rows: np.ndarray
    with_columns: np.ndarray


class ModelExtension:
    """A place for laws at some sites, whatever the values of their shape parameters.

    Parameters
    ----------
    model : FittedModel
    placed : sequence of (Site, ForceLaw)
    n_further : int
        Further columns of each law.

    Raises
    ------
    LawError
        If a term stands at a site already.
    """

    def __init__(
        self, model: FittedModel, placed: Sequence[PlacedLaw], n_further: int = 0
    ) -> None:
        self.model = model
        self.sites = [site for site, _ in placed]
        self.widths = [len(law.terms()) + n_further for _, law in placed]
        self.width = sum(self.widths)
        self.has_memory = any(law.has_memory for _, law in placed)
        self._require_new_terms(placed)

        key = tuple(zip(self.sites, self.widths))
        if key not in model.solvers:
            model.solvers[key] = self._new_solver()
        self.solver = model.solvers[key]

        n_rows = model.summed.shape[-1]
        beside = self.solver.beside(range(n_rows, n_rows + self.width))
        # rows of the model beside which the columns stand in a balance
        self._beside = [row for row in beside if row < n_rows]

    def _require_new_terms(self, placed: Sequence[PlacedLaw]) -> None:
        """A LawError where two laws at a site have the same term."""
        laws = {site: list(self.model.laws.get(site, ())) for site in self.sites}
        for site, law in placed:
            laws[site].append(law)
        LawLayout(self.model.chain.with_links(self.sites), laws)

    def _new_solver(self) -> ManySolver:
        """The solve with the columns of the laws behind all rows of the model."""
        model = self.model
        where = {}
        for site, rows in model.layout.slices.items():
            where[site] = list(range(rows.start, rows.stop))

        column = model.summed.shape[-1]
        for site, width in zip(self.sites, self.widths):
            columns = range(column, column + width)
            where[site] = [*where.get(site, ()), *columns]
            column += width

        chain = model.chain.with_links(self.sites)
        acting = dict.fromkeys([*model.laws, *self.sites])
        layout = Layout(chain, {site: len(where.get(site, ())) for site in acting})
        places = {site: where.get(site, []) for site in layout.sites}
        return model.spectra.solver(layout, places, model.first_fixed)

    # -- coefficients from fold to fold ----------------------------------------

    def without_folds(self, columns: np.ndarray) -> np.ndarray:
        """Coefficients of columns with each fold left out of the fit.

        Parameters
        ----------
        columns : ndarray of shape (n_columns, size)
            Spectra.

        Returns
        -------
        ndarray of shape (n_folds, n_columns)
        """
        model, spectra = self.model, self.model.spectra
        rows = spectra.model_rows(model.layout)
        products = spectra.windows.products(*rows, columns)
        used = spectra.used_folds(self.solver)
        sums = weighted_sums(products, model.weights, self.solver, used)
        _, coefficients = solve_folds(self.solver, sums)
        return coefficients[1:, model.summed.shape[-1] :]

    # -- scans -----------------------------------------------------------------

    def fit_each(
        self,
        points: Sequence[tuple[ForceLaw, ...]],
        known: ScanProducts | None = None,
    ) -> Extensions:
        """Fit the model with the laws of each point.

        Parameters
        ----------
        points : sequence of tuple of ForceLaw
            A law for each site.
        known : dict, optional
            Products of the same points that an earlier model needed; those that are
            missing are added.
        """
        products = self._all_products(points, {} if known is None else known)
        sums = self._sums(products)
        masses, coefficients = self.solver.solve(sums)
        rows = np.concatenate(self.solver.rows(masses, coefficients), axis=1)
        residual, reference = np.split(self._powers(rows, products), 2, axis=1)
        residual = np.where(np.isfinite(residual), np.maximum(residual, 0.0), np.inf)

        reductions = mean_reduction(
            self.model.scan_shares,
            residual_share(residual, reference),
            self.model.spectra.bands.informative,
        )
        squares = products.with_columns.diagonal(0, 2, 3).sum(axis=1)
        forces = coefficients[:, -self.width :] * np.sqrt(squares)
        return Extensions(reductions, self._passive_forces(coefficients), forces)

    def _sums(self, products: _Products) -> np.ndarray:
        """Weighted products of all rows and columns for each group of balances.

        Shape (n_points, n_groups, n_rows + n_columns, n_rows + n_columns).
        """
        model = self.model
        n_bands, n_rows, n_points, width = products.with_rows.shape
        weights = for_groups(model.weights, self.solver)
        size = n_rows + width

        cross = np.tensordot(weights, products.with_rows, 1).transpose(2, 0, 1, 3)
        inner = weights @ products.with_columns.reshape(n_points, n_bands, -1)

        sums = np.empty((n_points, len(weights), size, size))
        sums[..., :n_rows, :n_rows] = for_groups(model.weighted, self.solver)
        sums[..., :n_rows, n_rows:] = cross
        sums[..., n_rows:, :n_rows] = cross.swapaxes(-1, -2)
        sums[..., n_rows:, n_rows:] = inner.reshape(n_points, -1, width, width)
        return sums

    def _powers(self, rows: np.ndarray, products: _Products) -> np.ndarray:
        """Power of combinations of rows and columns, (n_points, n, n_bands).

        ``rows`` has the shape (n_points, n, n_rows + n_columns).
        """
        n_bands, n_rows, n_points, _ = products.with_rows.shape
        of_rows = rows[..., :n_rows].reshape(-1, n_rows)
        power = ((of_rows @ self.model.summed) * of_rows).sum(axis=-1)
        power = power.reshape(n_bands, n_points, -1).transpose(1, 2, 0)

        of_rows = rows[:, None, :, :n_rows]
        of_columns = rows[:, None, :, n_rows:]
        cross = 2.0 * of_rows @ products.with_rows.transpose(2, 0, 1, 3)
        inner = of_columns @ products.with_columns
        return power + ((cross + inner) * of_columns).sum(axis=-1).swapaxes(1, 2)

    def _passive_forces(self, coefficients: np.ndarray) -> np.ndarray:
        """Forces beside the laws above the least that they may have."""
        model = self.model
        columns, least = model.passive_terms(self.sites, self.has_memory)
        squares = model.summed[:, columns, columns].sum(axis=0)
        return (coefficients[:, columns] - least) * np.sqrt(squares)

    def _all_products(
        self, points: Sequence[tuple[ForceLaw, ...]], known: ScanProducts
    ) -> _Products:
        """Products with all rows of the model; those that are missing are added."""
        model, windows = self.model, self.model.spectra.windows
        numbers = model.row_numbers
        missing = [row for row in self._beside if numbers[row] not in known]
        if missing or None not in known:
            rows = self._rows
            if missing != self._beside:
                rows = model.spectra_of_rows[missing]
            at_once = max(1, NUMBERS_AT_ONCE // (self.width * windows.size))
            with_rows, with_columns = [], []
            for start in range(0, len(points), at_once):
                batch = self._products(points[start : start + at_once], rows)
                with_rows.append(batch.with_rows)
                with_columns.append(batch.with_columns)
            known[None] = np.concatenate(with_columns)
            new = np.concatenate(with_rows, axis=2)
            known.update(zip([numbers[row] for row in missing], new))

        shape = (len(windows.bands), len(numbers), len(points), self.width)
        cross = np.zeros(shape)
        for row in self._beside:
            cross[:, row] = known[numbers[row]]
        return _Products(cross, known[None])

    @cached_property
    def _rows(self) -> np.ndarray:
        """Spectra of the rows beside which the columns stand."""
        return self.model.spectra_of_rows[self._beside]

    def _products(
        self, points: Sequence[tuple[ForceLaw, ...]], rows: np.ndarray
    ) -> _Products:
        """Products of the columns of some points with some rows and with each other.

        Those with rows have the shape (n_rows, n_bands, n_points, n_columns).
        """
        spectra = self.model.spectra
        parts = []
        for k, (site, width) in enumerate(zip(self.sites, self.widths)):
            columns = spectra.columns(site, [laws[k] for laws in points])
            parts.append(columns.reshape(len(points), width, -1))
        columns = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

        wide = columns.reshape(-1, columns.shape[-1])
        by_band = [rows[:, band] @ wide[:, band].T for band in spectra.windows.bands]
        with_rows = np.array(by_band).swapaxes(0, 1)
        shape = (len(rows), len(by_band), *columns.shape[:2])
        return _Products(
            with_rows.reshape(shape), spectra.windows.products_of_trials(columns)
        )
