"""Hysteresis that degrades or pinches: Bouc-Wen with Baber's and Noori's terms."""

import math

import numpy as np

from .base import ForceLaw, Term
from .hysteresis import BoucWen, Dahl
from .shape import Shape

_BETA = Shape("beta", "1/m", 0.2, 20.0, "1/s")

# What the kernel reads, in its order, with the values that neither degrade nor pinch.
_THETA = {
    "beta": np.nan,
    "strength": 0.0,
    "stiffness": 0.0,
    "slip": 0.0,
    "width": 1.0,
    "q": 0.0,
    "rho": 0.0,
    "n": 1.0,
}

MAX_PARTS_OF_STROKE = 1000
MAX_STATE = 1e6
SETTLED = 1e-5  # dy/dx at which y is taken to be at its limit
# Degradation is constant over parts of the path in which it changes by this share.
SHARE_OF_DEGRADATION = 0.05
# Widths beyond the middle of the slip where exp(-x^2) is 5e-6.
WIDTHS_OF_SLIP = 3.5


class _BaberNoori(ForceLaw):
    """Base of Bouc-Wen hysteresis that degrades with the work done on it, or slips.

    Along the motion ``dy/dx = h (1 - nu (sgn y + rho) |y|^n) / eta`` with ``x = beta |s
    - s_0|``, ``nu`` and ``eta`` linear in the work e over the yield force (m), ``h = 1
    - slip exp(-((y - q) / width)^2)``.
    """

    family = "hysteresis"
    n_states = 2  # y, e
    nonnegative = ("alpha",)

    def __init__(
        self, shape: dict[str, float | None], alpha: float | None, **fixed: float
    ) -> None:
        super().__init__(shape, {"alpha": alpha})
        self._fixed = {name: self._number(name, value) for name, value in fixed.items()}

    def options(self) -> dict[str, object]:
        return dict(self._fixed)

    @property
    def theta(self) -> np.ndarray:
        searched = dict(zip(self.shape, super().theta))
        values = {**_THETA, **self._fixed, **searched}
        return np.array(list(values.values()), dtype=float)

    kernel = staticmethod(BoucWen.kernel)

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        beta = theta[0]
        degradation = theta[1] / beta, theta[2] / beta
        slip = theta[3], theta[4], theta[5]
        rho = theta[6]
        n = theta[7]

        sign = math.copysign(1.0, s1 - s0)
        x = beta * abs(s1 - s0)
        y, work = _stroke(sign * z[0], beta * z[1], x, degradation, slip, rho, n)
        z[0] = sign * y
        z[1] = work / beta


# -- one stroke ----------------------------------------------------------------
#
# y = +-beta w counts positive along the motion, and x = beta |s - s_0|. ``slip`` is
# zeta, the width d and q. Where rho = 0 and n = 1, the equation is linear in y.


def _stroke(y, work, x, degradation, slip, rho, n):
    """State and work at the end of a stroke of length x, moved in parts."""
    of_strength, of_stiffness = degradation
    fade = max(of_strength, of_stiffness)
    is_linear = rho == 0.0 and n == 1.0
    end_of_slip = -math.inf
    if slip[0] > 0.0:
        end_of_slip = slip[2] + WIDTHS_OF_SLIP * slip[1]
    nu = 1.0
    eta = 1.0

    for k in range(MAX_PARTS_OF_STROKE):
        if x <= 0.0:
            break

        h = x
        if fade > 0.0:
            worn = max(work, 0.0)
            if k < MAX_PARTS_OF_STROKE - 1:
                change = SHARE_OF_DEGRADATION * (worn + 1.0 / fade)
                h = min(x, change / max(abs(y), 1.0))
            worn = max(worn + 0.5 * h * y, 0.0)
            nu = 1.0 + of_strength * worn
            eta = 1.0 + of_stiffness * worn

        if is_linear and y > end_of_slip:  # exact for constant nu and eta
            rise = (y - 1.0 / nu) * math.expm1(-h * nu / eta)
            work += (h - rise * eta) / nu
            y += rise
            x -= h
            continue

        h = min(h, _longest_step(y, nu, eta, slip, rho, n, is_linear))
        slope = _slope(y, nu, eta, slip, rho, n, is_linear)
        if fade == 0.0 and abs(slope) < SETTLED:
            work += x * y
            break
        rise = _runge_kutta_rise(y, h, slope, nu, eta, slip, rho, n, is_linear)
        end = min(max(y + rise, -MAX_STATE), MAX_STATE)
        work += 0.5 * h * (y + end)
        y = end
        x -= h

    return y, work


def _slope(y, nu, eta, slip, rho, n, is_linear):
    """dy/dx."""
    if is_linear:
        bend = y
    elif y >= 0.0:
        bend = (rho + 1.0) * abs(y) ** n
    else:
        bend = (rho - 1.0) * abs(y) ** n
    slope = (1.0 - nu * bend) / eta

    zeta, width, q = slip
    if zeta > 0.0:
        offset = (y - q) / width
        slope -= slope * zeta * math.exp(-min(offset * offset, 700.0))
    return slope


def _longest_step(y, nu, eta, slip, rho, n, is_linear):
    """Length over which the fourth-order rule has an error of about 1e-6."""
    if is_linear:
        h = 0.25 * eta / nu
    else:
        c = rho + 1.0 if y >= 0.0 else rho - 1.0
        steepness = nu * n * abs(c) * max(abs(y), 1.0) ** (n - 1.0)
        h = 0.8 * eta / (steepness + 1.0)
        h = min(h, max(abs(y), 0.01))  # |y|^n is not smooth at y = 0

    zeta, width, q = slip
    if zeta > 0.0:
        h = min(h, 0.35 * eta * max(width, abs(y - q) - 3.0 * width))
    return h


def _runge_kutta_rise(y, h, slope, nu, eta, slip, rho, n, is_linear):
    """Change of y over a step by the classical rule of order 4."""
    f2 = _slope(y + 0.5 * h * slope, nu, eta, slip, rho, n, is_linear)
    f3 = _slope(y + 0.5 * h * f2, nu, eta, slip, rho, n, is_linear)
    f4 = _slope(y + h * f3, nu, eta, slip, rho, n, is_linear)
    return h * (slope + 2.0 * f2 + 2.0 * f3 + f4) / 6.0


# -- the laws ------------------------------------------------------------------


class DegradingBoucWen(_BaberNoori):
    r"""Bouc-Wen hysteresis whose strength and stiffness degrade.

    .. math::
        R = \alpha w, \quad
        \eta \dot w = \dot s \,
        [1 - \nu \, (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n], \quad
        \nu = 1 + \nu_e e, \quad \eta = 1 + \eta_e e, \quad
        e = \beta \int w \, \mathrm{d} s

    (Baber and Wen, J. Eng. Mech. Div. 107, 1981.) e is the work done on the element
    over its initial yield force. ``strength`` and ``stiffness`` are nu_e and eta_e,
    1/m. Without them it is :class:`BoucWen`. A search keeps rho = 0 and n = 1, for
    which the state is exact for constant nu and eta; they are constant over short parts
    of the path.
    """

    name = "degrading_bouc_wen"
    shapes = (
        _BETA,
        Shape("strength", "1/m", 0.1, 30.0, "1/p"),
        Shape("stiffness", "1/m", 0.01, 30.0, "1/p"),
    )
    columns = (Term("alpha", "DegradingBoucWen[s]", "N/m"),)
    special_cases = {
        Dahl: lambda c: DegradingBoucWen(
            c.theta[0], 1e-12, 1e-12, alpha=c.theta[0] * c.values[0]
        ),
        BoucWen: lambda c: DegradingBoucWen(
            c.theta[0], 1e-12, 1e-12, c.values[0], c.theta[1], c.theta[2]
        ),
    }

    def __init__(
        self,
        beta: float | None = None,
        strength: float | None = None,
        stiffness: float | None = None,
        alpha: float | None = None,
        rho: float = 0.0,
        n: float = 1.0,
    ) -> None:
        super().__init__(
            {"beta": beta, "strength": strength, "stiffness": stiffness},
            alpha,
            rho=rho,
            n=n,
        )


class PinchedBoucWen(_BaberNoori):
    r"""Bouc-Wen hysteresis that slips where its force is small, as in cracked concrete.

    .. math::
        R = \alpha w, \quad
        \dot w = \dot s \, h \,
        [1 - (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n], \quad
        h = 1 - \zeta \, e^{-(\beta w \operatorname{sgn} \dot s - q)^2 / d^2}

    (Baber and Noori, J. Eng. Mech. 111, 1985, and J. Vib. Acoust. 108, 1986.) ``slip``
    is zeta, the part of the stiffness that is lost; ``width`` d and q are shares of the
    yield force. Without slip it is :class:`BoucWen`. A search keeps q = rho = 0 and n =
    1. A fourth-order rule moves the state in short parts of the path.
    """

    name = "pinched_bouc_wen"
    shapes = (
        _BETA,
        Shape("slip", "1", 0.0, 0.98, log=False),
        Shape("width", "1", 0.1, 1.0),
    )
    columns = (Term("alpha", "PinchedBoucWen[s]", "N/m"),)
    special_cases = {
        Dahl: lambda c: PinchedBoucWen(c.theta[0], 0.0, 1.0, c.theta[0] * c.values[0]),
        BoucWen: lambda c: PinchedBoucWen(
            c.theta[0], 0.0, 1.0, c.values[0], 0.0, c.theta[1], c.theta[2]
        ),
    }

    def __init__(
        self,
        beta: float | None = None,
        slip: float | None = None,
        width: float | None = None,
        alpha: float | None = None,
        q: float = 0.0,
        rho: float = 0.0,
        n: float = 1.0,
    ) -> None:
        super().__init__(
            {"beta": beta, "slip": slip, "width": width}, alpha, q=q, rho=rho, n=n
        )
