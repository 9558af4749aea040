"""Viscoelastic memory."""

from __future__ import annotations

import math

from .base import ForceLaw, Shape, Term


class MaxwellBranch(ForceLaw):
    r"""Spring in series with a dashpot.

    .. math:: R = k z, \quad \dot z = \dot s - z / \tau

    z is the stretch of the spring and ``c = k tau`` its dashpot. It is moved exactly for a drift
    that is linear or quadratic in time over a step.

    Parameters
    ----------
    tau : float, optional
        Relaxation time, s; estimated if None.
    k : float, optional
        Stiffness, N/m.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> print(laws.MaxwellBranch(tau=0.02, k=1e5).equation(1))
    1e+05 Maxwell[s1]  (tau = 0.02)
    """

    name = "maxwell_branch"
    family = "hysteresis"
    shapes = (Shape("tau", "s", 0.3, 20.0, "s/v"),)
    n_states = 1
    passive = True
    nonnegative = ("k",)
    mimics_inertia = True

    def __init__(self, tau: float | None = None, k: float | None = None) -> None:
        super().__init__({"tau": tau}, {"k": k})

    def terms(self) -> tuple[Term, ...]:
        """One term, the stretch of the spring."""
        return (Term("k", "Maxwell[s]", "N/m"),)

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
