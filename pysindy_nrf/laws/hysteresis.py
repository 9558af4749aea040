"""Hysteresis: Dahl and the paper's modified Dahl, elasto-plastic elements, LuGre,
Bouc-Wen.
"""

import math

import numpy as np

from .base import ForceLaw, Term
from .shape import Given, Shape

_SIGMA = Shape("sigma", "1/m", 0.03, 3000.0, "1/s")


class Element(ForceLaw):
    """Base of passive elements; they have one state, which is the force, unless they
    say otherwise.
    """

    family = "hysteresis"
    n_states = 1
    passive = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]


class Dahl(Element):
    r"""Dahl friction, ``R = Fd Z``.

    .. math:: \dot Z = \sigma \dot s \, (1 - Z \operatorname{sgn} \dot s)

    (paper eq. 7). Along a path without reversal the state has the exact solution
    ``Z = sgn + (Z_0 - sgn) exp(-sigma |s - s_0|)``, which is used for every step.

    Parameters
    ----------
    sigma : float, optional
        Shape of the loop, 1/m (the paper prints s/m for the same number); estimated if
        None.
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
    shapes = (_SIGMA,)
    columns = (Term("Fd", "Z", "N"),)
    nonnegative = ("Fd",)
    saturates_at = "sigma"

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        ds = s1 - s0  # no branch: the state stays where ds = 0
        z[0] += (math.copysign(1.0, ds) - z[0]) * (1.0 - math.exp(-theta[0] * abs(ds)))


class ModifiedDahl(ForceLaw):
    r"""The paper's damper (eqs. 6-7), ``R = K0 s + C0 v + Fd Z + f0``.

    f0 is a constant, which the power series of eq. (2) does not contain.

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
        Shape of the loop, 1/m (the paper prints s/m for the same number); estimated if
        None.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> damper = laws.ModifiedDahl(
    ...     K0=50.0, C0=399.0, Fd=34.85, f0=0.0, sigma=5e4
    ... )
    >>> print(damper.equation(1))
    50 s1 + 399 v1 + 34.85 Z1  (sigma = 5e+04 1/m)
    """

    name = "modified_dahl"
    family = "hysteresis"
    shapes = (_SIGMA,)
    columns = (
        Term("K0", "s", "N/m"),
        Term("C0", "v", "N s/m"),
        Term("Fd", "Z", "N"),
        Term("f0", "1", "N"),
    )
    n_states = 1
    symmetry = "none"
    at_rest = None
    nonnegative = ("K0", "C0", "Fd")
    saturates_at = "sigma"
    special_cases = {
        Dahl: lambda c: ModifiedDahl(0.0, 0.0, c.values[0], 0.0, c.theta[0])
    }

    def __init__(
        self,
        K0: Given = None,
        C0: Given = None,
        Fd: Given = None,
        f0: Given = None,
        sigma: Given = None,
    ) -> None:
        super().__init__({"sigma": sigma}, {"K0": K0, "C0": C0, "Fd": Fd, "f0": f0})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = v
        out[2] = z[0]
        out[3] = 1.0

    advance = staticmethod(Dahl.advance)


class Jenkins(Element):
    r"""Elasto-plastic element (Jenkin 1922): a spring in series with a Coulomb slider.

    .. math:: R = F_y Z, \quad \dot Z = \dot s / u_y \text{ while } |Z| < 1 \text{ or unloading, else } 0

    The stop operator: along a path without reversal ``Z = min(max(Z_0 + (s - s_0) /
    u_y, -1), 1)``, exactly. Its elastic stiffness is ``Fy / uy``.
    """

    name = "jenkins"
    shapes = (Shape("uy", "m", 0.01, 4.0, "s"),)
    columns = (Term("Fy", "Jenkins[s]", "N"),)
    nonnegative = ("Fy",)
    saturates_at = "uy"

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        z[0] = min(max(z[0] + (s1 - s0) / theta[0], -1.0), 1.0)


class BacklashFriction(Element):
    r"""Friction slider behind a spring with backlash: a friction damper whose joints
    are loose.

    .. math:: R = F_y \operatorname{sgn}(w) \min(\max((|w| - g) / u_y, 0), 1), \quad w = s - p

    p is the play operator of half-width ``g + uy``, so that w follows the stop
    operator, exactly along a path without reversal. After a reversal at the yield force
    the spring first unloads over uy, then crosses the backlash 2 g without force.
    Without gap it is :class:`Jenkins`.
    """

    name = "backlash_friction"
    shapes = (Shape("gap", "m", 0.02, 2.0, "s"), Shape("uy", "m", 0.01, 1.0, "s"))
    columns = (Term("Fy", "Jenkins[s; gap]", "N"),)
    nonnegative = ("Fy",)
    special_cases = {
        Jenkins: lambda c: BacklashFriction(1e-12 * c.theta[0], c.theta[0], c.values[0])
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(z[0]) * np.minimum(
            np.maximum((np.abs(z[0]) - theta[0]) / theta[1], 0.0), 1.0
        )

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        reach = theta[0] + theta[1]
        z[0] = min(max(z[0] + (s1 - s0), -reach), reach)


class Iwan(Element):
    r"""Two elasto-plastic elements side by side (Iwan, J. Appl. Mech. 33, 1966).

    .. math:: R = F_1 Z_1 + F_2 Z_2

    with :class:`Jenkins` states of yield drift ``uy`` and ``ratio * uy``: a joint that
    slips partially before it slips as a whole.
    """

    name = "iwan"
    shapes = (Shape("uy", "m", 0.01, 2.0, "s"), Shape("ratio", "1", 1.5, 20.0))
    columns = (
        Term("F1", "Jenkins[s; uy]", "N"),
        Term("F2", "Jenkins[s; ratio uy]", "N"),
    )
    n_states = 2
    nonnegative = ("F1", "F2")
    saturates_at = "uy"
    special_cases = {
        Jenkins: lambda c: Iwan(uy=c.theta[0], ratio=2.0, F1=c.values[0], F2=0.0)
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]
        out[1] = z[1]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        step = (s1 - s0) / theta[0]
        z[0] = min(max(z[0] + step, -1.0), 1.0)
        z[1] = min(max(z[1] + step / theta[1], -1.0), 1.0)


class LuGre(ForceLaw):
    r"""LuGre friction: bristles that bend before they slip, with a Stribeck curve.

    .. math::
        R = F_c Z + \sigma_1 \dot z, \quad z = Z / \sigma, \quad
        \dot Z = \sigma \left(\dot s - \frac{|\dot s|}{h(\dot s)} Z\right), \quad
        h = 1 + (F_s / F_c - 1) \, e^{-(\dot s / v_s)^2}

    (Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic Control 40, 1995,
    with ``sigma_0 = Fc sigma``; its viscous part is :class:`LinearViscous`). With Fs =
    Fc and without sigma1 it is :class:`Dahl`. The state is exact for constant h; over a
    change of speed, h is piecewise constant over short parts of the step.
    """

    name = "lugre"
    family = "hysteresis"
    shapes = (
        Shape("sigma", "1/m", 0.1, 3000.0, "1/s"),
        Shape("vs", "m/s", 0.02, 2.0, "v"),
        Shape("ratio", "1", 1.05, 3.0),
    )
    columns = (Term("Fc", "LuGre[s]", "N"), Term("sigma1", "d/dt bristle[s]", "N s/m"))
    n_states = 1
    nonnegative = ("Fc", "sigma1")
    saturates_at = "sigma"
    special_cases = {
        Dahl: lambda c: LuGre(c.theta[0], vs=1.0, ratio=1.0, Fc=c.values[0], sigma1=0.0)
    }

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
        # at more than 5 vs h is constant to 1e-11, below that in parts of a small share
        # of vs
        bend = max(5.0 * theta[1], min(a0, a1))
        b0, b1 = min(a0, bend), min(a1, bend)
        parts = 1 + int(min(16.0 * abs(b1 - b0) / theta[1], 127.0))
        here = a0
        for i in range(parts + 2):
            there = a1 if i > parts else b0 + (b1 - b0) * i / parts
            share = (
                (there - here) / (a1 - a0) * ((there + here) / (a1 + a0))
                if a0 != a1
                else 1.0 / (parts + 2)
            )
            if share <= 0.0:
                continue
            fall = min(0.5 * (here + there) / theta[1], 26.0)
            level = 1.0 + (theta[2] - 1.0) * math.exp(-fall * fall)
            top = sign * level
            z[0] = top + (z[0] - top) * math.exp(-theta[0] * abs(ds) * share / level)
            here = there


class BoucWen(ForceLaw):
    r"""Bouc-Wen hysteresis.

    .. math::
        R = \alpha w, \quad
        \dot w = \dot s \, \left[ 1 - (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n \right]

    (Bouc 1967, Wen 1976.) alpha is the initial stiffness, 1/beta the length over which
    the loop bends; ``1 + rho > 0`` softens while loading and ``1 + rho < 0`` hardens
    without a limit, for which the state is bounded at ``beta |w| = 1e6``. It is
    dissipative for ``|rho| <= 1``.

    ============================================================  ==============================
    published form                                                here
    ============================================================  ==============================
    ``w' = v - b |v| |w|^(n-1) w - g v |w|^n`` (Wen, A = 1)       ``beta = b^(1/n)``, ``rho = g / b``
    ``z' = al v - be (ga |v| |z|^(nu-1) z + de v |z|^nu)``,       ``alpha = al``, ``n = nu``,
    force z (Noel and Schoukens 2016)                             ``beta^n = be ga al^(n-1)``, ``rho = de / ga``
    ============================================================  ==============================

    For n = 1 the state is exact along a path without reversal. Otherwise a fourth-order
    rule is used, in parts short enough for a relative error of about 1e-6 inside the
    loop.

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
    The published benchmark (alpha = 5e4, beta = 1e3, gamma = 0.8, delta = -1.1, nu =
    1):

    >>> from pysindy_nrf import laws
    >>> print(
    ...     laws.BoucWen(
    ...         beta=1e3 * 0.8, rho=-1.1 / 0.8, n=1.0, alpha=5e4
    ...     ).equation(1)
    ... )
    5e+04 BoucWen[s1]  (beta = 800 1/m, rho = -1.375, n = 1)
    """

    name = "bouc_wen"
    family = "hysteresis"
    shapes = (
        Shape("beta", "1/m", 0.03, 100.0, "1/s"),
        Shape("rho", "1", -2.0, 1.0, log=False),
        Shape("n", "1", 1.0, 4.0),
    )
    columns = (Term("alpha", "BoucWen[s]", "N/m"),)
    n_states = 1
    nonnegative = ("alpha",)
    special_cases = {
        Dahl: lambda c: BoucWen(
            c.theta[0], rho=0.0, n=1.0, alpha=c.theta[0] * c.values[0]
        )
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0] / theta[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        # y = +-beta w counts positive along the motion, x = beta |s - s0|: dy/dx = 1 -
        # c |y|^n with c = rho + 1 where y > 0 (loading) and c = rho - 1 where y < 0
        # (unloading)
        limit = 1e6
        sign = math.copysign(1.0, s1 - s0)
        x = theta[0] * abs(s1 - s0)
        rho, n = theta[1], theta[2]
        y = sign * z[0]
        if n == 1.0:
            if y < 0.0:
                c = 1.0 - rho
                slope = 1.0 - c * y
                x_zero = math.inf
                if slope > 0.0:
                    x_zero = math.log(slope) / c if abs(c) > 1e-9 else -y
                if x_zero <= x:
                    y = 0.0
                    x -= x_zero
                else:
                    y += slope * (
                        -math.expm1(min(-c * x, 30.0)) / c if abs(c) > 1e-9 else x
                    )
                    x = 0.0
            if x > 0.0:
                c = 1.0 + rho
                y += (1.0 - c * y) * (
                    -math.expm1(min(-c * x, 30.0)) / c if abs(c) > 1e-9 else x
                )
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
                steep = (
                    1.0
                    if size < 0.9
                    else power / size * (1.0 + 0.15 * (n - 1.0) / size)
                )  # of |y|^(n-1) nearby
                h = min(x, 0.1 / (abs(c) * n * steep + 1.0 / max(1.0, size)))
                h = min(h, max(0.5 * size, 1e-3))  # |y|^n is not smooth at y = 0
                if (
                    h < 0.1 * size
                ):  # four terms of Taylor's series: one power instead of four
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
                    x_zero -= (
                        y * 5.0 / 18.0 / (1.0 - c * (-y * 0.1127016653792583) ** n)
                    )
                    x_zero -= y * 8.0 / 18.0 / (1.0 - c * (-y * 0.5) ** n)
                    x_zero -= (
                        y * 5.0 / 18.0 / (1.0 - c * (-y * 0.8872983346207417) ** n)
                    )
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
