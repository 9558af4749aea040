"""Laws that remember the path: Dahl and the paper's modified Dahl."""

from __future__ import annotations

import math

from .base import ForceLaw, Shape, Term

_SIGMA = Shape("sigma", "1/m", 0.03, 3000.0, "1/s")


class Dahl(ForceLaw):
    r"""Dahl friction, ``R = Fd Z``.

    .. math:: \dot Z = \sigma \dot s \, (1 - Z \operatorname{sgn} \dot s)

    (paper eq. 7). Along a path without reversal the state has the exact solution
    ``Z = sgn + (Z_0 - sgn) exp(-sigma |s - s_0|)``, which is how it is moved.

    Parameters
    ----------
    sigma : float, optional
        Shape of the loop, 1/m (the paper prints s/m for the same number); estimated if None.
    Fd : float, optional
        Friction force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> law = laws.Dahl(sigma=5e4, Fd=34.85)
    >>> law.n_states, law.parameters
    (1, {'sigma': 50000.0, 'Fd': 34.85})
    """

    name = "dahl"
    family = "hysteresis"
    shapes = (_SIGMA,)
    n_states = 1
    passive = True
    nonnegative = ("Fd",)
    saturates_at = "sigma"

    def __init__(self, sigma: float | None = None, Fd: float | None = None) -> None:
        super().__init__({"sigma": sigma}, {"Fd": Fd})

    def terms(self) -> tuple[Term, ...]:
        """One term, Z."""
        return (Term("Fd", "Z", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        ds = s1 - s0  # one exponential and no branch: nothing moves where ds = 0
        z[0] += (math.copysign(1.0, ds) - z[0]) * (1.0 - math.exp(-theta[0] * abs(ds)))


class ModifiedDahl(ForceLaw):
    r"""The paper's damper (eqs. 6-7), ``R = K0 s + C0 v + Fd Z + f0``.

    f0 is a constant that the power series of eq. (2) cannot hold.

    Parameters
    ----------
    K0 : float, optional
        Stiffness, N/m.
    C0 : float, optional
        Damping, N s/m.
    Fd : float, optional
        Friction force, N.
    f0 : float, optional
        Initial force, N.
    sigma : float, optional
        Shape of the loop, 1/m (the paper prints s/m for the same number); estimated if None.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> damper = laws.ModifiedDahl(K0=50.0, C0=399.0, Fd=34.85, f0=0.0, sigma=5e4)
    >>> print(damper.equation(1))
    50 s1 + 399 v1 + 34.85 Z1 + 0  (sigma = 5e+04)
    """

    name = "modified_dahl"
    family = "hysteresis"
    shapes = (_SIGMA,)
    n_states = 1
    symmetry = "none"
    at_rest = None
    nonnegative = ("K0", "C0", "Fd")
    saturates_at = "sigma"
    special_cases = {Dahl: lambda c: ModifiedDahl(0.0, 0.0, c.values[0], 0.0, c.theta[0])}

    def __init__(
        self,
        K0: float | None = None,
        C0: float | None = None,
        Fd: float | None = None,
        f0: float | None = None,
        sigma: float | None = None,
    ) -> None:
        super().__init__({"sigma": sigma}, {"K0": K0, "C0": C0, "Fd": Fd, "f0": f0})

    def terms(self) -> tuple[Term, ...]:
        """Four terms: s, v, Z and 1."""
        return (
            Term("K0", "s", "N/m"),
            Term("C0", "v", "N s/m"),
            Term("Fd", "Z", "N"),
            Term("f0", "1", "N"),
        )

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = v
        out[2] = z[0]
        out[3] = 1.0

    advance = staticmethod(Dahl.advance)
