"""Nonlinear springs; they store energy and give all of it back."""

from __future__ import annotations

import numpy as np

from .base import ForceLaw, Term


class QuadraticStiffness(ForceLaw):
    """Quadratic spring, ``R = k2 s^2``: stiffer to one side than to the other (a cable, an arch).

    Parameters
    ----------
    k2 : float, optional
        Coefficient, N/m^2.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.QuadraticStiffness(k2=1e6).equation(1))
    1e+06 s1^2
    """

    name = "quadratic_stiffness"
    family = "stiffness"
    symmetry = "even"
    passive = True
    variable = "s"

    def __init__(self, k2: float | None = None) -> None:
        super().__init__(coefficients={"k2": k2})

    def terms(self) -> tuple[Term, ...]:
        """One term, s^2."""
        return (Term("k2", "s^2", "N/m^2"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * s


class AbsoluteQuadraticStiffness(ForceLaw):
    """Odd quadratic spring, ``R = k2 s |s|``.

    Parameters
    ----------
    k2 : float, optional
        Coefficient, N/m^2.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.AbsoluteQuadraticStiffness(k2=1e6).equation(1))
    1e+06 s1 |s1|
    """

    name = "absolute_quadratic_stiffness"
    family = "stiffness"
    passive = True
    variable = "s"

    def __init__(self, k2: float | None = None) -> None:
        super().__init__(coefficients={"k2": k2})

    def terms(self) -> tuple[Term, ...]:
        """One term, ``s |s|``."""
        return (Term("k2", "s |s|", "N/m^2"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * np.abs(s)


class CubicStiffness(ForceLaw):
    """Cubic spring, ``R = k3 s^3``: hardening for k3 > 0, softening for k3 < 0.

    Parameters
    ----------
    k3 : float, optional
        Coefficient, N/m^3.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.CubicStiffness(k3=1e9).equation(1))
    1e+09 s1^3
    """

    name = "cubic_stiffness"
    family = "stiffness"
    passive = True
    variable = "s"

    def __init__(self, k3: float | None = None) -> None:
        super().__init__(coefficients={"k3": k3})

    def terms(self) -> tuple[Term, ...]:
        """One term, s^3."""
        return (Term("k3", "s^3", "N/m^3"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * s * s


class QuinticStiffness(ForceLaw):
    """Quintic spring, ``R = k5 s^5``.

    Parameters
    ----------
    k5 : float, optional
        Coefficient, N/m^5.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.QuinticStiffness(k5=1e13).equation(1))
    1e+13 s1^5
    """

    name = "quintic_stiffness"
    family = "stiffness"
    passive = True
    variable = "s"

    def __init__(self, k5: float | None = None) -> None:
        super().__init__(coefficients={"k5": k5})

    def terms(self) -> tuple[Term, ...]:
        """One term, s^5."""
        return (Term("k5", "s^5", "N/m^5"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        square = s * s
        out[0] = square * square * s
