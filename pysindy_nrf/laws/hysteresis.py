"""Hysteresis: Dahl, modified Dahl, elasto-plastic elements, LuGre, Bouc-Wen."""

import math

import numpy as np

from .base import ForceLaw, Term
from .shape import Shape

_SIGMA = Shape("sigma", "1/m", 0.03, 3000.0, "1/s")
# Rate over vs above which exp(-(v / vs)^2) counts as its value here, 1e-294.
MAX_STRIBECK_RATE = 26.0


class Element(ForceLaw):
    """Base of passive elements; by default they have one state, which is the force."""

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
        K0: float | None = None,
        C0: float | None = None,
        Fd: float | None = None,
        f0: float | None = None,
        sigma: float | None = None,
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

    .. math::
        R = F_y Z, \quad
        \dot Z = \dot s / u_y \text{ while } |Z| < 1 \text{ or unloading, else } 0

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
    r"""Friction slider behind a spring with backlash: a damper with loose joints.

    .. math::
        R = F_y \operatorname{sgn}(w) \min(\max((|w| - g) / u_y, 0), 1), \quad w = s - p

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
        beyond_gap = np.maximum((np.abs(z[0]) - theta[0]) / theta[1], 0.0)
        out[0] = np.sign(z[0]) * np.minimum(beyond_gap, 1.0)

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
        x = np.minimum(np.abs(v) / theta[1], MAX_STRIBECK_RATE)
        level = 1.0 + (theta[2] - 1.0) * np.exp(-x * x)
        out[0] = z[0]
        out[1] = v - np.abs(v) * z[0] / level

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        # theta is sigma, vs and ratio. Names for them, kept in registers across the
        # exponentials, would cost a tenth of the time.
        ds = s1 - s0
        if ds == 0.0:
            return
        sign = math.copysign(1.0, ds)
        speed0 = abs(v0)
        speed1 = abs(v1)

        # Above 5 vs the level is constant to 1e-11. Below, it is constant in parts of
        # the step in which the speed changes by a sixteenth of vs.
        upper = max(5.0 * theta[1], min(speed0, speed1))
        first = min(speed0, upper)
        last = min(speed1, upper)
        n_parts = 1 + int(min(16.0 * abs(last - first) / theta[1], 127.0))

        speed = speed0
        for i in range(n_parts + 2):
            if i <= n_parts:
                end = first + (last - first) * i / n_parts
            else:
                end = speed1

            # under a constant acceleration the drift goes with the speed squared
            if speed0 != speed1:
                share = (end - speed) / (speed1 - speed0)
                share *= (end + speed) / (speed1 + speed0)
            else:
                share = 1.0 / (n_parts + 2)
            if share <= 0.0:
                continue

            x = min(0.5 * (speed + end) / theta[1], MAX_STRIBECK_RATE)
            level = 1.0 + (theta[2] - 1.0) * math.exp(-x * x)
            target = sign * level
            decay = math.exp(-theta[0] * abs(ds) * share / level)
            z[0] = target + (z[0] - target) * decay
            speed = end


class BoucWen(ForceLaw):
    r"""Bouc-Wen hysteresis.

    .. math::
        R = \alpha w, \quad
        \dot w = \dot s \, [1 - (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n]

    (Bouc 1967, Wen 1976.) alpha is the initial stiffness, 1/beta the length over which
    the loop bends; ``1 + rho > 0`` softens while loading and ``1 + rho < 0`` hardens
    without a limit, for which the state is bounded at ``beta |w| = 1e6``. It is
    dissipative for ``|rho| <= 1``.

    Published forms:

    - ``w' = v - b |v| |w|^(n-1) w - g v |w|^n`` (Wen, A = 1) has ``beta = b^(1/n)`` and
      ``rho = g / b``.
    - ``z' = al v - be (ga |v| |z|^(nu-1) z + de v |z|^nu)`` with the force z (Noel and
      Schoukens 2016) has ``alpha = al``, ``n = nu``, ``beta^n = be ga al^(n-1)`` and
      ``rho = de / ga``.

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
        rho = theta[1]
        n = theta[2]
        sign = math.copysign(1.0, s1 - s0)
        x = theta[0] * abs(s1 - s0)
        y = sign * z[0]
        if n == 1.0:
            y = _exact_stroke(y, x, rho)
        else:
            y = _stroke_in_steps(y, x, rho, n)
        z[0] = sign * min(max(y, -MAX_STATE), MAX_STATE)


# -- one stroke of Bouc-Wen hysteresis -----------------------------------------
#
# y = +-beta w counts positive along the motion, and x = beta |s - s_0|:
# dy/dx = 1 - c |y|^n with c = rho + 1 where y > 0 (loading) and c = rho - 1 where y < 0
# (unloading).

MAX_STATE = 1e6  # where a law that hardens without a limit is stopped
MAX_STEPS_OF_STROKE = 20_000
SETTLED = 1e-13  # dy/dx at which y is taken to be at its limit
# Step below which four terms of Taylor's series are as good as a Runge-Kutta step, as a
# share of |y|. They need one power, the step needs four.
TAYLOR_SHARE = 0.1


def _exact_stroke(y, x, rho):
    """State after a stroke of length x for n = 1, in closed form."""
    if y < 0.0:
        c = 1.0 - rho
        slope = 1.0 - c * y
        x_zero = math.inf  # length at which y = 0
        if slope > 0.0:
            x_zero = math.log(slope) / c if abs(c) > 1e-9 else -y
        if not x_zero <= x:
            return y + slope * _growth(c, x)
        y = 0.0
        x -= x_zero

    if x > 0.0:
        c = 1.0 + rho
        y += (1.0 - c * y) * _growth(c, x)
    return y


def _growth(c, x):
    """(1 - exp(-c x)) / c, also where c is zero."""
    if abs(c) > 1e-9:
        return -math.expm1(min(-c * x, 30.0)) / c
    return x


def _stroke_in_steps(y, x, rho, n):
    """State after a stroke of length x for any n, by a fourth-order rule."""
    for _ in range(MAX_STEPS_OF_STROKE):
        if x <= 0.0:
            break
        c = 1.0 + rho if y >= 0.0 else rho - 1.0
        size = abs(y)
        power = size**n
        slope = 1.0 - c * power
        if abs(slope) < SETTLED or (size >= MAX_STATE and slope * y > 0.0):
            break

        h = min(x, _step_length(size, power, c, n))
        if h < TAYLOR_SHARE * size:
            y += _taylor_step(y, h, slope, power, c, n)
        else:
            if y < 0.0 and y + h * slope > 0.0:
                x_zero = _length_to_zero(y, c, n)
                if x_zero <= h:
                    y = 0.0
                    x -= x_zero
                    continue
            y += _runge_kutta_step(y, h, slope, c, n)
        x -= h
    return y


def _step_length(size, power, c, n):
    """Length of a step with a relative error of about 1e-6."""
    steepest = 1.0  # of |y|^(n-1) nearby
    if size >= 0.9:
        steepest = power / size * (1.0 + 0.15 * (n - 1.0) / size)
    h = 0.1 / (abs(c) * n * steepest + 1.0 / max(1.0, size))
    return min(h, max(0.5 * size, 1e-3))  # |y|^n is not smooth at y = 0


def _taylor_step(y, h, slope, power, c, n):
    """Change of y over a step by Taylor's series, d_k being derivatives by y."""
    inverse = 1.0 / y
    d1 = -c * n * power * inverse
    d2 = d1 * (n - 1.0) * inverse
    d3 = d2 * (n - 2.0) * inverse
    y4 = slope * slope * d3 + 4.0 * slope * d1 * d2 + d1 * d1 * d1
    y3 = slope * d2 + d1 * d1 + 0.25 * h * y4
    return h * slope * (1.0 + 0.5 * h * (d1 + h * y3 / 3.0))


def _runge_kutta_step(y, h, slope, c, n):
    """Change of y over a step by the classical rule of order 4."""
    f2 = 1.0 - c * abs(y + 0.5 * h * slope) ** n
    f3 = 1.0 - c * abs(y + 0.5 * h * f2) ** n
    f4 = 1.0 - c * abs(y + h * f3) ** n
    return h * (slope + 2.0 * f2 + 2.0 * f3 + f4) / 6.0


def _length_to_zero(y, c, n):
    """Length at which y < 0 becomes 0, dx = dy / (1 - c |y|^n), by Gauss's points."""
    x = 0.0
    x -= y * 5.0 / 18.0 / (1.0 - c * (-y * 0.1127016653792583) ** n)
    x -= y * 8.0 / 18.0 / (1.0 - c * (-y * 0.5) ** n)
    x -= y * 5.0 / 18.0 / (1.0 - c * (-y * 0.8872983346207417) ** n)
    return x
