"""Whether the nonlinear terms of a power series are there, or noise.

Many terms that follow each other share what noise there is: single ones then carry some
percent of a force, of opposite sign. So they are tested together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, stats

from .effects import NAMED_SHARE

# Probability with which noise alone is taken for a nonlinear force: a report names the
# storeys of a hundred frames before it names one that is linear.
LEVEL = 1e-3
# Pieces of the data for each direction that is tested. With fewer the covariance of so
# many directions is hardly known, and the test finds nothing.
PIECES_PER_DIRECTION = 4
LINEAR = ("v", "s")


@dataclass(frozen=True)
class SeriesEstimate:
    """The estimate of the power series of one site.

    Attributes
    ----------
    labels : sequence of str
        Of the terms, such as ``"v"`` or ``"s^3"``.
    coefficients : ndarray of shape (n_terms,)
    influences : ndarray of shape (n_pieces, n_terms)
        Of each piece of the data on the coefficients, as in a jackknife.
    products : ndarray of shape (n_terms, n_terms)
        Sums of products of the terms along the data.
    """

    labels: Sequence[str]
    coefficients: np.ndarray
    influences: np.ndarray
    products: np.ndarray

    def numbers(self, *letters: str) -> np.ndarray:
        """Numbers of the nonlinear terms with any of some letters."""
        numbers = []
        for number, label in enumerate(self.labels):
            nonlinear = label not in LINEAR
            if nonlinear and any(letter in label for letter in letters):
                numbers.append(number)
        return np.array(numbers, dtype=int)

    @property
    def kind(self) -> str:
        """The nonlinear force that the data show, in words; empty without one."""
        if not self.shows(self.numbers("v", "s")):
            return ""
        of_rate = self.shows(self.numbers("v"))
        of_drift = self.shows(self.numbers("s"))
        if of_rate == of_drift:
            return "a nonlinear force"
        return "nonlinear stiffness" if of_drift else "nonlinear damping"

    def shows(self, numbers: np.ndarray) -> bool:
        """Whether terms together carry a part of the force, and it is no chance."""
        if not len(numbers) or self._share(numbers) <= NAMED_SHARE:
            return False
        return self.p_value(numbers) < LEVEL

    def _share(self, numbers: np.ndarray) -> float:
        """Rms of the force of some terms over that of all."""
        values = self.coefficients[numbers]
        square = values @ self.products[np.ix_(numbers, numbers)] @ values
        total = self.coefficients @ self.products @ self.coefficients
        return float(np.sqrt(max(square, 0.0) / total)) if total > 0 else 0.0

    def p_value(self, numbers: np.ndarray) -> float:
        """Probability of coefficients so large if all of some terms were zero.

        Hotelling's test in the directions that carry most force beyond that of the
        other terms.
        """
        n_pieces = len(self.influences)
        directions = self._directions(numbers)[: n_pieces // PIECES_PER_DIRECTION]
        estimate = directions @ self.coefficients[numbers]
        influences = self.influences[:, numbers] @ directions.T
        influences = influences - influences.mean(axis=0)
        covariance = influences.T @ influences

        # free of units, and without a variance of zero
        size = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        variances, axes = linalg.eigh(covariance / np.outer(size, size))
        variances = np.maximum(variances, np.finfo(float).eps)
        t_squared = float(np.sum((axes.T @ (estimate / size)) ** 2 / variances))

        n = len(directions)
        ratio = t_squared * (n_pieces - n) / (n * (n_pieces - 1))
        return float(stats.f.sf(ratio, n, n_pieces - n))

    def _directions(self, numbers: np.ndarray) -> np.ndarray:
        """Combinations of some terms, those of the largest forces first.

        Forces are what the other terms cannot imitate.
        """
        others = np.setdiff1d(np.arange(len(self.labels)), numbers)
        scale = np.sqrt(np.maximum(np.diag(self.products), np.finfo(float).tiny))
        unit = self.products / np.outer(scale, scale)
        beside = unit[np.ix_(others, numbers)]
        imitated = beside.T @ linalg.pinvh(unit[np.ix_(others, others)]) @ beside
        not_imitated = unit[np.ix_(numbers, numbers)] - imitated

        values, axes = linalg.eigh(not_imitated)
        shown = values > len(numbers) * np.finfo(float).eps * values[-1]
        return (axes[:, shown][:, ::-1] * scale[numbers, None]).T
