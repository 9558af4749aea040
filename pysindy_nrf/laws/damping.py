"""Nonlinear and viscoelastic damping."""

from __future__ import annotations

import math

import numpy as np

from .base import ForceLaw, Term
from .shape import Shape


class QuadraticDamping(ForceLaw):
    """Quadratic damping, ``R = c2 v |v|``: drag of a turbulent fluid (Morison)."""

    name = "quadratic_damping"
    family = "damping"
    columns = (Term("c2", "v |v|", "N s^2/m^2"),)
    passive = True
    variable = "v"
    nonnegative = ("c2",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * np.abs(v)


class PowerLawDamping(ForceLaw):
    r"""Power-law damping, ``R = cn sgn(v) |v|^n``.

    Fluid viscous dampers have n between 0.3 and 1 (Constantinou and Symans, 1993); n = 0 is Coulomb
    friction, n = 1 linear and n = 2 quadratic damping.
    """

    name = "power_law_damping"
    family = "damping"
    # published fluid dampers have n of at least 0.3
    shapes = (Shape("n", "1", 0.15, 4.0, friction_below=0.25),)
    columns = (Term("cn", "sgn(v) |v|^n", "N s^n/m^n"),)
    passive = True
    variable = "v"
    nonnegative = ("cn",)
    special_cases = {QuadraticDamping: lambda c: PowerLawDamping(n=2.0, cn=c.values[0])}

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v) * np.abs(v) ** theta[0]


class DisplacementDependentDamping(ForceLaw):
    """Damping that grows with the drift, ``R = c s^2 v`` (van der Pol)."""

    name = "displacement_dependent_damping"
    family = "damping"
    columns = (Term("c", "v s^2", "N s/m^3"),)
    passive = True
    variable = "v"

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * s * s


class MaxwellBranch(ForceLaw):
    r"""Spring in series with a dashpot.

    .. math:: R = k z, \quad \dot z = \dot s - z / \tau

    z is the elongation of the spring and ``c = k tau`` the damping of the dashpot. The state is exact for a
    drift that is linear or quadratic in time over a step.
    """

    name = "maxwell_branch"
    family = "hysteresis"
    shapes = (Shape("tau", "s", 0.3, 20.0, "s/v"),)
    columns = (Term("k", "Maxwell[s]", "N/m"),)
    n_states = 1
    passive = True
    nonnegative = ("k",)
    mimics_inertia = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = z[0]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if dt <= 0.0:
            z[0] += s1 - s0
            return
        x = dt / theta[0]
        # integral over the step of exp(-(dt - t) / tau) (mean rate + (v1 - v0) (t / dt - 1/2)) dt
        if x > 0.05:
            first = -math.expm1(-x) / x
            second = (1.0 - first) / x - 0.5 * first
        else:
            first = 1.0 - x / 2.0 + x * x / 6.0 - x**3 / 24.0 + x**4 / 120.0
            second = x / 12.0 - x * x / 24.0 + x**3 / 80.0 - x**4 / 360.0
        z[0] = z[0] * math.exp(-x) + (s1 - s0) * first + (v1 - v0) * dt * second
