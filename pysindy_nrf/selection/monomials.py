"""Any set of terms v^h s^j as one law: the columns of all candidates at a storey."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..laws.base import ForceLaw
from ..laws.motion import Motion
from ..laws.power_series import PowerSeries, exponents_of


class Monomials(PowerSeries):
    """Terms v^h s^j of a given list of exponents; see :class:`~pysindy_nrf.laws.PowerSeries`.

    Parameters
    ----------
    exponents : iterable of (int, int)
    """

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
