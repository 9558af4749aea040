"""Forces proportional to acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .base import ForceLaw, Term


def total_masses(masses: Any, laws: Mapping[Any, Sequence[ForceLaw]]) -> np.ndarray:
    """Mass of every DOF with what laws at it add or take away."""
    total = np.array(masses, dtype=float)
    for site, group in laws.items():
        if site.kind == "dof":
            for law in group:
                added = zip(law.terms(), law.values, strict=True)
                total[site.p - 1] += sum(c for term, c in added if term.label == "a")
    return total


class AddedMass(ForceLaw):
    """Mass that the model lacks at a DOF, ``R = dm a``: a wrong known mass, a load, moved water.

    Parameters
    ----------
    dm : float, optional
        Missing mass, kg; negative where the model has too much. Where it takes away all that the DOF has, a fit warns
        and a free run is refused.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.AddedMass(dm=1.5).equation(2))
    1.5 a2
    """

    name = "added_mass"
    family = "inertia"
    passive = True
    uses_acceleration = True
    acts_at = ("dof",)
    variable = "a"
    mimics_inertia = True

    def __init__(self, dm: float | None = None) -> None:
        super().__init__(coefficients={"dm": dm})

    def terms(self) -> tuple[Term, ...]:
        """One term, a."""
        return (Term("dm", "a", "kg"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = a


class Inerter(ForceLaw):
    """Inerter between two DOFs, ``R = b a`` with a their relative acceleration.

    (Smith, IEEE Trans. Automatic Control 47, 2002.)

    Parameters
    ----------
    b : float, optional
        Inertance, kg.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.Inerter(b=40.0).equation(2))
    40 a2
    """

    name = "inerter"
    family = "inertia"
    passive = True
    uses_acceleration = True
    variable = "a"
    mimics_inertia = True
    nonnegative = ("b",)

    def __init__(self, b: float | None = None) -> None:
        super().__init__(coefficients={"b": b})

    def terms(self) -> tuple[Term, ...]:
        """One term, a."""
        return (Term("b", "a", "kg"),)

    kernel = staticmethod(AddedMass.kernel)
