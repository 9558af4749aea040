"""Coefficients of the explicit Runge-Kutta rules."""

from __future__ import annotations

from functools import cache

import numpy as np


@cache
def rule_of(method: str) -> tuple[np.ndarray, ...]:
    """Coefficients a, b, c and weights e3, e5 of the embedded errors: SciPy's DOP853, or the classical rule."""
    if method == "classical":
        a = np.zeros((4, 4))
        a[1, 0] = a[2, 1] = 0.5
        a[3, 2] = 1.0
        return a, np.array([1, 2, 2, 1]) / 6, np.array([0, 0.5, 0.5, 1]), np.zeros(4), np.zeros(4)
    from scipy.integrate import DOP853

    s = DOP853.n_stages
    return tuple(
        np.ascontiguousarray(m) for m in (DOP853.A[:s, :s], DOP853.B, DOP853.C[:s], DOP853.E3[:s], DOP853.E5[:s])
    )
