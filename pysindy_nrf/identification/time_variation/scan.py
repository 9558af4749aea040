"""Further functions of time of one coefficient, added to a fit.

The scores of a step at every instant, and of smooth functions, each together with all
other unknowns (Andrews, Econometrica 61, 1993, on instants that are not known).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from .neighbours import NEIGHBOURS, together
from .penalised import PenalisedFit

# Half cosines that a gradual change is tested by.
HALF_COSINES = 4
# Share of the information on a coefficient on either side of an instant, at least.
LEAST_SIDE = 0.05
# Information on a step beside the other unknowns, over that of the step alone, at
# least: the data tell it from them.
LEAST_DETERMINED = 1e-6
# Logarithm of the smallest probability whose normal score is computed.
LEAST_LOG = -700.0


@dataclass(frozen=True, eq=False)
class FurtherFunctions:
    """Functions of time of one coefficient, each with all other unknowns of a fit.

    Attributes
    ----------
    scores : ndarray of shape (n_functions,)
        Products of the residual with them.
    information : ndarray of shape (n_functions, n_functions)
        Variance of the scores by white noise of unit dispersion.
    influences : ndarray of shape (n_pieces, n_functions)
        What the noise of each piece adds to the scores, the change of the other
        unknowns with it.
    """

    scores: np.ndarray
    information: np.ndarray
    influences: np.ndarray

    @classmethod
    def of(
        cls,
        fit: PenalisedFit,
        unknown: int,
        functions: np.ndarray,
        noise: np.ndarray | None = None,
    ) -> FurtherFunctions:
        """Functions (n_pieces, n_functions) added to a fit.

        ``noise`` are the scores of the noise, (n_pieces, n_unknowns); those of the fit
        if None.
        """
        noise = fit.scores if noise is None else noise
        crossed = fit.crossed(unknown, functions)
        explained = fit.covariance @ crossed
        products = fit.products[:, unknown, unknown, None] * functions
        information = functions.T @ products - crossed.T @ explained
        direct = functions * noise[:, unknown, None]
        influences = direct - fit.by_function(noise) @ explained
        return cls(functions.T @ fit.scores[:, unknown], information, influences)

    @property
    def variances(self) -> np.ndarray:
        """Variance of each score as the pieces show it, neighbours together."""
        x = self.influences
        total = np.sum(x**2, axis=0)
        for lag in range(1, NEIGHBOURS + 1):
            weight = 2 * (1 - lag / (NEIGHBOURS + 1))
            total = total + weight * np.sum(x[lag:] * x[:-lag], axis=0)
        return total

    @property
    def freedom(self) -> np.ndarray:
        """Degrees of freedom of each variance: few where few pieces make it up.

        By the kurtosis of the influences, 3 of Gaussian ones; neighbours together have
        fewer (Anderson, The statistical analysis of time series, 1971, section 9.3).
        """
        squares = self.influences**2
        fourth = np.maximum(np.sum(squares**2, axis=0), np.finfo(float).tiny)
        pieces = 3 * np.sum(squares, axis=0) ** 2 / fourth
        return np.maximum(1.5 * pieces / (NEIGHBOURS + 1), 1.0)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the scores as the pieces show it, neighbours together."""
        return together(self.influences)


@dataclass(frozen=True, eq=False)
class StepScan:
    """A step at every piece, added to a fit.

    Attributes
    ----------
    pieces : ndarray of int
        Pieces at whose beginning the step may be.
    scores : ndarray
        Standardised, for white noise of unit dispersion.
    robust : ndarray
        Standardised by the noise that the pieces show, and the least one.
    freedom : ndarray
        Degrees of freedom of that noise.
    neighbours : ndarray of shape (len(pieces) - 1,)
        Correlation of the scores of neighbouring instants.
    """

    pieces: np.ndarray
    scores: np.ndarray
    robust: np.ndarray
    freedom: np.ndarray
    neighbours: np.ndarray

    @property
    def best(self) -> int:
        """Piece at whose beginning a step explains most; 0 if there is none."""
        if not len(self.pieces):
            return 0
        return int(self.pieces[np.argmax(np.abs(self.scores))])

    @property
    def log_probability(self) -> float:
        """Logarithm of a bound of the probability of a score as high, by chance.

        The bound of Worsley (Biometrika 69, 1982): of the first instant, and of each
        that exceeds where the one before it does not.
        """
        if not len(self.robust):
            return 0.0
        # every score as the normal one that is as improbable
        tails = stats.t.logsf(np.abs(self.robust), self.freedom)
        first = float(tails.min())
        level = float(stats.norm.isf(np.exp(max(first, LEAST_LOG))))
        # for neighbours as close as here: P(Z1 < z < Z2) = phi(z) times the mean of the
        # positive part of Z2 - Z1, and phi(z) is about z times the tail
        gaps = np.sqrt(np.maximum(2 - 2 * self.neighbours, 0.0) / (2 * np.pi))
        instants = 1.0 + max(level, 1.0) * float(np.sum(gaps))
        return min(first + float(np.log(2 * instants)), 0.0)


@dataclass(frozen=True, eq=False)
class Noise:
    """What moves the scores of a fit by chance.

    Attributes
    ----------
    scores : ndarray of shape (n_pieces, n_unknowns)
        Of the noise that the pieces show.
    least : float
        Dispersion of the least noise that sensors have.
    """

    scores: np.ndarray
    least: float


def step_scan(fit: PenalisedFit, unknown: int, noise: Noise | None = None) -> StepScan:
    """A step of one coefficient added to a fit, at every piece.

    With the noise, for a test, at every half period. Instants with too little
    information on either side are left out.
    """
    spacing = 1 if noise is None else NEIGHBOURS
    noise = noise or Noise(fit.scores, 0.0)
    information = fit.products[:, unknown, unknown]
    share = np.cumsum(information[::-1])[::-1] / information.sum()
    inside = (share > LEAST_SIDE) & (share < 1 - LEAST_SIDE)
    pieces = np.flatnonzero(inside)[::spacing]
    after = np.arange(len(share))[:, None] >= pieces
    further = FurtherFunctions.of(fit, unknown, after.astype(float), noise.scores)

    white = np.diag(further.information)
    variance = further.variances
    determined = white > LEAST_DETERMINED * share[pieces] * information.sum()
    chosen = np.flatnonzero(determined)
    root = np.sqrt(white[chosen])
    scores = further.scores[chosen]
    variances = variance[chosen] + noise.least * white[chosen]
    robust = scores / np.sqrt(np.maximum(variances, np.finfo(float).tiny))
    shared = further.information[chosen[:-1], chosen[1:]]
    freedom = further.freedom[chosen]
    correlation = np.clip(shared / (root[:-1] * root[1:]), -1.0, 1.0)
    return StepScan(pieces[chosen], scores / root, robust, freedom, correlation)


def log_probability_of_smooth(fit: PenalisedFit, unknown: int, noise: Noise) -> float:
    """Logarithm of the probability that smooth functions explain as much by chance.

    Of one coefficient, added to a fit: an F-test of half cosines over the record.
    """
    n_pieces = len(fit.products)
    share = (np.arange(n_pieces) + 0.5) / n_pieces
    waves = np.cos(np.pi * np.outer(share, np.arange(1, HALF_COSINES + 1)))
    further = FurtherFunctions.of(fit, unknown, waves, noise.scores)
    covariance = further.covariance + noise.least * further.information
    solution = np.linalg.lstsq(covariance, further.scores, rcond=1e-9)[0]
    ratio = max(float(further.scores @ solution), 0.0) / HALF_COSINES
    freedom = float(further.freedom.min())
    return float(stats.f.logsf(ratio, HALF_COSINES, freedom))
