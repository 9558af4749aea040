"""Dry friction: forces that oppose the direction of motion.

Friction against the ground has no class of its own where the ground does not move: it is
:class:`CoulombFriction` at the site ``"ground j"``. On a moving base, friction against something
that stands still beside the structure is :class:`GroundFriction`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .base import ForceLaw, Shape, Term, covariate_name


class CoulombFriction(ForceLaw):
    r"""Coulomb friction.

    .. math:: R = F_c \operatorname{sgn} v

    At a storey it acts between two floors; at ``"ground j"`` between DOF j and the ground.

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
    family = "friction"
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    nonnegative = ("Fc",)

    def __init__(self, Fc: float | None = None) -> None:
        super().__init__(coefficients={"Fc": Fc})

    def terms(self) -> tuple[Term, ...]:
        """One term, sgn(v)."""
        return (Term("Fc", "sgn(v)", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v)


class AsymmetricFriction(ForceLaw):
    r"""Coulomb friction of different level in the two directions.

    .. math:: R = F_p \, [v > 0] - F_m \, [v < 0]

    The same two columns as Coulomb friction and a constant, ``Fc sgn v + f0`` with
    ``Fp = Fc + f0`` and ``Fm = Fc - f0``, except at ``v = 0``, where this force vanishes.

    Parameters
    ----------
    Fp, Fm : float, optional
        Friction force of the motion with v > 0 and with v < 0, both counted positive, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.AsymmetricFriction(Fp=17.2, Fm=23.6).equation(1))
    17.2 max(sgn(v1), 0) + 23.6 min(sgn(v1), 0)
    """

    name = "asymmetric_friction"
    family = "friction"
    symmetry = "none"
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    nonnegative = ("Fp", "Fm")
    special_cases = {CoulombFriction: lambda c: AsymmetricFriction(Fp=c.values[0], Fm=c.values[0])}

    def __init__(self, Fp: float | None = None, Fm: float | None = None) -> None:
        super().__init__(coefficients={"Fp": Fp, "Fm": Fm})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, the positive and the negative part of sgn(v)."""
        return (Term("Fp", "max(sgn(v), 0)", "N"), Term("Fm", "min(sgn(v), 0)", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        out[0] = np.maximum(sign, 0.0)
        out[1] = np.minimum(sign, 0.0)


class StribeckFriction(ForceLaw):
    r"""Friction that falls from a static to a sliding level.

    .. math:: R = \operatorname{sgn} v \, (F_c + \Delta F \, e^{-|v| / v_s})

    The static level is ``Fc + dF`` (Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30,
    1994, with the exponent 1 of Tustin).

    Parameters
    ----------
    vs : float, optional
        Stribeck velocity, m/s; estimated if None.
    Fc : float, optional
        Sliding friction force, N.
    dF : float, optional
        Static minus sliding friction force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> laws.StribeckFriction(vs=0.01, Fc=20.0, dF=8.0).parameters
    {'vs': 0.01, 'Fc': 20.0, 'dF': 8.0}
    """

    name = "stribeck_friction"
    family = "friction"
    shapes = (Shape("vs", "m/s", 0.02, 2.0, "v"),)
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    nonnegative = ("Fc",)
    expected_positive = ("dF",)  # one that falls towards rest is a way to write a force that grows with the rate
    special_cases = {CoulombFriction: lambda c: StribeckFriction(vs=1.0, Fc=c.values[0], dF=0.0)}

    def __init__(self, vs: float | None = None, Fc: float | None = None, dF: float | None = None) -> None:
        super().__init__({"vs": vs}, {"Fc": Fc, "dF": dF})

    def terms(self) -> tuple[Term, ...]:
        """Two terms, sgn(v) and its decaying part."""
        return (Term("Fc", "sgn(v)", "N"), Term("dF", "sgn(v) exp(-|v|/vs)", "N"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        sign = np.sign(v)
        out[0] = sign
        out[1] = sign * np.exp(-np.minimum(np.abs(v) / theta[0], 700.0))


class ShiftedFriction(ForceLaw):
    r"""Friction that reverses where v + kappa s does, not at the reversal of the motion.

    .. math:: R = F_c \operatorname{sgn}(v + \kappa s)

    The sharp form of the damper model of Guo, Yang and Pan (J. Intell. Mater. Syst. Struct. 17,
    2006). With kappa > 0 the force lags the velocity, as with a soft seal or a fluid under
    pressure in a magnetorheological damper.

    Parameters
    ----------
    kappa : float, optional
        Slope of the line of reversal in the (s, v) plane, 1/s; estimated if None.
    Fc : float, optional
        Friction force, N.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.ShiftedFriction(kappa=2.0, Fc=300.0).equation(1))
    300 sgn(v1 + kappa s1)  (kappa = 2)
    """

    name = "shifted_friction"
    family = "friction"
    shapes = (Shape("kappa", "1/s", 0.01, 3.0, "v/s"),)
    passive = True
    acts_at = ("link", "ground")
    variable = "v"
    jumps = True
    nonnegative = ("Fc",)
    special_cases = {CoulombFriction: lambda c: ShiftedFriction(kappa=1e-12, Fc=c.values[0])}

    def __init__(self, kappa: float | None = None, Fc: float | None = None) -> None:
        super().__init__({"kappa": kappa}, {"Fc": Fc})

    def terms(self) -> tuple[Term, ...]:
        """One term, sgn(v + kappa s)."""
        return (Term("Fc", "sgn(v + kappa s)", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v + theta[0] * s)


class GroundFriction(ForceLaw):
    r"""Coulomb friction against something that stands still while the base moves.

    .. math:: R = F_c \operatorname{sgn}(v + v_g)

    v is the velocity of the DOF relative to the base and ``v_g`` the velocity of the base, so that
    their sum is the absolute velocity (Lathourakis and Cicirello, Nonlinear Dynamics, 2024). With
    a resting base it is :class:`CoulombFriction` at ``"ground j"``.

    Parameters
    ----------
    Fc : float, optional
        Friction force, N.
    covariate : str
        Name of the channel that holds the velocity of the base, m/s.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> law = laws.GroundFriction(Fc=3.0)
    >>> law.covariates, law.equation(1)
    (('vg',), '3 sgn(v1 + vg)')
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

    def __init__(self, Fc: float | None = None, covariate: str = "vg") -> None:
        self.covariates = (covariate_name(covariate),)
        super().__init__(coefficients={"Fc": Fc})

    def options(self) -> dict[str, Any]:
        """Structural arguments: the covariate."""
        return {"covariate": self.covariates[0]}

    def terms(self) -> tuple[Term, ...]:
        """One term, the sign of the absolute velocity."""
        return (Term("Fc", f"sgn(v + {self.covariates[0]})", "N"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v + u[0])
