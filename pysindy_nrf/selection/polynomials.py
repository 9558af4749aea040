"""Monomials v^h s^j and the orthogonal polynomials in which orders are compared."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from ..laws.base import ForceLaw, Recurrence, Term
from ..laws.power_series import PowerSeries, exponents_of
from ..laws.shape import Motion


class Monomials(PowerSeries):
    """Terms v^h s^j of a given list of exponents; see :class:`~pysindy_nrf.laws.PowerSeries`."""

    def __init__(self, exponents: Iterable[tuple[int, int]]) -> None:
        self.exponents = tuple(sorted(set(exponents), key=lambda p: (p[0] + p[1], -p[0])))
        self.degree = max((h + j for h, j in self.exponents), default=0)
        ForceLaw.__init__(self, {}, None)

    @classmethod
    def holding(cls, orders: Iterable[Any]) -> Monomials:
        """The terms of several orders (total degrees, or boxes (k, q)) together."""
        return cls(pair for order in orders for pair in exponents_of(order))

    def positions(self, order: Any) -> np.ndarray:
        """Where the terms of one order stand among these."""
        place = {pair: i for i, pair in enumerate(self.exponents)}
        return np.array([place[pair] for pair in exponents_of(order)], dtype=int)

    def features(self, motion: Motion, state: Any = None) -> np.ndarray:
        """Columns, by one multiplication each."""
        return self._products(*(
            _powers(x, max((p[i] for p in self.exponents), default=0)) for i, x in enumerate((motion.v, motion.s))
        ))  # fmt: skip

    def _products(self, of_v: np.ndarray, of_s: np.ndarray) -> np.ndarray:
        """Column (h, j) is row h of the first times row j of the second."""
        out = np.empty((len(self.exponents), of_v.shape[1]))
        for row, (h, j) in zip(out, self.exponents):
            np.multiply(of_v[h], of_s[j], out=row)
        return out.T


def _powers(x: np.ndarray, highest: int) -> np.ndarray:
    out = np.ones((highest + 1, len(x)))
    for k in range(1, highest + 1):
        np.multiply(out[k - 1], x, out=out[k])
    return out


class Polynomials:
    """Polynomials of one variable without a constant term, orthogonal on a sample, and 1.

    With y = x / scale: p_0 = 1, p_1 = y, p_{k+1} = (y - a_k) p_k - b_k p_{k-1}, where b_1 = 0. They are y times the
    polynomials that are orthogonal with the weight y^2 (W. Gautschi, Orthogonal polynomials, 2004, section 2.2).

    Parameters
    ----------
    x : ndarray
        The sample.
    highest : int
    """

    def __init__(self, x: np.ndarray, highest: int) -> None:
        self.highest = highest
        self.scale = float(np.sqrt(np.mean(x**2))) if x.size else 0.0
        self.scale = self.scale or 1.0  # nothing moves
        self.a, self.b = np.zeros((2, max(highest, 1)))
        y = x / self.scale
        p, below, size = y, np.zeros(len(y)), 0.0
        for k in range(1, highest):
            squares = float(p @ p)
            if not squares:
                break  # fewer different values than powers
            self.a[k] = (y * p) @ p / squares
            self.b[k] = squares / size if size else 0.0
            p, below, size = (y - self.a[k]) * p - self.b[k] * below, p, squares

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Values, shape (highest + 1, n)."""
        out = np.ones((self.highest + 1, len(x)))
        if self.highest:
            np.divide(x, self.scale, out=out[1])
        for k in range(1, self.highest):
            np.subtract(out[1], self.a[k], out=out[k + 1])
            out[k + 1] *= out[k]
            if k > 1:
                out[k + 1] -= self.b[k] * out[k - 1]
        return out

    def step(self, k: int) -> tuple[float, float, float]:
        """g, h, c of the recurrence p_k = (g x + h) p_{k-1} + c p_{k-2}, with the last where k > 2."""
        return 1.0 / self.scale, -self.a[k - 1], -self.b[k - 1]

    @cached_property
    def powers(self) -> np.ndarray:
        """Coefficients of the powers of x in the polynomials: x^h is the sum over k of powers[k, h] p_k."""
        size = self.highest + 1
        times_y = np.diag(np.ones(self.highest), -1)  # y p_k = p_{k+1} + a_k p_k + b_k p_{k-1}
        inside = np.arange(1, self.highest)
        times_y[inside, inside] = self.a[1:]
        times_y[inside[:-1], inside[1:]] = self.b[2:]
        out = np.eye(size)
        for h in inside:
            out[:, h + 1] = times_y @ out[:, h]
        return out * self.scale ** np.arange(size)


class OrthogonalPowers(Monomials):
    """Products P_h(v) Q_j(s) that span the powers v^h s^j.

    Parameters
    ----------
    exponents : iterable of (int, int)
        Of the powers; with every pair all lower ones but (0, 0), as orders have them.
    v, s : ndarray of shape (n,)
        A sample of the motion.
    """

    def __init__(self, exponents: Iterable[tuple[int, int]], v: np.ndarray, s: np.ndarray) -> None:
        super().__init__(exponents)
        self._v, self._s = (
            Polynomials(x, max((p[i] for p in self.exponents), default=0)) for i, x in enumerate((v, s))
        )

    def terms(self) -> tuple[Term, ...]:
        """One term for each product."""
        return tuple(Term(f"q_{h}_{j}", f"P{h}(v) Q{j}(s)", "N") for h, j in self.exponents)

    def features(self, motion: Motion, state: Any = None) -> np.ndarray:
        """Columns, by one multiplication each."""
        return self._products(self._v(motion.v), self._s(motion.s))

    def recurrence(self) -> Recurrence:
        """Along s from one column to the next, and along v where there is no s."""
        place = {pair: i for i, pair in enumerate(self.exponents)}
        rows, numbers = [], []
        for (h, j), i in place.items():
            along, k = (self._s, j) if j else (self._v, h)
            below, second = ((h, j - n) if j else (h - n, 0) for n in (1, 2))
            rows.append((i, int(j > 0), place.get(below, -1), place[second] if k > 2 else -1))
            numbers.append(along.step(k))
        return Recurrence(np.array(rows, dtype=np.int64).reshape(-1, 4), np.array(numbers).reshape(-1, 3))

    @property
    def change(self) -> np.ndarray:
        """The columns times this are the powers, shape (n_terms, n_terms)."""
        h, j = np.array(self.exponents).reshape(-1, 2).T
        return self._v.powers[np.ix_(h, h)] * self._s.powers[np.ix_(j, j)]
