"""The paper's power series (eq. 2)."""

from functools import lru_cache
from typing import Any

import numpy as np

from ..exceptions import LawError
from .base import ForceLaw, Term


def whole(name: str, value: Any, least: int = 0) -> int:
    """The value as an int; raises LawError if it is no whole number of at least
    ``least``.
    """
    if isinstance(value, bool) or not hasattr(value, "__index__") or int(value) < least:
        raise LawError(
            f"{name}={value!r} is not a whole number of at least {least}",
            "Give e.g. 3.",
        )
    return int(value)


MOST_POWER = 60  # a higher power is a mistake, or a file that would exhaust the memory


def exponents_of(order: Any) -> tuple[tuple[int, int], ...]:
    """Exponents (h, j) of v and s: total degree, or the box h <= k, j <= q of eq.
    (2).
    """
    if isinstance(order, (tuple, list)):
        if len(order) != 2:
            raise LawError(
                f"order={order!r} is not a box (k, q)",
                "Give two whole numbers, e.g. (2, 3).",
            )
        k, q = whole("k", order[0]), whole("q", order[1])
        most = k + q
    else:
        k = q = most = whole("degree", order)
    if max(k, q) > MOST_POWER:
        raise LawError(
            f"degree={order!r} is above the highest power, {MOST_POWER}",
            "Give a lower degree.",
        )
    return _pairs(k, q, most)


@lru_cache(maxsize=256)
def _pairs(k: int, q: int, most: int) -> tuple[tuple[int, int], ...]:
    pairs = [(h, j) for h in range(k + 1) for j in range(q + 1) if 0 < h + j <= most]
    return tuple(sorted(pairs, key=lambda p: (p[0] + p[1], -p[0])))


def monomial(h: int, j: int) -> str:
    """Text of v^h s^j, e.g. ``"v^2 s"``."""
    return (
        " ".join(f"{x}^{n}" if n > 1 else x for x, n in (("v", h), ("s", j)) if n)
        or "1"
    )


def monomial_unit(h: int, j: int) -> str:
    """SI unit of the coefficient of v^h s^j in a force."""
    above = ("s" if h == 1 else f"s^{h}") if h else ""
    below = "m" if h + j == 1 else f"m^{h + j}"
    return f"N {above}/{below}".replace(" /", "/") if h + j else "N"


@lru_cache
def _terms(exponents: tuple[tuple[int, int], ...]) -> tuple[Term, ...]:
    return tuple(
        Term(f"c_{h}_{j}", monomial(h, j), monomial_unit(h, j)) for h, j in exponents
    )


class PowerSeries(ForceLaw):
    r"""Power series in drift and rate (paper eq. 2).

    .. math:: R = \sum_{h, j} c_{h, j} \, v^h s^j, \quad (h, j) \neq (0, 0)

    Parameters
    ----------
    degree : int or (int, int)
        Total degree h + j (3 gives the nine terms of eq. 9), or the box (k, q): h <= k,
        j <= q.
    coefficients : array-like or mapping, optional
        In the order of eq. (9), or by symbol ``"c_h_j"``; N s^h / m^(h+j).

    Raises
    ------
    LawError
        If the degree is not a non-negative integer.

    Examples
    --------
    >>> from pysindy_nrf import laws
    >>> [t.label for t in laws.PowerSeries(3).terms()]
    ['v', 's', 'v^2', 'v s', 's^2', 'v^3', 'v^2 s', 'v s^2', 's^3']
    >>> print(laws.PowerSeries(1, [100.0, 1e5]).equation(2))
    100 v2 + 1e+05 s2
    """

    name = "power_series"
    family = "polynomial"
    symmetry = "none"

    def __init__(
        self, degree: int | tuple[int, int] = 3, coefficients: Any = None
    ) -> None:
        self.exponents = exponents_of(degree)
        self.degree = (
            tuple(int(d) for d in degree)
            if isinstance(degree, (tuple, list))
            else int(degree)
        )
        super().__init__({}, coefficients)

    def options(self) -> dict[str, Any]:
        return {
            "degree": (
                list(self.degree) if isinstance(self.degree, tuple) else self.degree
            )
        }

    def terms(self) -> tuple[Term, ...]:
        return _terms(self.exponents)

    @property
    def theta(self) -> np.ndarray:
        return np.array(self.exponents, dtype=float).ravel()

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        for k in range(theta.size // 2):
            h, j = int(theta[2 * k]), int(theta[2 * k + 1])
            p = 0.0 * s + 1.0
            for _ in range(h):
                p = p * v
            for _ in range(j):
                p = p * s
            out[k] = p
