"""Friction that follows a measured covariate, such as the voltage of a magnetorheological damper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .base import ForceLaw, Shape, Term, covariate_name
from .friction import CoulombFriction
from .hysteresis import Dahl

_TAU = Shape("tau", "s", 0.05, 50.0, "s/v")


class _Covariate(ForceLaw):
    """A friction carrier phi with a level that follows a covariate: phi, u phi and u v."""

    carrier = "sgn(v)"
    covariate_units = ("[u]",)

    def __init__(self, covariate: str, shape: dict[str, float | None], coefficients: dict[str, float | None]) -> None:
        self.covariates = (covariate_name(covariate),)
        super().__init__(shape, coefficients)

    def options(self) -> dict[str, Any]:
        """Structural arguments: the covariate."""
        return {"covariate": self.covariates[0]}

    def terms(self) -> tuple[Term, ...]:
        """Three terms: friction, friction times the covariate, velocity times the covariate."""
        u = self.covariates[0] if not self.n_states else f"lag[{self.covariates[0]}]"
        return (
            Term("Fc", self.carrier, "N"),
            Term("Fu", f"{u} {self.carrier}", "N/[u]"),
            Term("Cu", f"{u} v", "N s/m/[u]"),
        )


class CovariateFriction(_Covariate):
    r"""Friction and damping that follow a measured covariate u at once.

    .. math:: R = (F_c + F_u u) \operatorname{sgn} v + C_u u v

    The Bingham model of a controllable damper (Stanway, Sproston, Stevens, J. Electrostatics 20,
    1987) with levels linear in the command; add :class:`LinearViscous` for its constant damping.
    It takes energy out for positive coefficients where the covariate is positive.

    Parameters
    ----------
    covariate : str
        Name of the covariate, e.g. ``"voltage"``; [u] below is its unit.
    Fc : float, optional
        Friction force without the covariate, N.
    Fu : float, optional
        Friction force for each unit of the covariate, N/[u].
    Cu : float, optional
        Damping for each unit of the covariate, N s/m/[u].

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.CovariateFriction("voltage", Fc=100.0, Fu=400.0, Cu=10.0).equation(1))
    100 sgn(v1) + 400 voltage sgn(v1) + 10 voltage v1
    """

    name = "covariate_friction"
    family = "friction"
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    special_cases = {CoulombFriction: lambda c: CovariateFriction(Fc=c.values[0], Fu=0.0, Cu=0.0)}

    def __init__(
        self,
        covariate: str = "voltage",
        Fc: float | None = None,
        Fu: float | None = None,
        Cu: float | None = None,
    ) -> None:
        super().__init__(covariate, {}, {"Fc": Fc, "Fu": Fu, "Cu": Cu})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        out[0] = sign
        out[1] = u[0] * sign
        out[2] = u[0] * v


class LaggedCovariateFriction(_Covariate):
    r"""Friction and damping that follow a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) \operatorname{sgn} v + C_u w v, \quad \tau \dot w = u - w

    (Spencer, Dyke, Sain, Carlson, J. Eng. Mech. 123, 1997, whose eta is 1/tau). The lagged
    covariate w starts in every record at the mean of the first two samples of u, and is moved
    exactly for a covariate that is held at the mean between samples.

    Parameters
    ----------
    covariate : str
        Name of the covariate, e.g. ``"voltage"``; [u] below is its unit.
    tau : float, optional
        Time constant of the lag, s; estimated if None.
    Fc : float, optional
        Friction force without the covariate, N.
    Fu : float, optional
        Friction force for each unit of the covariate, N/[u].
    Cu : float, optional
        Damping for each unit of the covariate, N s/m/[u].

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LaggedCovariateFriction("voltage", tau=0.008, Fc=100.0, Fu=400.0, Cu=10.0).equation(1))
    100 sgn(v1) + 400 lag[voltage] sgn(v1) + 10 lag[voltage] v1  (tau = 0.008)
    """

    name = "lagged_covariate_friction"
    family = "friction"
    shapes = (_TAU,)
    n_states = 2  # the lagged covariate; whether it has started
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    special_cases = {
        CoulombFriction: lambda c: LaggedCovariateFriction(tau=1.0, Fc=c.values[0], Fu=0.0, Cu=0.0),
        CovariateFriction: lambda c: LaggedCovariateFriction(c.covariates[0], 1e-12, *c.values),
    }

    def __init__(
        self,
        covariate: str = "voltage",
        tau: float | None = None,
        Fc: float | None = None,
        Fu: float | None = None,
        Cu: float | None = None,
    ) -> None:
        super().__init__(covariate, {"tau": tau}, {"Fc": Fc, "Fu": Fu, "Cu": Cu})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        w = z[0] + (1.0 - z[1]) * u[0]
        out[0] = sign
        out[1] = w * sign
        out[2] = w * v

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if z[1] == 0.0:
            z[0] = u[0]
            z[1] = 1.0
        z[0] = u[0] + (z[0] - u[0]) * math.exp(-dt / theta[0])


class CovariateDahl(_Covariate):
    r"""Dahl friction that follows a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) Z + C_u w v, \quad
        \dot Z = \sigma \dot s \, (1 - Z \operatorname{sgn} \dot s), \quad \tau \dot w = u - w

    :class:`LaggedCovariateFriction` whose reversal takes a distance of about 1/sigma: the modified
    Dahl damper (paper eqs. 6-7) under a changing command.

    Parameters
    ----------
    covariate : str
        Name of the covariate, e.g. ``"voltage"``; [u] below is its unit.
    sigma : float, optional
        Shape of the loop, 1/m; estimated if None.
    tau : float, optional
        Time constant of the lag, s; estimated if None.
    Fc : float, optional
        Friction force without the covariate, N.
    Fu : float, optional
        Friction force for each unit of the covariate, N/[u].
    Cu : float, optional
        Damping for each unit of the covariate, N s/m/[u].

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.CovariateDahl("voltage", sigma=3e4, tau=0.008).n_states
    3
    """

    name = "covariate_dahl"
    family = "hysteresis"
    shapes = (Shape("sigma", "1/m", 0.03, 3000.0, "1/s"), _TAU)
    n_states = 3  # the lagged covariate; whether it has started; Z
    carrier = "Z"
    saturates_at = "sigma"
    special_cases = {
        Dahl: lambda c: CovariateDahl(sigma=c.theta[0], tau=1.0, Fc=c.values[0], Fu=0.0, Cu=0.0),
        CovariateFriction: lambda c: CovariateDahl(c.covariates[0], 1e12, 1e-12, *c.values),
        LaggedCovariateFriction: lambda c: CovariateDahl(c.covariates[0], 1e12, c.theta[0], *c.values),
    }

    def __init__(
        self,
        covariate: str = "voltage",
        sigma: float | None = None,
        tau: float | None = None,
        Fc: float | None = None,
        Fu: float | None = None,
        Cu: float | None = None,
    ) -> None:
        super().__init__(covariate, {"sigma": sigma, "tau": tau}, {"Fc": Fc, "Fu": Fu, "Cu": Cu})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        w = z[0] + (1.0 - z[1]) * u[0]
        out[0] = z[2]
        out[1] = w * z[2]
        out[2] = w * v

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if z[1] == 0.0:
            z[0] = u[0]
            z[1] = 1.0
        z[0] = u[0] + (z[0] - u[0]) * math.exp(-dt / theta[1])
        ds = s1 - s0
        sign = math.copysign(1.0, ds)
        z[2] = sign + (z[2] - sign) * math.exp(-theta[0] * abs(ds))
