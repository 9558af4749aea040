"""Nonlinear damping."""

from __future__ import annotations

import numpy as np

from .base import ForceLaw, Shape, Term


class QuadraticDamping(ForceLaw):
    """Quadratic damping, ``R = c2 v |v|``: drag of a turbulent fluid (Morison).

    Parameters
    ----------
    c2 : float, optional
        Coefficient, N s^2/m^2.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.QuadraticDamping(c2=30.0).equation(2))
    30 v2 |v2|
    """

    name = "quadratic_damping"
    family = "damping"
    passive = True
    variable = "v"
    nonnegative = ("c2",)

    def __init__(self, c2: float | None = None) -> None:
        super().__init__(coefficients={"c2": c2})

    def terms(self) -> tuple[Term, ...]:
        """One term, ``v |v|``."""
        return (Term("c2", "v |v|", "N s^2/m^2"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * np.abs(v)


class PowerLawDamping(ForceLaw):
    r"""Power-law damping, ``R = cn sgn(v) |v|^n``.

    Fluid viscous dampers have n between 0.3 and 1 (Constantinou and Symans, 1993); n = 0 is Coulomb
    friction, n = 1 linear and n = 2 quadratic damping.

    Parameters
    ----------
    n : float, optional
        Exponent, positive; estimated if None.
    cn : float, optional
        Coefficient, N s^n/m^n.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.PowerLawDamping(n=0.5, cn=200.0).equation(1))
    200 sgn(v1) |v1|^n  (n = 0.5)
    """

    name = "power_law_damping"
    family = "damping"
    # the fluid dampers of the literature begin with n = 0.3
    shapes = (Shape("n", "1", 0.15, 4.0, friction_below=0.25),)
    passive = True
    variable = "v"
    nonnegative = ("cn",)
    special_cases = {QuadraticDamping: lambda c: PowerLawDamping(n=2.0, cn=c.values[0])}

    def __init__(self, n: float | None = None, cn: float | None = None) -> None:
        super().__init__({"n": n}, {"cn": cn})

    def terms(self) -> tuple[Term, ...]:
        """One term, ``sgn(v) |v|^n``."""
        return (Term("cn", "sgn(v) |v|^n", "N s^n/m^n"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v) * np.abs(v) ** theta[0]


class DisplacementDependentDamping(ForceLaw):
    """Damping that grows with the drift, ``R = c s^2 v`` (van der Pol).

    Parameters
    ----------
    c : float, optional
        Coefficient, N s/m^3.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.DisplacementDependentDamping(c=1e6).equation(1))
    1e+06 v1 s1^2
    """

    name = "displacement_dependent_damping"
    family = "damping"
    passive = True
    variable = "v"

    def __init__(self, c: float | None = None) -> None:
        super().__init__(coefficients={"c": c})

    def terms(self) -> tuple[Term, ...]:
        """One term, v s^2."""
        return (Term("c", "v s^2", "N s/m^3"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * s * s
