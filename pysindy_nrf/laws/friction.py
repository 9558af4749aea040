"""Dry friction, also of controllable dampers whose level follows a covariate.

Friction against the ground is :class:`CoulombFriction` at the site ``"ground j"`` if
the base does not move. On a moving base, friction against a fixed object next to the
structure is :class:`GroundFriction`.
"""

import math
from collections.abc import Sequence

import numpy as np

from .base import CovariateLaw, ForceLaw, Term
from .hysteresis import Dahl
from .shape import Shape


class _Friction(ForceLaw):
    """Base of dry friction between two floors, or of one against the ground."""

    family = "friction"
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    nonnegative: tuple[str, ...] = ("Fc",)


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
    r"""Friction that creeps through a velocity reversal, as in wet contacts.

    .. math:: R = F_c \tanh(v / v_0)

    Most simulations write Coulomb friction in this way.
    """

    name = "regularized_friction"
    shapes = (Shape("v0", "m/s", 1e-4, 0.3, "v"),)
    columns = (Term("Fc", "tanh(v/v0)", "N"),)
    special_cases = {
        CoulombFriction: lambda c: RegularizedFriction(v0=1e-12, Fc=c.values[0])
    }

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.tanh(v / theta[0])


class PositionDependentFriction(_Friction):
    r"""Friction whose level changes with the drift, as in wedges or ring springs.

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
    r"""Friction with a peak after each reversal that decays with the distance slid.

    .. math::
        R = F_c \operatorname{sgn} v + \Delta F \, Z, \quad Z = \pm e^{-|s - s_r| / d}

    s_r is the drift at the last reversal and the sign of Z that of the motion since:
    the bond of lead or rubber that each stroke breaks afresh. The state is exact.
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
    nonnegative = ("Fc",)

    def __init__(self, Fc: float | None = None, covariate: str = "vg") -> None:
        super().__init__(covariate, {}, {"Fc": Fc})

    def terms(self) -> tuple[Term, ...]:
        return (Term("Fc", f"sgn(v + {self.covariates[0]})", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v + u[0])


_TAU = Shape("tau", "s", 0.05, 50.0, "s/v")


class _CovariateFriction(CovariateLaw):
    """Base of friction whose level follows a covariate u.

    Its terms are phi, u phi and u v, of a carrier phi.
    """

    carrier = "sgn(v)"
    covariate_units = ("[u]",)

    def terms(self) -> tuple[Term, ...]:
        u = self.covariates[0]
        if self.has_memory:
            u = f"lag[{u}]"
        return (
            Term("Fc", self.carrier, "N"),
            Term("Fu", f"{u} {self.carrier}", "N/[u]"),
            Term("Cu", f"{u} v", "N s/m/[u]"),
        )


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
    special_cases = {
        CoulombFriction: lambda c: CovariateFriction(Fc=c.values[0], Fu=0.0, Cu=0.0)
    }

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


def _lagged(z, u):
    """Lagged covariate; before its state has started, the covariate itself."""
    return z[0] + (1.0 - z[1]) * u[0]


def _move_lag(z, u, dt, tau):
    """Move the lagged covariate, which starts at the covariate."""
    if z[1] == 0.0:
        z[0] = u[0]
        z[1] = 1.0
    z[0] = u[0] + (z[0] - u[0]) * math.exp(-dt / tau)


class LaggedCovariateFriction(_CovariateFriction):
    r"""Friction and damping that follow a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) \operatorname{sgn} v + C_u w v, \quad \tau \dot w = u - w

    (Spencer, Dyke, Sain, Carlson, J. Eng. Mech. 123, 1997, whose eta is 1/tau). The
    lagged covariate w starts in every record at the mean of the first two samples of u,
    and is moved exactly for a covariate that is constant at its mean between samples.
    """

    name = "lagged_covariate_friction"
    family = "friction"
    shapes = (_TAU,)
    n_states = 2  # lagged covariate, 1 once it has started
    acts_at = ("link", "ground")
    variable = "v"
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
        tau: float | None = None,
        Fc: float | None = None,
        Fu: float | None = None,
        Cu: float | None = None,
    ) -> None:
        super().__init__(covariate, {"tau": tau}, {"Fc": Fc, "Fu": Fu, "Cu": Cu})

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        w = _lagged(z, u)
        out[0] = sign
        out[1] = w * sign
        out[2] = w * v

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        _move_lag(z, u, dt, theta[0])


class CovariateDahl(_CovariateFriction):
    r"""Dahl friction that follows a measured covariate u with a first-order lag.

    .. math::
        R = (F_c + F_u w) Z + C_u w v, \quad
        \dot Z = \sigma \dot s \, (1 - Z \operatorname{sgn} \dot s), \quad
        \tau \dot w = u - w

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
        sigma: float | None = None,
        tau: float | None = None,
        Fc: float | None = None,
        Fu: float | None = None,
        Cu: float | None = None,
    ) -> None:
        super().__init__(
            covariate, {"sigma": sigma, "tau": tau}, {"Fc": Fc, "Fu": Fu, "Cu": Cu}
        )

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        w = _lagged(z, u)
        out[0] = z[2]
        out[1] = w * z[2]
        out[2] = w * v

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        _move_lag(z, u, dt, theta[1])
        ds = s1 - s0
        sign = math.copysign(1.0, ds)
        z[2] = sign + (z[2] - sign) * math.exp(-theta[0] * abs(ds))


# Rates just above and below zero, m/s: a jump is complete between the nearer two.
_RATES = np.array([1e-14, -1e-14, 1e-9, -1e-9])


def jump_at_reversal(
    law: ForceLaw, largest: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Change of each column at a velocity reversal.

    Parameters
    ----------
    law : ForceLaw
        With values of its shape parameters.
    largest : array-like of shape (n_covariates,)
        Values of its covariates.

    Returns
    -------
    ndarray of shape (n_terms, 2)
        Between two rates next to zero, and between two farther apart: a force that
        jumps changes by the same amount, a steep one does not.
    """
    zero = np.zeros(len(_RATES))
    u = np.outer(largest, np.ones(len(_RATES)))
    z = np.zeros((law.n_states, len(_RATES)))
    out = np.zeros((len(law.terms()), len(_RATES)))
    law.kernel(zero, _RATES, zero, zero, u, z, law.theta, out)
    return out[:, ::2] - out[:, 1::2]
