"""Dry friction, also of controllable dampers whose level follows a measured covariate
such as a voltage.

Friction against the ground is :class:`CoulombFriction` at the site ``"ground j"`` if
the base does not move. On a moving base, friction against a fixed object beside the
structure is :class:`GroundFriction`.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from .base import CovariateLaw, ForceLaw, Term
from .hysteresis import Dahl
from .shape import Given, Shape


class _Friction(ForceLaw):
    """Base of dry friction between two floors, or of one against the ground."""

    family = "friction"
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    nonnegative: ClassVar[tuple[str, ...]] = ("Fc",)


class CoulombFriction(_Friction):
    r"""Coulomb friction.

    .. math:: R = F_c \operatorname{sgn} v

    At a storey it acts between two floors; at ``"ground j"`` between DOF j and the
    ground.

    Parameters
    ----------
    Fc : float, optional
        Friction force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.CoulombFriction(Fc=20.4).equation(1))
    20.4 sgn(v1)
    """

    name = "coulomb_friction"
    columns = (Term("Fc", "sgn(v)", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v)


class StribeckFriction(_Friction):
    r"""Friction whose level falls from static to sliding.

    .. math:: R = \operatorname{sgn} v \, (F_c + \Delta F \, e^{-|v| / v_s})

    The static level is ``Fc + dF`` (Armstrong-Helouvry, Dupont, Canudas de Wit,
    Automatica 30, 1994, with the exponent 1 of Tustin).
    """

    name = "stribeck_friction"
    shapes = (Shape("vs", "m/s", 0.02, 2.0, "v"),)
    columns = (Term("Fc", "sgn(v)", "N"), Term("dF", "sgn(v) exp(-|v|/vs)", "N"))
    nonnegative = ("Fc", "dF")  # with a negative dF the force would grow with the rate
    special_cases = {
        CoulombFriction: lambda c: StribeckFriction(vs=1.0, Fc=c.values[0], dF=0.0)
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        out[0] = sign
        out[1] = sign * np.exp(-np.minimum(np.abs(v) / theta[0], 700.0))


class RegularizedFriction(_Friction):
    r"""Friction that creeps through a velocity reversal, as of wet contacts and as most
    simulations write it.

    .. math:: R = F_c \tanh(v / v_0)
    """

    name = "regularized_friction"
    jumps = False
    shapes = (Shape("v0", "m/s", 1e-4, 0.3, "v"),)
    columns = (Term("Fc", "tanh(v/v0)", "N"),)
    special_cases = {
        CoulombFriction: lambda c: RegularizedFriction(v0=1e-12, Fc=c.values[0])
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.tanh(v / theta[0])


class PositionDependentFriction(_Friction):
    r"""Friction whose level changes with the drift, as of wedges, ring springs or a
    tapered guide.

    .. math:: R = (F_c + F_s |s|) \operatorname{sgn} v
    """

    name = "position_dependent_friction"
    columns = (Term("Fc", "sgn(v)", "N"), Term("Fs", "|s| sgn(v)", "N/m"))
    special_cases = {
        CoulombFriction: lambda c: PositionDependentFriction(Fc=c.values[0], Fs=0.0)
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v)
        out[1] = np.abs(s) * np.sign(v)


class BreakAwayFriction(_Friction):
    r"""Friction with a peak after each reversal that decays with the distance slid
    since.

    .. math:: R = F_c \operatorname{sgn} v + \Delta F \, Z, \quad Z = \pm e^{-|s - s_r| / d}

    s_r is the drift at the last reversal and the sign of Z that of the motion since:
    the bond of lead or rubber that each stroke breaks anew. The state is exact.
    """

    name = "break_away_friction"
    shapes = (Shape("d", "m", 0.02, 2.0, "s"),)
    columns = (Term("Fc", "sgn(v)", "N"), Term("dF", "Peak[s]", "N"))
    n_states = 1
    special_cases = {
        CoulombFriction: lambda c: BreakAwayFriction(d=1.0, Fc=c.values[0], dF=0.0)
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v)
        out[1] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        ds = s1 - s0
        if ds == 0.0:
            return
        sign = math.copysign(1.0, ds)
        peak = abs(z[0]) if sign * z[0] > 0.0 else 1.0
        z[0] = sign * max(peak * math.exp(-abs(ds) / theta[0]), 1e-100)


class ShiftedFriction(_Friction):
    r"""Friction that reverses with v + kappa s instead of with v.

    .. math:: R = F_c \operatorname{sgn}(v + \kappa s)

    The sharp form of the damper model of Guo, Yang and Pan (J. Intell. Mater. Syst.
    Struct. 17, 2006). With kappa > 0 the force lags the velocity, as with a soft seal
    or a fluid under pressure in a magnetorheological damper.
    """

    name = "shifted_friction"
    shapes = (Shape("kappa", "1/s", 0.01, 3.0, "v/s"),)
    columns = (Term("Fc", "sgn(v + kappa s)", "N"),)
    special_cases = {
        CoulombFriction: lambda c: ShiftedFriction(kappa=1e-12, Fc=c.values[0])
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v + theta[0] * s)


class GroundFriction(CovariateLaw):
    r"""Coulomb friction against a fixed object while the base moves.

    .. math:: R = F_c \operatorname{sgn}(v + v_g)

    v is the velocity of the DOF relative to the base and ``v_g`` the velocity of the
    base, so that their sum is the absolute velocity (Lathourakis and Cicirello,
    Nonlinear Dynamics, 2024). With a fixed base it is :class:`CoulombFriction` at
    ``"ground j"``.
    """

    name = "ground_friction"
    family = "friction"
    symmetry = "none"
    at_rest = None
    acts_at = ("dof",)
    covariate_units = ("m/s",)
    variable = "v"
    jumps = True
    nonnegative = ("Fc",)

    def __init__(self, Fc: Given = None, covariate: str = "vg") -> None:
        super().__init__(covariate, {}, {"Fc": Fc})

    def terms(self) -> tuple[Term, ...]:
        return (Term("Fc", f"sgn(v + {self.covariates[0]})", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v + u[0])


_TAU = Shape("tau", "s", 0.05, 50.0, "s/v")


class _CovariateFriction(CovariateLaw):
    """Base of friction whose level follows a covariate u: terms phi, u phi and u v of a
    carrier phi.
    """

    carrier = "sgn(v)"
    covariate_units = ("[u]",)

    def terms(self) -> tuple[Term, ...]:
        u = self.covariates[0] if not self.n_states else f"lag[{self.covariates[0]}]"
        level = Term("Fu", f"{u} {self.carrier}", "N/[u]")
        return Term("Fc", self.carrier, "N"), level, Term("Cu", f"{u} v", "N s/m/[u]")


class CovariateFriction(_CovariateFriction):
    r"""Friction and damping that follow a measured covariate u without delay.

    .. math:: R = (F_c + F_u u) \operatorname{sgn} v + C_u u v

    The Bingham model of a controllable damper (Stanway, Sproston, Stevens, J.
    Electrostatics 20, 1987) with levels linear in the command; add
    :class:`LinearViscous` for its constant damping. It dissipates energy for positive
    coefficients while the covariate is positive.
    """

    name = "covariate_friction"
    family = "friction"
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    special_cases = {
        CoulombFriction: lambda c: CovariateFriction(Fc=c.values[0], Fu=0.0, Cu=0.0)
    }

    def __init__(
        self,
        covariate: str = "voltage",
        Fc: Given = None,
        Fu: Given = None,
        Cu: Given = None,
    ) -> None:
        super().__init__(covariate, {}, {"Fc": Fc, "Fu": Fu, "Cu": Cu})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        out[0] = sign
        out[1] = u[0] * sign
        out[2] = u[0] * v


class LaggedCovariateFriction(_CovariateFriction):
    r"""Friction and damping that follow a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) \operatorname{sgn} v + C_u w v, \quad \tau \dot w = u - w

    (Spencer, Dyke, Sain, Carlson, J. Eng. Mech. 123, 1997, whose eta is 1/tau). The
    lagged covariate w starts in every record at the mean of the first two samples of u,
    and is moved exactly for a covariate that is held at the mean between samples.
    """

    name = "lagged_covariate_friction"
    family = "friction"
    shapes = (_TAU,)
    n_states = 2  # lagged covariate, 1 once it has started
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    special_cases = {
        CoulombFriction: lambda c: LaggedCovariateFriction(
            tau=1.0, Fc=c.values[0], Fu=0.0, Cu=0.0
        ),
        CovariateFriction: lambda c: LaggedCovariateFriction(
            c.covariates[0], 1e-12, *c.values
        ),
    }

    def __init__(
        self,
        covariate: str = "voltage",
        tau: Given = None,
        Fc: Given = None,
        Fu: Given = None,
        Cu: Given = None,
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


class CovariateDahl(_CovariateFriction):
    r"""Dahl friction that follows a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) Z + C_u w v, \quad
        \dot Z = \sigma \dot s \, (1 - Z \operatorname{sgn} \dot s), \quad \tau \dot w = u - w

    :class:`LaggedCovariateFriction` that reverses over a distance of about 1/sigma: the
    modified Dahl damper (paper eqs. 6-7) under a changing command.
    """

    name = "covariate_dahl"
    family = "hysteresis"
    shapes = (Shape("sigma", "1/m", 0.03, 3000.0, "1/s"), _TAU)
    n_states = 3  # lagged covariate, 1 once it has started, Z
    carrier = "Z"
    saturates_at = "sigma"
    special_cases = {
        Dahl: lambda c: CovariateDahl(
            sigma=c.theta[0], tau=1.0, Fc=c.values[0], Fu=0.0, Cu=0.0
        ),
        CovariateFriction: lambda c: CovariateDahl(
            c.covariates[0], 1e12, 1e-12, *c.values
        ),
        LaggedCovariateFriction: lambda c: CovariateDahl(
            c.covariates[0], 1e12, c.theta[0], *c.values
        ),
    }

    def __init__(
        self,
        covariate: str = "voltage",
        sigma: Given = None,
        tau: Given = None,
        Fc: Given = None,
        Fu: Given = None,
        Cu: Given = None,
    ) -> None:
        super().__init__(
            covariate, {"sigma": sigma, "tau": tau}, {"Fc": Fc, "Fu": Fu, "Cu": Cu}
        )

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


# Rates just above and below zero, m/s: a jump is complete between the nearer two.
_RATES = np.array([1e-14, -1e-14, 1e-9, -1e-9])


def jump_at_reversal(
    law: ForceLaw, largest: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Change of each column at a velocity reversal, near and wide, shape (n_terms, 2),
    for the covariates given.
    """
    zero = np.zeros(4)
    u = np.array([np.full(4, size) for size in largest]).reshape(-1, 4)
    out = np.zeros((len(law.terms()), 4))
    law.kernel(zero, _RATES, zero, zero, u, np.zeros((law.n_states, 4)), law.theta, out)
    return out[:, ::2] - out[:, 1::2]
