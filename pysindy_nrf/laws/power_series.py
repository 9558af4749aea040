"""The paper's power series (eq. 2)."""

from functools import lru_cache

import numpy as np

from ..common import is_whole
from ..exceptions import LawError
from .base import Coefficients, ForceLaw, Term

# Total degree of a power series, or the box of its highest powers of rate and drift.
Order = int | tuple[int, int]

# A higher power is a mistake, or a file that would exhaust the memory.
MAX_POWER = 60


def whole_number(name: str, value: object, least: int = 0) -> int:
    """The value as an int.

    Raises
    ------
    LawError
        If it is no whole number of at least ``least``.
    """
    if not is_whole(value) or int(value) < least:
        raise LawError(
            f"{name}={value!r} is not a whole number of at least {least}",
            "Give e.g. 3.",
        )
    return int(value)


def exponents_of(order: object) -> tuple[tuple[int, int], ...]:
    """Exponents (h, j) of the terms v^h s^j of an order.

    Parameters
    ----------
    order : int or (int, int)
        Total degree h + j, or the box h <= k, j <= q of eq. (2).

    Raises
    ------
    LawError
        If these are no whole numbers from 0 to 60.
    """
    if isinstance(order, (tuple, list)):
        if len(order) != 2:
            raise LawError(
                f"order={order!r} is not a box (k, q)",
                "Give two whole numbers, e.g. (2, 3).",
            )
        k = whole_number("k", order[0])
        q = whole_number("q", order[1])
        total = k + q
    else:
        k = q = total = whole_number("degree", order)
    if max(k, q) > MAX_POWER:
        raise LawError(
            f"degree={order!r} is above the highest power, {MAX_POWER}",
            "Give a lower degree.",
        )
    return _sorted_exponents(k, q, total)


@lru_cache(maxsize=256)
def _sorted_exponents(k: int, q: int, total: int) -> tuple[tuple[int, int], ...]:
    """Exponents h <= k, j <= q up to a total degree, in the order of eq. (9)."""
    pairs = []
    for degree in range(1, total + 1):
        for h in range(degree, -1, -1):
            if h <= k and degree - h <= q:
                pairs.append((h, degree - h))
    return tuple(pairs)


def monomial(h: int, j: int) -> str:
    """Text of v^h s^j, e.g. ``"v^2 s"``."""
    factors = []
    for name, power in (("v", h), ("s", j)):
        if power > 0:
            factors.append(name if power == 1 else f"{name}^{power}")
    return " ".join(factors) or "1"


def monomial_unit(h: int, j: int) -> str:
    """SI unit of the coefficient of v^h s^j in a force."""
    if h + j == 0:
        return "N"
    length = "m" if h + j == 1 else f"m^{h + j}"
    if h == 0:
        return f"N/{length}"
    time = "s" if h == 1 else f"s^{h}"
    return f"N {time}/{length}"


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

    def __init__(self, degree: Order = 3, coefficients: Coefficients = None) -> None:
        self.exponents = exponents_of(degree)
        self.degree: int | tuple[int, ...]
        if isinstance(degree, (tuple, list)):
            self.degree = tuple(int(power) for power in degree)
        else:
            self.degree = int(degree)
        super().__init__({}, coefficients)

    def options(self) -> dict[str, object]:
        if isinstance(self.degree, tuple):
            return {"degree": list(self.degree)}
        return {"degree": self.degree}

    def terms(self) -> tuple[Term, ...]:
        return _terms(self.exponents)

    @property
    def theta(self) -> np.ndarray:
        return np.array(self.exponents, dtype=float).ravel()

    @staticmethod
    def kernel(s, v, a, t, u, z, theta, out):
        for k in range(theta.size // 2):
            product = 0.0 * s + 1.0
            for _ in range(int(theta[2 * k])):
                product = product * v
            for _ in range(int(theta[2 * k + 1])):
                product = product * s
            out[k] = product
