"""LuGre friction."""

from __future__ import annotations

import math

import numpy as np

from .base import ForceLaw, Shape, Term
from .hysteresis import Dahl


class LuGre(ForceLaw):
    r"""LuGre friction: bristles that bend before they slip, and a Stribeck fall.

    .. math::
        R = F_c Z + \sigma_1 \dot z, \quad z = Z / \sigma, \quad
        \dot Z = \sigma \left(\dot s - \frac{|\dot s|}{h(\dot s)} Z\right), \quad
        h = 1 + (F_s / F_c - 1) \, e^{-(\dot s / v_s)^2}

    (Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic Control 40, 1995, with
    ``sigma_0 = Fc sigma``; its viscous part is :class:`LinearViscous`). With Fs = Fc and without
    sigma1 it is :class:`Dahl`. The state is moved exactly where h is constant; over a change of
    speed, h is held over short parts of it.

    Parameters
    ----------
    sigma : float, optional
        Bristle stiffness over sliding force, 1/m; estimated if None.
    vs : float, optional
        Stribeck velocity, m/s; estimated if None.
    ratio : float, optional
        Static over sliding level, Fs / Fc; estimated if None.
    Fc : float, optional
        Sliding friction force, N.
    sigma1 : float, optional
        Damping of the bristles, N s/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LuGre(sigma=1e4, vs=0.01, ratio=1.5, Fc=20.0, sigma1=50.0).equation(1))
    20 LuGre[s1] + 50 d/dt bristle[s1]  (sigma = 1e+04, vs = 0.01, ratio = 1.5)
    """

    name = "lugre"
    family = "hysteresis"
    shapes = (
        Shape("sigma", "1/m", 0.1, 3000.0, "1/s"),
        Shape("vs", "m/s", 0.02, 2.0, "v"),
        Shape("ratio", "1", 1.05, 3.0),
    )
    n_states = 1
    nonnegative = ("Fc", "sigma1")
    saturates_at = "sigma"
    special_cases = {Dahl: lambda c: LuGre(c.theta[0], vs=1.0, ratio=1.0, Fc=c.values[0], sigma1=0.0)}

    def __init__(
        self,
        sigma: float | None = None,
        vs: float | None = None,
        ratio: float | None = None,
        Fc: float | None = None,
        sigma1: float | None = None,
    ) -> None:
        super().__init__({"sigma": sigma, "vs": vs, "ratio": ratio}, {"Fc": Fc, "sigma1": sigma1})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, the bending of the bristles and its rate."""
        return (Term("Fc", "LuGre[s]", "N"), Term("sigma1", "d/dt bristle[s]", "N s/m"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        fall = np.minimum(np.abs(v) / theta[1], 26.0)
        level = 1.0 + (theta[2] - 1.0) * np.exp(-fall * fall)
        out[0] = z[0]
        out[1] = v - np.abs(v) * z[0] / level

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        ds = s1 - s0
        if ds == 0.0:
            return
        sign = math.copysign(1.0, ds)
        a0, a1 = abs(v0), abs(v1)
        # parts in which the speed changes by a small share of vs; further out h is constant
        parts = 1 + int(min(16.0 * abs(a1 - a0) / theta[1], 127.0))
        total = 0.5 * (a0 + a1)
        for i in range(parts):
            speed = a0 + (a1 - a0) * (i + 0.5) / parts
            share = speed / total / parts if total > 0.0 else 1.0 / parts
            fall = min(speed / theta[1], 26.0)
            level = 1.0 + (theta[2] - 1.0) * math.exp(-fall * fall)
            top = sign * level
            z[0] = top + (z[0] - top) * math.exp(-theta[0] * abs(ds) * share / level)
