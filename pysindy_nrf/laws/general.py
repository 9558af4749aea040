"""General laws: what they leave over, no law of their class explains.

They measure a lack of fit and name no effect.
"""

import numpy as np

from .base import Coefficients, ForceLaw, Term
from .hysteresis import Element, Jenkins
from .power_series import whole_number
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

    def __init__(
        self, uy: float | None = None, F: Coefficients = None, n: int = 6
    ) -> None:
        self.n_states = whole_number("n", n, 1)
        self.nonnegative = tuple(term.symbol for term in self.terms())
        super().__init__({"uy": uy}, F)

    def options(self) -> dict[str, object]:
        return {"n": self.n_states}

    def terms(self) -> tuple[Term, ...]:
        n = self.n_states
        return tuple(
            Term(f"F{k}", f"Jenkins[s; uy/{2 ** (n - k)}]", "N")
            for k in range(1, n + 1)
        )

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

    .. math::
        R = \sum_{0 < i + j \le d} c_{i,j} \,
        T_i\!\left(\frac{s}{\sqrt{s^2 + S^2}}\right)
        T_j\!\left(\frac{v}{\sqrt{v^2 + V^2}}\right)

    T are Chebyshev polynomials; of such an argument they resolve most where it is below
    S and V (rational Chebyshev functions: Boyd, J. Comput. Phys. 69, 1987). They follow
    dry friction (V small) as well as polynomials, and are used with a linear spring, a
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
        c: Coefficients = None,
        degree: int = 5,
    ) -> None:
        self.degree = whole_number("degree", degree, 1)
        super().__init__({"S": S, "V": V}, c)

    def options(self) -> dict[str, object]:
        return {"degree": self.degree}

    def terms(self) -> tuple[Term, ...]:
        terms = []
        for i in range(self.degree + 1):
            for j in range(self.degree + 1 - i):
                factors = [f"T{i}(s)"] if i else []
                factors += [f"T{j}(v)"] if j else []
                if factors:
                    terms.append(Term(f"c_{i}_{j}", " ".join(factors), "N"))
        return tuple(terms)

    @property
    def theta(self) -> np.ndarray:
        return np.append(super().theta, self.degree)

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        x = s / np.sqrt(s * s + theta[0] * theta[0])
        y = v / np.sqrt(v * v + theta[1] * theta[1])
        degree = int(theta[2])

        # T_(i+1) = 2 x T_i - T_(i-1), begun with T_0 = 1 and T_(-1) = x
        k = 0
        of_drift = 1.0
        of_drift_before = x
        for i in range(degree + 1):
            product = of_drift
            product_before = y * of_drift
            for j in range(degree + 1 - i):
                if i + j > 0:
                    out[k] = product
                    k += 1
                following = 2.0 * y * product - product_before
                product_before = product
                product = following
            following = 2.0 * x * of_drift - of_drift_before
            of_drift_before = of_drift
            of_drift = following
