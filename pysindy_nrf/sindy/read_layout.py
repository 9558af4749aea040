"""The layout of a chain, read off the columns of its power series.

In ``ps.SINDy`` an optimizer gets numbers alone, and a search clones library and
optimizer apart. The series of a storey begins with v and s, and every other column of
it is a product of powers of these two.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from ..laws.power_series import exponents_of
from ..selection.one_se_rule import Degree

# Samples that are looked at; a product agrees with none of them by chance.
N_SAMPLES = 64
# Round-off of a product of powers, in units of the last place.
ROUND_OFF = 100
# Highest power that is looked for.
MAX_POWER = 12


def read_series(columns: np.ndarray, n_sites: int) -> list[Degree] | None:
    """Orders of the power series at the sites, None if the columns are no such series.

    Parameters
    ----------
    columns : ndarray of shape (n_samples, n_terms)
    n_sites : int
    """
    finite = np.flatnonzero(np.isfinite(columns).all(axis=1))
    step = max(len(finite) // N_SAMPLES, 1)
    samples = columns[finite[::step]].T
    if len(finite) < 2 or not samples.any(axis=1).all():
        return None

    orders: list[Degree] = []
    start = 0
    while start < len(samples):
        order = _series_at_start(samples[start:])
        if order is None:
            return None
        orders.append(order)
        start += len(exponents_of(order))
    return orders if len(orders) == n_sites else None


@lru_cache(1)
def _orders() -> list[Degree]:
    """Orders that begin with v and s, the largest first."""
    powers = range(1, MAX_POWER + 1)
    orders: list[Degree] = [*powers, *product(powers, powers)]
    return sorted(orders, key=lambda order: -len(exponents_of(order)))


def _series_at_start(samples: np.ndarray) -> Degree | None:
    """Order of the largest series with which some columns begin."""
    for order in _orders():
        exponents = exponents_of(order)
        if len(exponents) <= len(samples) and _is_series(samples, exponents):
            return order
    return None


def _is_series(samples: np.ndarray, exponents: tuple[tuple[int, int], ...]) -> bool:
    """Whether columns are these products of powers of the first two."""
    v, s = samples[:2].astype(float)
    tolerance = ROUND_OFF * np.finfo(samples.dtype).eps
    for column, (h, j) in zip(samples, exponents):
        if not np.allclose(column, v**h * s**j, rtol=tolerance, atol=0.0):
            return False
    return True
