"""Dampers, springs, and elements whose coefficient changes during a record."""

import math

import numpy as np

from .base import ForceLaw, Term
from .hysteresis import Element
from .shape import Shape


class _Damper(ForceLaw):
    """Base of forces that oppose the rate."""

    family = "damping"
    passive = True
    variable = "v"


class _Spring(ForceLaw):
    """Base of forces that follow the drift alone."""

    family = "stiffness"
    passive = True
    variable = "s"


class QuadraticDamping(_Damper):
    """Quadratic damping, ``R = c2 v |v|``: drag of a turbulent fluid (Morison)."""

    name = "quadratic_damping"
    columns = (Term("c2", "v |v|", "N s^2/m^2"),)
    nonnegative = ("c2",)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * np.abs(v)


class PowerLawDamping(_Damper):
    r"""Power-law damping, ``R = cn sgn(v) |v|^n``.

    Fluid viscous dampers have n between 0.3 and 1 (Constantinou and Symans, 1993); n =
    0 is Coulomb friction, n = 1 linear and n = 2 quadratic damping.
    """

    name = "power_law_damping"
    # published fluid dampers have n of at least 0.3
    shapes = (Shape("n", "1", 0.15, 4.0, friction_below=0.25),)
    columns = (Term("cn", "sgn(v) |v|^n", "N s^n/m^n"),)
    nonnegative = ("cn",)
    special_cases = {QuadraticDamping: lambda c: PowerLawDamping(n=2.0, cn=c.values[0])}

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = np.sign(v) * np.abs(v) ** theta[0]


class DisplacementDependentDamping(_Damper):
    """Damping that grows with the drift, ``R = c s^2 v`` (van der Pol)."""

    name = "displacement_dependent_damping"
    columns = (Term("c", "v s^2", "N s/m^3"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * s * s


class MaxwellBranch(Element):
    r"""Spring in series with a dashpot.

    .. math:: R = k z, \quad \dot z = \dot s - z / \tau

    z is the elongation of the spring and ``c = k tau`` the damping of the dashpot. The
    state is exact for a drift that is linear or quadratic in time over a step.
    """

    name = "maxwell_branch"
    shapes = (Shape("tau", "s", 0.3, 20.0, "s/v"),)
    columns = (Term("k", "Maxwell[s]", "N/m"),)
    nonnegative = ("k",)
    mimics_inertia = True

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        if dt <= 0.0:
            z[0] += s1 - s0
            return

        # The rate is (s1 - s0) / dt + (v1 - v0) (t / dt - 1/2). Its integral over the
        # step, weighted with exp(-(dt - t) / tau), has one factor for each part.
        x = dt / theta[0]
        if x > 0.05:
            of_mean = -math.expm1(-x) / x
            of_change = (1.0 - of_mean) / x - 0.5 * of_mean
        else:  # series, where the difference above loses digits
            of_mean = 1.0 - x / 2.0 + x * x / 6.0 - x**3 / 24.0 + x**4 / 120.0
            of_change = x / 12.0 - x * x / 24.0 + x**3 / 80.0 - x**4 / 360.0

        decayed = z[0] * math.exp(-x)
        z[0] = decayed + (s1 - s0) * of_mean + (v1 - v0) * dt * of_change


class LinearElastic(_Spring):
    """Linear spring, ``R = k s``.

    Parameters
    ----------
    k : float, optional
        Stiffness, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LinearElastic(k=1e5).equation(1))
    1e+05 s1
    """

    name = "linear_elastic"
    columns = (Term("k", "s", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s


class LinearViscous(_Damper):
    """Linear dashpot, ``R = c v``.

    Parameters
    ----------
    c : float, optional
        Damping, N s/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.LinearViscous(c=100.0).equation(1))
    100 v1
    """

    name = "linear_viscous"
    columns = (Term("c", "v", "N s/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v


class Duffing(_Spring):
    """Linear and cubic spring, ``R = k s + k3 s^3``.

    Parameters
    ----------
    k : float, optional
        Linear stiffness, N/m.
    k3 : float, optional
        Cubic stiffness, N/m^3.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.Duffing(k=1e5, k3=1e9).equation(1))
    1e+05 s1 + 1e+09 s1^3
    """

    name = "duffing"
    columns = (Term("k", "s", "N/m"), Term("k3", "s^3", "N/m^3"))

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s
        out[1] = s * s * s


class QuadraticStiffness(_Spring):
    """Quadratic spring, ``R = k2 s^2``: stiffer in one direction (a cable, an arch)."""

    name = "quadratic_stiffness"
    columns = (Term("k2", "s^2", "N/m^2"),)
    symmetry = "even"

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * s


class AbsoluteQuadraticStiffness(_Spring):
    """Odd quadratic spring, ``R = k2 s |s|``."""

    name = "absolute_quadratic_stiffness"
    columns = (Term("k2", "s |s|", "N/m^2"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * np.abs(s)


class CubicStiffness(_Spring):
    """Cubic spring, ``R = k3 s^3``: hardening for k3 > 0, softening for k3 < 0.

    Parameters
    ----------
    k3 : float, optional
        Coefficient, N/m^3.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.CubicStiffness(k3=1e9).equation(1))
    1e+09 s1^3
    """

    name = "cubic_stiffness"
    columns = (Term("k3", "s^3", "N/m^3"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * s * s


class QuinticStiffness(_Spring):
    """Quintic spring, ``R = k5 s^5``."""

    name = "quintic_stiffness"
    columns = (Term("k5", "s^5", "N/m^5"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        square = s * s
        out[0] = square * square * s


class _Changing(ForceLaw):
    """Base of properties that change with time, for good; t is that of the record."""

    family = "degradation"
    stands_for = "change in time"
    uses_time = True
    permanent_change = True


class StiffnessStep(_Changing):
    """Stiffness that changes suddenly, ``R = dk s`` after time t0.

    Parameters
    ----------
    t0 : float, optional
        Time of the change on the clock of the record, s; estimated if None.
    dk : float, optional
        Stiffness after minus stiffness before, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.StiffnessStep(t0=12.0, dk=-2e4).equation(2))
    -2e+04 s2 [t > t0]  (t0 = 12 s)
    """

    name = "stiffness_step"
    shapes = (Shape("t0", "s", 0.05, 0.95, "t", log=False, instant=True),)
    columns = (Term("dk", "s [t > t0]", "N/m"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * np.maximum(np.sign(t - theta[0]), 0.0)


class StiffnessDrift(_Changing):
    """Stiffness that changes steadily, ``R = kt s t``.

    Parameters
    ----------
    kt : float, optional
        Rate of change of the stiffness, N/(m s).

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.StiffnessDrift(kt=-300.0).equation(2))
    -300 s2 t
    """

    name = "stiffness_drift"
    columns = (Term("kt", "s t", "N/(m s)"),)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = s * t


class DampingDrift(_Changing):
    """Damping that changes steadily, ``R = ct v t``: a damper that warms up."""

    name = "damping_drift"
    columns = (Term("ct", "v t", "N/m"),)
    passive = True

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        out[0] = v * t
