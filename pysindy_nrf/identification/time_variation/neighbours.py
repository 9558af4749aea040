"""Noise of pieces that are next to each other, taken together."""

from __future__ import annotations

import numpy as np

# Neighbours of a piece, of an eighth of a period, that are taken together: half a
# period. On 40 chains with 1 and 5 % noise, wider windows read little more than what
# the course itself has absorbed.
NEIGHBOURS = 4
# Share of the noise that courses leave in a short record, at least.
LEAST_LEFT = 0.25


def together(influences: np.ndarray) -> np.ndarray:
    """Covariance of the sums of influences (n_pieces, n), neighbours together.

    (Newey and West, Econometrica 55, 1987.)
    """
    total = influences.T @ influences
    for lag in range(1, NEIGHBOURS + 1):
        cross = influences[lag:].T @ influences[:-lag]
        total = total + (1 - lag / (NEIGHBOURS + 1)) * (cross + cross.T)
    return total
