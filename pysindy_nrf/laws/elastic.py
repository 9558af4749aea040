"""Linear and Duffing elements."""

from __future__ import annotations

from .base import ForceLaw, Term


class LinearElastic(ForceLaw):
    """Linear spring, ``R = k s``.

    Parameters
    ----------
    k : float, optional
        Stiffness, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LinearElastic(k=1e5).equation(1))
    1e+05 s1
    """

    name = "linear_elastic"
    family = "stiffness"
    passive = True
    variable = "s"

    def __init__(self, k: float | None = None) -> None:
        super().__init__(coefficients={"k": k})

    def terms(self) -> tuple[Term, ...]:
        """One term, s."""
        return (Term("k", "s", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s


class LinearViscous(ForceLaw):
    """Linear dashpot, ``R = c v``.

    Parameters
    ----------
    c : float, optional
        Damping, N s/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LinearViscous(c=100.0).equation(1))
    100 v1
    """

    name = "linear_viscous"
    family = "damping"
    passive = True
    variable = "v"

    def __init__(self, c: float | None = None) -> None:
        super().__init__(coefficients={"c": c})

    def terms(self) -> tuple[Term, ...]:
        """One term, v."""
        return (Term("c", "v", "N s/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v


class Duffing(ForceLaw):
    """Linear and cubic spring, ``R = k s + k3 s^3``.

    Parameters
    ----------
    k : float, optional
        Linear stiffness, N/m.
    k3 : float, optional
        Cubic stiffness, N/m^3.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.Duffing(k=1e5, k3=1e9).equation(1))
    1e+05 s1 + 1e+09 s1^3
    """

    name = "duffing"
    family = "stiffness"
    passive = True
    variable = "s"

    def __init__(self, k: float | None = None, k3: float | None = None) -> None:
        super().__init__(coefficients={"k": k, "k3": k3})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, s and s^3."""
        return (Term("k", "s", "N/m"), Term("k3", "s^3", "N/m^3"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = s * s * s
