"""How much more the noise moves a coefficient than white noise of its size would.

What fusion and sensors leave is correlated over time. The products of the residual with
a column, piece by piece, show by how much: their variance over that of white noise,
neighbours together (Newey and West, Econometrica 55, 1987).
"""

from __future__ import annotations

import numpy as np

from .neighbours import NEIGHBOURS
from .penalised import PenalisedFit


def dispersion_of(fit: PenalisedFit, unknown: int) -> float:
    """Variance of the products of residual and column over that of white noise.

    What the course of the coefficient has absorbed of them is accounted for: of white
    noise of variance D they keep ``(I - D B V B') D (I - D B V B')'``, with the
    functions B of the course and their covariance V.
    """
    scores = fit.scores[:, unknown]
    white = fit.products[:, unknown, unknown]
    columns = fit.courses[unknown].columns
    here = fit.places[unknown]
    absorbed = white[:, None] * columns @ fit.covariance[here, here]
    weighted = white[:, None] * columns
    # the two sides of  D - A B' D - D B A' + A (B' D B) A'
    right = -2.0 * weighted + absorbed @ (columns.T @ weighted)

    observed = 0.0
    expected = float(white.sum())
    n_pieces = len(scores)
    for lag in range(-NEIGHBOURS, NEIGHBOURS + 1):
        weight = 1 - abs(lag) / (NEIGHBOURS + 1)
        first = slice(max(lag, 0), n_pieces + min(lag, 0))
        second = slice(max(-lag, 0), n_pieces - max(lag, 0))
        observed += weight * float(scores[first] @ scores[second])
        expected += weight * float(np.sum(absorbed[first] * right[second]))
    return max(observed, 0.0) / expected
