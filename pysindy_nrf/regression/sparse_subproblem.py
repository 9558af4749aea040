"""Running a PySINDy optimizer on one scaled sub-problem: its limits named in one place."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from sklearn.base import clone

from ..exceptions import NRFError, NRFWarning


def fit_inner(optimizer: Any, columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Fit a clone of an optimizer and return its coefficients."""
    if getattr(optimizer, "bagging", False):
        raise NRFError(
            f"{type(optimizer).__name__}(bagging=True) draws samples, but each sub-problem is a triangular factor of "
            "all samples",
            "Use library_ensemble=True, or bootstrap over records.",
        )
    if not hasattr(optimizer, "fit") or isinstance(optimizer, type):
        raise NRFError(
            f"optimizer={optimizer!r} is not an optimizer", "Give an instance, e.g. pysindy.STLSQ(threshold=0.01)."
        )
    fresh = clone(optimizer)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fresh.fit(columns, target.reshape(-1, 1))
    for message in caught:
        if "eliminated all" in str(message.message):
            warnings.warn(
                f"{type(optimizer).__name__}: no term of a balance reached the threshold; its law is zero.",
                NRFWarning,
                stacklevel=3,
            )
    coefficients = np.asarray(fresh.coef_, dtype=float).ravel()
    if not np.isfinite(coefficients).all():
        raise NRFError(f"{type(optimizer).__name__} returned coefficients that are not finite", "Check its parameters.")
    return coefficients
