"""The jackknife: what leaving out one part of the data after the other says of an estimate."""

from __future__ import annotations

from typing import Any

import numpy as np


def variance(values: Any) -> np.ndarray:
    """Variance of an estimate from what it is with each of n parts of the data left out.

    ``(n - 1) / n`` times the sum of the squared deviations from their mean (B. Efron, The Jackknife, the Bootstrap
    and Other Resampling Plans, SIAM, 1982, chapter 3). Parts must be long beside the memory of the noise.

    Parameters
    ----------
    values : array-like of shape (n_parts, ...)
        The estimate without each part.

    Returns
    -------
    ndarray of shape (...)
        In the square of their unit.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.common.jackknife import variance
    >>> weighed = np.array([12.1, 12.6, 12.4, 12.5])  # kg
    >>> without = (weighed.sum() - weighed) / 3  # the mean without each
    >>> float(np.sqrt(variance(without)).round(6)), float((weighed.std(ddof=1) / 2).round(6))
    (0.108012, 0.108012)
    """
    values = np.asarray(values)
    n = len(values)
    return (n - 1) / n * ((values - values.mean(axis=0)) ** 2).sum(axis=0)
