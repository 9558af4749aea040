"""Forces that act on a DOF from outside and were not measured.

As every law they stand on the left of ``m a + R = F``: an applied force f that is missing from F
appears here as ``R = -f``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .base import ForceLaw, Shape, Term, covariate_name


class HarmonicForce(ForceLaw):
    r"""Harmonic force of an unknown frequency: a machine, a fan, the mains.

    .. math:: R = A \cos(2 \pi f t) + B \sin(2 \pi f t)

    t is the time on the clock of the record; records pooled in one fit share one phase.

    Parameters
    ----------
    frequency : float, optional
        Frequency f, Hz; estimated if None.
    A, B : float, optional
        Parts in and out of phase, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.HarmonicForce(frequency=50.0, A=3.0, B=4.0).equation())
    3 cos(2 pi frequency t) + 4 sin(2 pi frequency t)  (frequency = 50)
    """

    name = "harmonic_force"
    family = "forcing"
    shapes = (Shape("frequency", "1/s", 0.01, 2.0, "v/s"),)
    symmetry = "even"
    at_rest = None
    uses_time = True
    acts_at = ("dof",)
    superposes = True

    def __init__(self, frequency: float | None = None, A: float | None = None, B: float | None = None) -> None:
        super().__init__({"frequency": frequency}, {"A": A, "B": B})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, cosine and sine."""
        return (Term("A", "cos(2 pi frequency t)", "N"), Term("B", "sin(2 pi frequency t)", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        phase = 2.0 * np.pi * theta[0] * t
        out[0] = np.cos(phase)
        out[1] = np.sin(phase)


class ConstantForce(ForceLaw):
    """Constant force, ``R = f0``: a dead load, an offset of a force or acceleration sensor.

    Parameters
    ----------
    f0 : float, optional
        Force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.ConstantForce(f0=-3.2).equation(1))
    -3.2
    """

    name = "constant_force"
    family = "forcing"
    symmetry = "even"
    at_rest = None
    acts_at = ("dof", "link")
    variable = "1"
    superposes = True

    def __init__(self, f0: float | None = None) -> None:
        super().__init__(coefficients={"f0": f0})

    def terms(self) -> tuple[Term, ...]:
        """One term, 1."""
        return (Term("f0", "1", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = 0.0 * s + 1.0


class BaseMotion(ForceLaw):
    """Base motion that leaks into a balance, ``R = m ag``.

    With motions relative to the base, a base acceleration left out of the balance of DOF j is
    missing there as ``m_j ag``.

    Parameters
    ----------
    m : float, optional
        Mass that follows the base, kg.
    covariate : str
        Name of the channel that holds the acceleration of the base, m/s^2.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.BaseMotion(m=12.4).equation(2))
    12.4 ag
    """

    name = "base_motion"
    family = "forcing"
    symmetry = "even"
    at_rest = None
    acts_at = ("dof",)
    covariate_units = ("m/s^2",)
    mimics_inertia = True
    superposes = True

    def __init__(self, m: float | None = None, covariate: str = "ag") -> None:
        self.covariates = (covariate_name(covariate),)
        super().__init__(coefficients={"m": m})

    def options(self) -> dict[str, Any]:
        """Structural arguments: the covariate."""
        return {"covariate": self.covariates[0]}

    def terms(self) -> tuple[Term, ...]:
        """One term, the base acceleration."""
        return (Term("m", self.covariates[0], "kg"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = u[0]
