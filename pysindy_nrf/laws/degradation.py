"""Elements that change during a record; t is the time on its clock."""

from __future__ import annotations

import numpy as np

from .base import ForceLaw, Shape, Term


class StiffnessStep(ForceLaw):
    """Stiffness that changes at once, ``R = dk s`` after time t0.

    Parameters
    ----------
    t0 : float, optional
        Time of the change on the clock of the record, s; estimated if None.
    dk : float, optional
        Stiffness after minus stiffness before, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.StiffnessStep(t0=12.0, dk=-2e4).equation(2))
    -2e+04 s2 [t > t0]  (t0 = 12)
    """

    name = "stiffness_step"
    family = "degradation"
    shapes = (Shape("t0", "s", 0.05, 0.95, "t", log=False, instant=True),)
    uses_time = True
    permanent_change = True

    def __init__(self, t0: float | None = None, dk: float | None = None) -> None:
        super().__init__({"t0": t0}, {"dk": dk})

    def terms(self) -> tuple[Term, ...]:
        """One term, s after t0."""
        return (Term("dk", "s [t > t0]", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * np.maximum(np.sign(t - theta[0]), 0.0)


class StiffnessDrift(ForceLaw):
    """Stiffness that changes steadily, ``R = kt s t``.

    Parameters
    ----------
    kt : float, optional
        Rate of change of the stiffness, N/(m s).

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.StiffnessDrift(kt=-300.0).equation(2))
    -300 s2 t
    """

    name = "stiffness_drift"
    family = "degradation"
    uses_time = True
    permanent_change = True

    def __init__(self, kt: float | None = None) -> None:
        super().__init__(coefficients={"kt": kt})

    def terms(self) -> tuple[Term, ...]:
        """One term, s t."""
        return (Term("kt", "s t", "N/(m s)"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * t


class DampingDrift(ForceLaw):
    """Damping that changes steadily, ``R = ct v t``: a damper that warms up or leaks.

    Parameters
    ----------
    ct : float, optional
        Rate of change of the damping, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.DampingDrift(ct=-5.0).equation(2))
    -5 v2 t
    """

    name = "damping_drift"
    family = "degradation"
    uses_time = True
    passive = True
    permanent_change = True

    def __init__(self, ct: float | None = None) -> None:
        super().__init__(coefficients={"ct": ct})

    def terms(self) -> tuple[Term, ...]:
        """One term, v t."""
        return (Term("ct", "v t", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * t
