"""SINDy in the comparison as one who knows both would use it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .data import Part
from .plain import PlainSINDy

_HAND_THRESHOLD = 0.01


class HandSteeredSINDy(PlainSINDy):
    """``ps.SINDy`` as one who knows both would use it: inter-storey state, no products between storeys."""

    def __init__(self, degree: int) -> None:
        super().__init__(degree, normalise=True)

    def n_features(self, data: Part) -> int:
        return data.n_dof * (math.comb(2 + self.degree, 2) - 1) + len(data.forced)

    def state(self, data: Part) -> np.ndarray:
        return np.hstack([data.s, data.v])

    def rate(self, data: Part) -> np.ndarray:
        return np.hstack([data.v, np.diff(data.a, axis=1, prepend=0.0)])

    def library(self, data: Part) -> Any:
        from pysindy import GeneralizedLibrary, PolynomialLibrary

        n, m = data.n_dof, len(data.forced)
        storeys = [[j, n + j] for j in range(n)]
        return GeneralizedLibrary(
            [PolynomialLibrary(self.degree, include_bias=False) for _ in storeys]
            + [PolynomialLibrary(1, include_bias=False)],
            inputs_per_library=[*storeys, list(range(2 * n, 2 * n + m))],
        )

    def optimizer(self, data: Part) -> Any:
        from pysindy import STLSQ

        smallest = np.linalg.norm(self.rate(data), axis=0).min()
        return STLSQ(threshold=_HAND_THRESHOLD * smallest, normalize_columns=True)

    def to_absolute(self, rows: np.ndarray) -> np.ndarray:
        return np.cumsum(rows, axis=0)

    def stiffness(self, n: int) -> np.ndarray:
        inter_storey = np.cumsum(self.linear("x", slice(n, 2 * n))[:, :n], axis=0)  # d a / d s
        return inter_storey - np.hstack([inter_storey[:, 1:], np.zeros((n, 1))])

    def displacement(self, position: np.ndarray) -> np.ndarray:
        return position.cumsum(axis=1)
