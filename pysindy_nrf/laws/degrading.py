"""Hysteresis that degrades or pinches: Bouc-Wen with the terms of Baber, Noori and
Wen.
"""

import math
from typing import Any

import numpy as np

from .base import ForceLaw, Term
from .hysteresis import BoucWen, Dahl
from .shape import Given, Shape

_BETA = Shape("beta", "1/m", 0.2, 20.0, "1/s")


class _BaberNoori(ForceLaw):
    """Bouc-Wen hysteresis whose strength and stiffness fall with the work done on it,
    and which slips near zero force.

    Along the motion ``dy/dx = h (1 - nu (sgn y + rho) |y|^n) / eta`` with ``x = beta |s
    - s_0|``, ``nu`` and ``eta`` linear in the work e over the yield force (m), ``h = 1
    - slip exp(-((y - q) / width)^2)``.
    """

    family = "hysteresis"
    n_states = 2  # y, e
    nonnegative = ("alpha",)

    def __init__(self, shape: dict[str, Given], alpha: Given, **fixed: float) -> None:
        super().__init__(shape, {"alpha": alpha})
        self._fixed = {key: self._number(key, value) for key, value in fixed.items()}

    def options(self) -> dict[str, Any]:
        return dict(self._fixed)

    @property
    def theta(self) -> np.ndarray:
        values = {
            "strength": 0.0,
            "stiffness": 0.0,
            "slip": 0.0,
            "width": 1.0,
            "q": 0.0,
            **self._fixed,
        }
        values |= dict(zip(self.shape, super().theta))
        return np.array(
            [
                values[key]
                for key in (
                    "beta",
                    "strength",
                    "stiffness",
                    "slip",
                    "width",
                    "q",
                    "rho",
                    "n",
                )
            ]
        )

    kernel = staticmethod(BoucWen.kernel)

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        sign = math.copysign(1.0, s1 - s0)
        beta, slip, width, rho, n = theta[0], theta[3], theta[4], theta[6], theta[7]
        x = beta * abs(s1 - s0)
        y = sign * z[0]
        e = beta * z[1]
        strength, stiffness = theta[1] / beta, theta[2] / beta
        fade = max(strength, stiffness)
        plain = rho == 0.0 and n == 1.0
        beyond = theta[5] + 3.5 * width if slip > 0.0 else -math.inf  # of the slip
        nu, eta = 1.0, 1.0
        most = 1000
        for k in range(most):
            if x <= 0.0:
                break
            h = x
            if (
                fade > 0.0
                # nu and eta are constant over parts in which they change by a small
                # share
            ):
                worn = max(e, 0.0)
                if k < most - 1:
                    h = min(x, 0.05 * (worn + 1.0 / fade) / max(abs(y), 1.0))
                worn = max(worn + 0.5 * h * y, 0.0)
                nu, eta = 1.0 + strength * worn, 1.0 + stiffness * worn
            if plain and y > beyond:
                rise = (y - 1.0 / nu) * math.expm1(-h * nu / eta)
                e += (h - rise * eta) / nu
                y += rise
                x -= h
                continue
            if plain:
                h = min(h, 0.25 * eta / nu)
            else:
                c = 1.0 + rho if y >= 0.0 else rho - 1.0
                steep = nu * n * abs(c) * max(abs(y), 1.0) ** (n - 1.0)
                h = min(
                    h, 0.8 * eta / (steep + 1.0), max(abs(y), 0.01)
                )  # |y|^n is not smooth at y = 0
            if slip > 0.0:
                h = min(h, 0.35 * eta * max(width, abs(y - theta[5]) - 3.0 * width))
            f, total = 0.0, 0.0
            for shift, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                at = y + shift * h * f
                bend = (
                    at
                    if plain
                    else (1.0 + rho if at >= 0.0 else rho - 1.0) * abs(at) ** n
                )
                f = (1.0 - nu * bend) / eta
                if slip > 0.0:
                    near = (at - theta[5]) / width
                    f -= f * slip * math.exp(-min(near * near, 700.0))
                if shift == 0.0 and fade == 0.0 and abs(f) < 1e-5:  # settled
                    h = x
                    break
                total += weight * f / 6.0
            end = min(max(y + h * total, -1e6), 1e6)
            e += 0.5 * h * (y + end)
            y = end
            x -= h
        z[0] = sign * y
        z[1] = e / beta


class DegradingBoucWen(_BaberNoori):
    r"""Bouc-Wen hysteresis whose strength and stiffness degrade.

    .. math::
        R = \alpha w, \quad \eta \dot w = \dot s \, [1 - \nu \, (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n],
        \quad \nu = 1 + \nu_e e, \quad \eta = 1 + \eta_e e, \quad e = \beta \int w \, \mathrm{d} s

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
        beta: Given = None,
        strength: Given = None,
        stiffness: Given = None,
        alpha: Given = None,
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
    r"""Bouc-Wen hysteresis that slips where its force is small, as in cracked concrete
    or round a nail.

    .. math::
        R = \alpha w, \quad
        \dot w = \dot s \, h \, [1 - (\operatorname{sgn}(\dot s w) + \rho) \, (\beta |w|)^n], \quad
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
        beta: Given = None,
        slip: Given = None,
        width: Given = None,
        alpha: Given = None,
        q: float = 0.0,
        rho: float = 0.0,
        n: float = 1.0,
    ) -> None:
        super().__init__(
            {"beta": beta, "slip": slip, "width": width}, alpha, q=q, rho=rho, n=n
        )
