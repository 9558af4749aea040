"""Effects that cannot be: friction that drives, a brace that pushes, a gap that pulls, an inertance below zero."""

from __future__ import annotations

import numpy as np

from ..laws.base import ForceLaw

# Families whose laws take energy out, or store it, with coefficients that are not negative.
_POSITIVE = ("friction", "hysteresis", "link")
_POSITIVE_LAWS = (
    "one_sided_gap",
    "preloaded_contact",
    "two_sided_gap",
    "dead_zone",
    "quadratic_damping",
    "power_law_damping",
    "inerter",
)
# Laws whose second coefficient may have either sign.
_FREE_LAWS = ("stribeck_friction",)
_SLACK = 0.1


def admissible(law: ForceLaw, coefficients: np.ndarray, sizes: np.ndarray) -> bool:
    """Whether the coefficients of an undeclared effect can be real."""
    if law.covariates and law.name != "ground_friction":
        return True
    if law.family not in _POSITIVE and law.name not in _POSITIVE_LAWS:
        return True
    parts = coefficients * sizes
    if law.name in _FREE_LAWS:
        return bool(parts[0] > 0)
    return bool(parts.min() >= -_SLACK * np.abs(parts).max())
