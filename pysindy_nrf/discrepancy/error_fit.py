"""Variable projection: errors of channels fitted with masses and coefficients."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from .error_reduction import REDUCTION, mean_reduction, residual_share
from .fitted_model import FittedModel
from .row_changes import RowChange
from .spectra import BalanceSpectra


@dataclass(frozen=True)
class ErrorFitSettings:
    """Effort of a fit of errors of the channels."""

    # Gauss-Newton steps: three settle all of 24 chains with imperfect sensors; more fit
    # the noise of the columns.
    max_steps: int = 4
    # Change of the level, dB, below which the errors have settled.
    settled: float = 0.05
    # Size of an error for differences, standard deviations.
    difference: float = 0.1
    # Factor by which the prior of the errors grows until they are credible together.
    prior_growth: float = 1.2
    # Columns of the spectra by which errors are estimated: some for each of a hundred
    # errors in each of 24 bands.
    n_columns: int = 8_000


ERROR_FIT = ErrorFitSettings()


@dataclass(frozen=True, eq=False)
class _Combination:
    """What each error changes in a combination of rows, as ``mix @ lines``.

    The last row of ``mix`` and of ``lines`` stands for the combination itself.
    """

    mix: np.ndarray
    lines: np.ndarray


def thinned_columns(spectra: BalanceSpectra) -> np.ndarray:
    """Columns of spectra by which errors are estimated."""
    size = spectra.windows.size
    return np.arange(0, size, -(-size // ERROR_FIT.n_columns))


class ErrorFit:
    """The likeliest errors of the channels together with one model.

    Parameters
    ----------
    model : FittedModel
    thin : ndarray of int
        Columns of the spectra that are read.
    changes : sequence of RowChange
    limit : float
        Largest sum of the squares of the errors, in standard deviations.
    """

    def __init__(
        self,
        model: FittedModel,
        thin: np.ndarray,
        changes: Sequence[RowChange],
        limit: float = np.inf,
    ) -> None:
        self.solver = model.solver
        self.limit = limit
        self.spectra = model.spectra_of_rows[:, thin]
        self.weights = model.weights
        self.n_bands = model.weights.shape[1]
        self.n_columns = model.spectra.windows.size

        self.changes = np.array([change.change for change in changes])
        self.rows = np.array([change.row for change in changes])
        self.numbers = np.array([change.error for change in changes])

        # of each group of balances: its lowest balance, the rows in it, the changes of
        # these, and the columns in which its forces are known
        self.lowest = [group.dofs[0] - 1 for group in self.solver.groups]
        self.rows_of_group = [np.array(rows) for rows in self.solver.rows_of_group]
        self.inside = []
        for rows in self.rows_of_group:
            self.inside.append(np.flatnonzero(np.isin(self.rows, rows)))
        self.used = np.empty((len(self.lowest), len(thin)))
        # of each column its band
        self.band = np.empty(len(thin), dtype=int)
        self._place_columns(model, thin)
        self.in_band = np.eye(self.n_bands)[self.band].T

    def _place_columns(self, model: FittedModel, thin: np.ndarray) -> None:
        """Find band and fold of each column."""
        used_folds = model.spectra.used_folds(self.solver)
        for used, spans in zip(used_folds, model.spectra.windows.spans):
            for band, span in enumerate(spans):
                columns = slice(*np.searchsorted(thin, [span.start, span.stop]))
                self.used[:, columns] = used[:, None]
                self.band[columns] = band

    def likeliest(self, start: np.ndarray) -> np.ndarray:
        """The errors that leave the least residual, of all that Gauss-Newton passes.

        Standard deviations.
        """
        spectra = self._spectra_at(start)
        weights, level = self._judged(spectra, self.weights)
        errors = best = start
        least = level

        for _ in range(ERROR_FIT.max_steps):
            errors = errors + self._step(errors, spectra, weights)
            spectra = self._spectra_at(errors)
            weights, level = self._judged(spectra, weights)
            settled = abs(least - level) < ERROR_FIT.settled
            if level < least:
                best, least = errors, level
            if settled:
                break
        return best

    def each_alone(self, n_errors: int) -> tuple[np.ndarray, np.ndarray]:
        """The size of each error that explains most by itself, to first order.

        Returns
        -------
        sizes : ndarray of shape (n_errors,)
            Standard deviations.
        shares : ndarray of shape (n_errors,)
            Share of the weighted residual that it explains.
        """
        normal = self._linearised(n_errors, self.spectra, self.weights)
        powers = normal.diagonal()[:-1]
        known = powers > 0
        slopes = np.where(known, normal[:-1, -1] / np.where(known, powers, 1.0), 0.0)
        return -slopes, slopes**2 * powers / normal[-1, -1]

    def _spectra_at(self, errors: np.ndarray) -> np.ndarray:
        """Rows with errors of some sizes."""
        every = np.arange(len(self.rows))
        factors = errors[self.numbers]
        changes = self._sums(every, self.rows, factors, len(self.spectra))
        return self.spectra + changes

    def _sums(
        self, chosen: np.ndarray, targets: np.ndarray, factors: np.ndarray, count: int
    ) -> np.ndarray:
        """Sums of chosen changes times their factors, by the target of each."""
        nonzero = np.flatnonzero(factors)
        places = targets[nonzero], chosen[nonzero]
        shape = count, len(self.changes)
        return csr_array((factors[nonzero], places), shape) @ self.changes

    def _column_weights(self, group: int, weights: np.ndarray) -> np.ndarray:
        """Weights of the columns in the fit of a group of balances."""
        return weights[self.lowest[group], self.band] * self.used[group]

    def _products(self, spectra: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Weighted products of the rows in each group of balances; others are zero.

        Shape (n_groups, n_rows, n_rows).
        """
        out = np.zeros((len(self.rows_of_group), len(spectra), len(spectra)))
        for group, rows in enumerate(self.rows_of_group):
            heavy = spectra[rows] * self._column_weights(group, weights)
            out[group][rows[:, None], rows] = heavy @ spectra[rows].T
        return out

    def _judged(
        self, spectra: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Weights that follow from the residual, and its mean level, dB."""
        fit = self.solver.solve(self._products(spectra, weights)[None])
        residual, reference = self.solver.rows(*fit)
        power = self._power_by_band(residual[0], spectra)
        total = self._power_by_band(reference[0], spectra)

        share = residual_share(power, total)
        inside = (weights > 0) & np.isfinite(share)
        level = float(mean_reduction(share, np.ones_like(share), inside))
        floored = power + REDUCTION.resolution**2 * total
        counts = inside & (floored > 0)
        new = np.where(counts, 1.0 / np.maximum(floored, 1e-300), 0.0)
        return new, level if np.isfinite(power).all() else np.inf

    def _power_by_band(self, rows: np.ndarray, spectra: np.ndarray) -> np.ndarray:
        """Power of combinations of rows in each band, (n_balances, n_bands)."""
        squares = (rows @ spectra) ** 2 * self.used[self.solver.judged]
        return np.array([np.bincount(self.band, y, self.n_bands) for y in squares])

    # -- one step --------------------------------------------------------------

    def _step(
        self, errors: np.ndarray, spectra: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """The step to the likeliest errors, to first order."""
        normal = self._linearised(len(errors), spectra, weights)
        return self._credible(normal, errors) - errors

    def _linearised(
        self, n_errors: int, spectra: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Normal equations of all errors; masses and coefficients follow them.

        Shape (n_errors + 1, n_errors + 1), the last row that of the residual.
        """
        products = self._products_with_each(n_errors, spectra, weights)
        fits = self.solver.rows(*self.solver.solve(products))
        finite = np.isfinite(fits[0]).all(axis=(1, 2))
        # an error with which there is no fit changes nothing
        usable = (finite & finite[0])[:, None, None]
        residuals, references = (
            np.nan_to_num(np.where(usable, rows, rows[:1])) for rows in fits
        )
        return self._normal_equations(residuals, references, spectra, weights)

    def _products_with_each(
        self, n_errors: int, spectra: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Products as they are, then with a part of each error, to first order.

        Shape (n_errors + 1, n_groups, n_rows, n_rows).
        """
        products = self._products(spectra, weights)
        out = np.repeat(products[None], n_errors + 1, axis=0)
        for group, (rows, inside) in enumerate(zip(self.rows_of_group, self.inside)):
            column_weights = ERROR_FIT.difference * self._column_weights(group, weights)
            cross = self.changes[inside] @ (spectra[rows] * column_weights).T
            error = self.numbers[inside, None] + 1
            changed = self.rows[inside, None]
            out[error, group, rows, changed] += cross
            out[error, group, changed, rows] += cross
        return out

    def _normal_equations(
        self,
        residuals: np.ndarray,
        references: np.ndarray,
        spectra: np.ndarray,
        weights: np.ndarray,
    ) -> np.ndarray:
        """Products of the changes of the residual by each error, and of the residual.

        Shape (n_errors + 1, n_errors + 1). What an error changes of the reference is
        taken off: the measure of errors reads shares.
        """
        normal = np.zeros((len(residuals), len(residuals)))
        of_residual = self._combinations(residuals, spectra)
        of_reference = self._combinations(references, spectra)
        for balance, (residual, reference) in enumerate(zip(of_residual, of_reference)):
            used = self.used[self.solver.judged[balance]]
            line = reference.lines[-1] * used
            inner = (reference.lines * line) @ self.in_band.T
            size = np.where(inner[-1] > 0, inner[-1], 1.0)
            shrinks = reference.mix[:-1] @ inner / size

            by_band = residual.lines[-1] * self.in_band
            scale = np.sqrt(weights[balance, self.band] * used)
            lines = np.vstack([residual.lines[:-1], by_band]) * scale
            of_bands = np.vstack([-shrinks, np.ones(self.n_bands)])
            mix = np.hstack([residual.mix[:, :-1], of_bands])
            normal += mix @ (lines @ lines.T) @ mix.T
        return normal

    def _combinations(
        self, rows: np.ndarray, spectra: np.ndarray
    ) -> Iterator[_Combination]:
        """What each error changes in the combination of rows of each balance."""
        # of masses and coefficients
        follow = (rows[1:] - rows[0]) / ERROR_FIT.difference
        for balance, group in enumerate(self.solver.judged):
            inside = self.inside[group]
            in_group = self.rows_of_group[group]
            errors, place = np.unique(self.numbers[inside], return_inverse=True)
            factors = rows[self.numbers[inside] + 1, balance, self.rows[inside]]
            # with the model as it is
            direct = self._sums(inside, place, factors, len(errors))
            lines = np.vstack([spectra[in_group], direct, rows[0, balance] @ spectra])

            mix = np.zeros((len(rows), len(lines)))
            mix[:-1, : len(in_group)] = follow[:, balance, in_group]
            mix[errors, len(in_group) + np.arange(len(errors))] = 1.0
            mix[-1, -1] = 1.0
            yield _Combination(mix, lines)

    def _credible(self, normal: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """The errors of the least residual that are credible together.

        Their prior has as much weight as they need for that.
        """
        sizes, directions = np.linalg.eigh(normal[:-1, :-1])
        sizes = np.maximum(sizes, 0.0)
        pull = directions.T @ (normal[:-1, :-1] @ errors - normal[:-1, -1])
        largest = sizes[-1]

        prior = max(self.n_bands / self.n_columns, 1e-12 * largest)
        likeliest = directions @ (pull / (sizes + prior))
        while np.sum(likeliest**2) > self.limit and prior < 1e12 * largest:
            prior *= ERROR_FIT.prior_growth
            likeliest = directions @ (pull / (sizes + prior))
        return likeliest
