"""Effects that cannot be: friction that drives, a gap that pulls, an inertance below zero."""

from __future__ import annotations

import numpy as np

from ..laws.base import ForceLaw

_SLACK = 0.1


def admissible(law: ForceLaw, coefficients: np.ndarray, sizes: np.ndarray) -> bool:
    """Whether the coefficients of an undeclared effect can be real."""
    held = [term.symbol in law.nonnegative for term in law.terms()]
    if not any(held):
        return True
    parts = (coefficients * sizes)[held]
    return bool(parts.min() >= -_SLACK * np.abs(parts).max())
