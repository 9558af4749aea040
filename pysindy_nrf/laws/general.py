"""General laws: what they leave, no law of their class explains. They measure a lack of
fit and name no effect.
"""

from typing import Any

import numpy as np

from .base import ForceLaw, Term
from .hysteresis import Element, Jenkins
from .power_series import whole
from .shape import Shape


class PrandtlIshlinskii(Element):
    r"""Elasto-plastic elements side by side: the general hysteresis of Masing's kind.

    .. math:: R = \sum_{k=1}^{n} F_k Z_k

    with :class:`Jenkins` states of the yield drifts ``uy / 2^(n-1), ..., uy / 2, uy``.
    Non-negative F describe any backbone that softens, and its loops (Iwan, J. Appl.
    Mech. 33, 1966).
    """

    name = "prandtl_ishlinskii"
    shapes = (Shape("uy", "m", 0.2, 4.0, "s"),)
    saturates_at = "uy"
    special_cases = {
        Jenkins: lambda c: PrandtlIshlinskii(c.theta[0], [0.0] * 5 + [c.values[0]])
    }

    def __init__(self, uy: float | None = None, F: Any = None, n: int = 6) -> None:
        self.n_states = whole("n", n, 1)  # type: ignore[misc]
        super().__init__({"uy": uy}, F)

    def options(self) -> dict[str, Any]:
        return {"n": self.n_states}

    def terms(self) -> tuple[Term, ...]:
        parts = range(self.n_states, 0, -1)
        return tuple(
            Term(f"F{self.n_states + 1 - k}", f"Jenkins[s; uy/{2 ** (k - 1)}]", "N")
            for k in parts
        )

    @property
    def nonnegative(self) -> tuple[str, ...]:  # type: ignore[override]
        """All forces."""
        return tuple(term.symbol for term in self.terms())

    @property
    def theta(self) -> np.ndarray:
        return super().theta / 2.0 ** np.arange(self.n_states - 1, -1, -1)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        for k in range(theta.size):
            out[k] = z[k]

    @staticmethod
    def advance(z, s0, v0, s1, v1, dt, u, theta):
        for k in range(theta.size):
            z[k] = min(max(z[k] + (s1 - s0) / theta[k], -1.0), 1.0)


class SmoothSurface(ForceLaw):
    r"""A flexible function of drift and rate: the general law without memory.

    .. math:: R = \sum_{0 < i + j \le d} c_{i,j} \, T_i\!\left(\frac{s}{\sqrt{s^2 + S^2}}\right)
        T_j\!\left(\frac{v}{\sqrt{v^2 + V^2}}\right)

    T are Chebyshev polynomials; of such an argument they resolve most where it is below
    S and V (rational Chebyshev functions: Boyd, J. Comput. Phys. 69, 1987). They follow
    dry friction (V small) as well as polynomials, and stand beside a linear spring, a
    linear damper and a constant.
    """

    name = "smooth_surface"
    family = "surface"
    shapes = (Shape("S", "m", 0.1, 5.0, "s"), Shape("V", "m/s", 0.02, 5.0, "v"))
    symmetry = "none"
    at_rest = None

    def __init__(
        self,
        S: float | None = None,
        V: float | None = None,
        c: Any = None,
        degree: int = 5,
    ) -> None:
        self.degree = whole("degree", degree, 1)
        super().__init__({"S": S, "V": V}, c)

    def options(self) -> dict[str, Any]:
        return {"degree": self.degree}

    def terms(self) -> tuple[Term, ...]:
        pairs = [
            (i, j)
            for i in range(self.degree + 1)
            for j in range(self.degree + 1 - i)
            if i + j
        ]
        labels = [
            " ".join([f"T{i}(s)"] * (i > 0) + [f"T{j}(v)"] * (j > 0)) for i, j in pairs
        ]
        return tuple(
            Term(f"c_{i}_{j}", label, "N") for (i, j), label in zip(pairs, labels)
        )

    @property
    def theta(self) -> np.ndarray:
        return np.append(super().theta, self.degree)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        x, y = (
            s / np.sqrt(s * s + theta[0] * theta[0]),
            v / np.sqrt(v * v + theta[1] * theta[1]),
        )
        degree = int(theta[2])
        k, of_drift, last = 0, 1.0, x  # T_0 and T_-1; T_i+1 = 2 x T_i - T_i-1
        for i in range(degree + 1):
            both, before = of_drift, y * of_drift
            for j in range(degree + 1 - i):
                if i + j > 0:
                    out[k] = both
                    k += 1
                both, before = 2.0 * y * both - before, both
            of_drift, last = 2.0 * x * of_drift - last, of_drift
