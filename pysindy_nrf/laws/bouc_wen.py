"""Bouc-Wen hysteresis."""

from __future__ import annotations

import math

from .base import ForceLaw, Shape, Term
from .hysteresis import Dahl


class BoucWen(ForceLaw):
    r"""Bouc-Wen hysteresis.

    .. math::
        R = \alpha w, \quad
        \dot w = \dot s \, \left[ 1 - (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n \right]

    (Bouc 1967, Wen 1976.) alpha is the initial stiffness, 1/beta the length over which the loop
    bends; ``1 + rho > 0`` softens while loading and ``1 + rho < 0`` hardens without a limit, for
    which the state is bounded at ``beta |w| = 1e6``. It only takes energy out for ``|rho| <= 1``.

    ============================================================  ==============================
    published form                                                here
    ============================================================  ==============================
    ``w' = v - b |v| |w|^(n-1) w - g v |w|^n`` (Wen, A = 1)       ``beta = b^(1/n)``, ``rho = g / b``
    ``z' = al v - be (ga |v| |z|^(nu-1) z + de v |z|^nu)``,       ``alpha = al``, ``n = nu``,
    force z (Noel and Schoukens 2016)                             ``beta^n = be ga al^(n-1)``, ``rho = de / ga``
    ============================================================  ==============================

    For n = 1 the state is moved exactly along a path without reversal, otherwise by a fourth-order
    rule in parts short enough for a relative error of about 1e-6 inside the loop.

    Parameters
    ----------
    beta : float, optional
        Inverse length, 1/m, positive; estimated if None.
    rho : float, optional
        The gamma of Wen over his beta, of either sign; estimated if None.
    n : float, optional
        Sharpness of the transition, at least 1; estimated if None.
    alpha : float, optional
        Stiffness of the hysteretic part, N/m.

    Examples
    --------
    The published benchmark (alpha = 5e4, beta = 1e3, gamma = 0.8, delta = -1.1, nu = 1):

    >>> from pysindy_nrf import laws
    >>> print(laws.BoucWen(beta=1e3 * 0.8, rho=-1.1 / 0.8, n=1.0, alpha=5e4).equation(1))
    5e+04 BoucWen[s1]  (beta = 800, rho = -1.375, n = 1)
    """

    name = "bouc_wen"
    family = "hysteresis"
    shapes = (
        Shape("beta", "1/m", 0.03, 100.0, "1/s"),
        Shape("rho", "1", -2.0, 1.0, log=False),
        Shape("n", "1", 1.0, 4.0),
    )
    n_states = 1
    nonnegative = ("alpha",)
    special_cases = {Dahl: lambda c: BoucWen(c.theta[0], rho=0.0, n=1.0, alpha=c.theta[0] * c.values[0])}

    def __init__(
        self,
        beta: float | None = None,
        rho: float | None = None,
        n: float | None = None,
        alpha: float | None = None,
    ) -> None:
        super().__init__({"beta": beta, "rho": rho, "n": n}, {"alpha": alpha})

    def terms(self) -> tuple[Term, ...]:
        """One term, the hysteretic drift w in metres."""
        return (Term("alpha", "BoucWen[s]", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0] / theta[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        # y = +-beta w counts positive along the motion, x = beta |s - s0|: dy/dx = 1 - c |y|^n
        # with c = rho + 1 where y > 0 (loading) and c = rho - 1 where y < 0 (unloading)
        limit = 1e6
        sign = math.copysign(1.0, s1 - s0)
        x = theta[0] * abs(s1 - s0)
        rho = theta[1]
        n = theta[2]
        y = sign * z[0]
        if n == 1.0:
            if y < 0.0:
                c = 1.0 - rho
                slope = 1.0 - c * y
                if slope > 0.0:
                    x_zero = math.log(slope) / c if abs(c) > 1e-9 else -y
                else:
                    x_zero = math.inf
                if x_zero <= x:
                    y = 0.0
                    x -= x_zero
                else:
                    y += slope * (-math.expm1(min(-c * x, 30.0)) / c if abs(c) > 1e-9 else x)
                    x = 0.0
            if x > 0.0:
                c = 1.0 + rho
                y += (1.0 - c * y) * (-math.expm1(min(-c * x, 30.0)) / c if abs(c) > 1e-9 else x)
        else:
            for _ in range(20000):
                if x <= 0.0:
                    break
                c = 1.0 + rho if y >= 0.0 else rho - 1.0
                size = abs(y)
                power = size**n
                f1 = 1.0 - c * power
                if abs(f1) < 1e-13 or (abs(y) >= limit and f1 * y > 0.0):
                    break
                steep = 1.0 if size < 0.9 else power / size * (1.0 + 0.15 * (n - 1.0) / size)  # of |y|^(n-1) nearby
                h = min(x, 0.1 / (abs(c) * n * steep + 1.0 / max(1.0, size)))
                h = min(h, max(0.5 * size, 1e-3))  # |y|^n is not smooth at y = 0
                if h < 0.1 * size:  # four terms of Taylor's series: one power instead of four
                    inverse = 1.0 / y
                    d1 = -c * n * power * inverse
                    d2 = d1 * (n - 1.0) * inverse
                    d3 = d2 * (n - 2.0) * inverse
                    y4 = f1 * f1 * d3 + 4.0 * f1 * d1 * d2 + d1 * d1 * d1
                    y3 = f1 * d2 + d1 * d1 + 0.25 * h * y4
                    y += h * f1 * (1.0 + 0.5 * h * (d1 + h * y3 / 3.0))
                    x -= h
                    continue
                if y < 0.0 and y + h * f1 > 0.0:
                    # dx = dy / (1 - c |y|^n) up to y = 0, by Gauss's three points
                    x_zero = 0.0
                    x_zero -= y * 5.0 / 18.0 / (1.0 - c * (-y * 0.1127016653792583) ** n)
                    x_zero -= y * 8.0 / 18.0 / (1.0 - c * (-y * 0.5) ** n)
                    x_zero -= y * 5.0 / 18.0 / (1.0 - c * (-y * 0.8872983346207417) ** n)
                    if x_zero <= h:
                        y = 0.0
                        x -= x_zero
                        continue
                f2 = 1.0 - c * abs(y + 0.5 * h * f1) ** n
                f3 = 1.0 - c * abs(y + 0.5 * h * f2) ** n
                f4 = 1.0 - c * abs(y + h * f3) ** n
                y += h * (f1 + 2.0 * f2 + 2.0 * f3 + f4) / 6.0
                x -= h
        z[0] = sign * min(max(y, -limit), limit)
