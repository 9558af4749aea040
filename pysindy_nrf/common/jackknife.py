"""The jackknife."""

from typing import Any

import numpy as np


def variance(values: Any) -> np.ndarray:
    """Variance of an estimate from its n values, each with one part of the data left out."""
    values = np.asarray(values)
    n = len(values)
    return (n - 1) / n * ((values - values.mean(axis=0)) ** 2).sum(axis=0)
