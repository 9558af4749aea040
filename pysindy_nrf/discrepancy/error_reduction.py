"""Error reduction in dB, the one measure by which the loop decides.

The error reduction from one model to another is the sum over balances of the mean over
informative bands of ``10 log10(P_before / P_after)``, P the power of the residual on
folds that the fit did not see. A band full of noise contributes 0 dB whatever its size,
and a noisy balance cannot hide what happens in a quiet one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..equations.normal_equations import leave_one_out, variance


@dataclass(frozen=True)
class ReductionSettings:
    """Numbers in the error reduction."""

    # Share of the reference in all bands, in rms, that no measurement distinguishes
    # from zero: 16 bits resolve 3e-5 of a range, ten times the rms.
    resolution: float = 1e-3
    # Share of the worst balance that another must leave to count: 1 % of noise in one
    # is nothing where another leaves 50 %, and a law that is nearly right there may
    # leave more of it. Chosen on the second case of docs/paper.md.
    of_worst: float = 0.1
    # A band changes if the logarithm of its power does so by a tenth, up or down.
    changed_band: float = 0.1
    # Standard errors beyond which a value is sure (95 %).
    sure_errors: float = 2.0


REDUCTION = ReductionSettings()


@dataclass(frozen=True, eq=False)
class Powers:
    """Power of residual and reference by balance and band.

    Attributes
    ----------
    folds : ndarray of shape (n_folds, n_balances, n_bands)
        Of the residual on each fold, which was left out of the fit.
    reference : ndarray of shape (n_balances, n_bands)
    """

    folds: np.ndarray
    reference: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Power of the residual on all folds, (n_balances, n_bands)."""
        return self.folds.sum(axis=0)

    @property
    def shares(self) -> np.ndarray:
        """Residual over reference.

        Where no force scales a balance both may shrink together.
        """
        return residual_share(self.residual, self.reference)


def residual_share(residual: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Residual over reference by balance and band.

    With what no measurement distinguishes from zero in it; infinite where there is no
    reference.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (residual + unresolved_power(reference)) / reference
    return np.where(reference > 0, share, np.inf)


def unresolved_power(reference: np.ndarray) -> np.ndarray:
    """Power in each band that no measurement distinguishes from zero, (..., 1).

    A share of the reference in all bands: sensors resolve a part of their range.
    """
    return REDUCTION.resolution**2 * reference.sum(axis=-1, keepdims=True)


def mean_reduction(
    before: np.ndarray, after: np.ndarray, informative: np.ndarray
) -> np.ndarray:
    """Sum over balances of the mean reduction of shares in informative bands, dB.

    The last two axes are balances and bands.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        least = REDUCTION.of_worst**2 * _worst_share(after, informative)
        decibels = 10.0 * np.log10((before + least) / (after + least))
    bands = np.where(informative & np.isfinite(before), decibels, 0.0)
    n_bands = np.maximum(informative.sum(axis=-1), 1)
    return (bands.sum(axis=-1) / n_bands).sum(axis=-1)


def _worst_share(shares: np.ndarray, informative: np.ndarray) -> np.ndarray:
    """The largest share of a balance in its informative bands, (..., 1, 1)."""
    n_bands = np.maximum(informative.sum(axis=-1), 1)
    of_balances = np.where(informative, shares, 0.0).sum(axis=-1) / n_bands
    return of_balances.max(axis=-1)[..., None, None]


@dataclass(frozen=True, eq=False)
class ErrorReduction:
    """Reduction of the residual from one model to another, dB.

    Attributes
    ----------
    value : float
        Mean over the informative bands; it ranks effects.
    standard_error : float
        From fold to fold (jackknife).
    without_fold : ndarray of shape (n_folds,)
        The value with each fold left out.
    where_it_acts, least_where_it_acts : float
        Mean over the bands that change, and the least of it when a fold is left out;
        asked of a force that acts in one band.
    """

    value: float
    standard_error: float
    without_fold: np.ndarray
    where_it_acts: float
    least_where_it_acts: float

    @classmethod
    def between(
        cls, before: Powers, after: Powers, informative: np.ndarray
    ) -> ErrorReduction:
        """The error reduction from the powers of one model to those of another.

        Minus infinity where the second lacks a fold, for which a corrected channel is
        too short.
        """
        n_folds = len(before.folds)
        if len(after.folds) != n_folds:
            nothing = np.full(n_folds, -np.inf)
            return cls(-np.inf, np.inf, nothing, -np.inf, -np.inf)

        value = float(mean_reduction(before.shares, after.shares, informative))
        left_before = residual_share(leave_one_out(before.folds), before.reference)
        left_after = residual_share(leave_one_out(after.folds), after.reference)

        with np.errstate(invalid="ignore"):
            without_fold = mean_reduction(left_before, left_after, informative)
            change = np.abs(np.log(after.shares / before.shares))
            changed = informative & (change >= REDUCTION.changed_band)
            acting = mean_reduction(before.shares, after.shares, changed)
            least_acting = mean_reduction(left_before, left_after, changed).min()
            error = float(np.sqrt(variance(without_fold)))

        if not np.isfinite(value) or not np.isfinite(error):
            value, error = -np.inf, np.inf
        return cls(value, error, without_fold, float(acting), float(least_acting))

    @property
    def least(self) -> float:
        """The value without the fold that contributes most to it, dB."""
        if not np.isfinite(self.value):
            return -np.inf
        return float(self.without_fold.min())

    @property
    def lower(self) -> float:
        """The value less its standard error, dB.

        A fold without which the value is larger counts as far as one without which it
        is smaller. A sudden change falls into one fold: without it the value is larger
        by far, which is nothing against the effect.
        """
        if not np.isfinite(self.value):
            return -np.inf
        away = self.without_fold - self.value
        away = np.minimum(away, max(-away.min(), 0.0))
        n_folds = len(away)
        return self.value - float(np.sqrt((n_folds - 1) / n_folds * (away @ away)))

    @property
    def bound(self) -> float:
        """The value less two of these standard errors (95 %), dB."""
        return self.value - REDUCTION.sure_errors * (self.value - self.lower)
