"""Covariance of estimates that is right for coloured residuals."""

from __future__ import annotations

import numpy as np


def newey_west(influences: np.ndarray, record: np.ndarray | None = None, lags: int = 1) -> np.ndarray:
    r"""Heteroscedasticity and autocorrelation consistent covariance (Newey and West, 1987).

    .. math:: V = \sum_b u_b u_b^T + \sum_{l=1}^{L} (1 - \tfrac{l}{L+1}) \sum_b (u_b u_{b-l}^T + u_{b-l} u_b^T)

    Parameters
    ----------
    influences : ndarray of shape (n_pieces, n_parameters)
        By how much each consecutive piece of the data moves the estimate.
    record : ndarray of shape (n_pieces,), optional
        Number of the record of each piece; pieces of different records are independent.
    lags : int
        Neighbours that may be correlated; pieces are far longer than the residual remembers, so few.

    Returns
    -------
    ndarray of shape (n_parameters, n_parameters)

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.estimation import newey_west
    >>> u = np.random.default_rng(0).normal(size=(4000, 1))  # independent pieces
    >>> round(float(newey_west(u, lags=3)[0, 0] / 4000), 1)
    1.0
    """
    u = influences - influences.mean(axis=0)
    total = u.T @ u
    for lag in range(1, min(lags, len(u) - 1) + 1):
        same = np.ones(len(u) - lag) if record is None else (record[lag:] == record[:-lag]).astype(float)
        cross = (u[lag:] * same[:, None]).T @ u[:-lag]
        total += (1 - lag / (lags + 1)) * (cross + cross.T)
    return total
