"""Elasto-plastic laws: springs in series with sliders."""

from __future__ import annotations

from .base import ForceLaw, Shape, Term


class Jenkins(ForceLaw):
    r"""Elasto-plastic element (Jenkin 1922): a spring in series with a Coulomb slider.

    .. math:: R = F_y Z, \quad \dot Z = \dot s / u_y \text{ while } |Z| < 1 \text{ or unloading, else } 0

    The stop operator: along a path without reversal ``Z = min(max(Z_0 + (s - s_0) / u_y, -1), 1)``,
    exactly. Its elastic stiffness is ``Fy / uy``.

    Parameters
    ----------
    uy : float, optional
        Yield drift, m; estimated if None.
    Fy : float, optional
        Yield force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.Jenkins(uy=0.001, Fy=20.0).equation(1))
    20 Jenkins[s1]  (uy = 0.001)
    """

    name = "jenkins"
    family = "hysteresis"
    shapes = (Shape("uy", "m", 0.01, 4.0, "s"),)
    n_states = 1
    passive = True
    nonnegative = ("Fy",)
    saturates_at = "uy"

    def __init__(self, uy: float | None = None, Fy: float | None = None) -> None:
        super().__init__({"uy": uy}, {"Fy": Fy})

    def terms(self) -> tuple[Term, ...]:
        """One term, the slider's share of its yield force."""
        return (Term("Fy", "Jenkins[s]", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        z[0] = min(max(z[0] + (s1 - s0) / theta[0], -1.0), 1.0)


class Iwan(ForceLaw):
    r"""Two elasto-plastic elements side by side (Iwan, J. Appl. Mech. 33, 1966).

    .. math:: R = F_1 Z_1 + F_2 Z_2

    with :class:`Jenkins` states of yield drift ``uy`` and ``ratio * uy``: a joint that slips bit by
    bit before it slips as a whole.

    Parameters
    ----------
    uy : float, optional
        Yield drift of the first element, m; estimated if None.
    ratio : float, optional
        Yield drift of the second over that of the first; estimated if None.
    F1, F2 : float, optional
        Yield forces, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.Iwan(uy=0.001, ratio=4.0, F1=10.0, F2=20.0).parameters
    {'uy': 0.001, 'ratio': 4.0, 'F1': 10.0, 'F2': 20.0}
    """

    name = "iwan"
    family = "hysteresis"
    shapes = (Shape("uy", "m", 0.01, 2.0, "s"), Shape("ratio", "1", 1.5, 20.0))
    n_states = 2
    passive = True
    nonnegative = ("F1", "F2")
    saturates_at = "uy"
    special_cases = {Jenkins: lambda c: Iwan(uy=c.theta[0], ratio=2.0, F1=c.values[0], F2=0.0)}

    def __init__(
        self,
        uy: float | None = None,
        ratio: float | None = None,
        F1: float | None = None,
        F2: float | None = None,
    ) -> None:
        super().__init__({"uy": uy, "ratio": ratio}, {"F1": F1, "F2": F2})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, one for each slider."""
        return (Term("F1", "Jenkins[s; uy]", "N"), Term("F2", "Jenkins[s; ratio uy]", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]
        out[1] = z[1]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        step = (s1 - s0) / theta[0]
        z[0] = min(max(z[0] + step, -1.0), 1.0)
        z[1] = min(max(z[1] + step / theta[1], -1.0), 1.0)
