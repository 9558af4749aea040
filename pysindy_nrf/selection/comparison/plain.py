"""Plain SINDy in the comparison: with its defaults, and with normalised columns."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from ...regression.chain_model import ChainModel
from .data import Part, shares

_DIVERGED = 1e3


class PlainSINDy:
    """``ps.SINDy`` on state [x | xdot], u = F."""

    finds_masses = False
    note = ""

    def __init__(self, degree: int, normalise: bool) -> None:
        self.degree, self.normalise = degree, normalise

    def n_features(self, data: Part) -> int:
        return math.comb(2 * data.n_dof + len(data.forced) + self.degree, self.degree)

    def work(self, data: Part) -> float:
        """Multiplications of a fit: a few passes of every target over the normal equations."""
        return 10.0 * data.n_dof * len(data.a) * self.n_features(data) ** 2

    def state(self, data: Part) -> np.ndarray:
        return np.hstack([data.x, data.xdot])

    def rate(self, data: Part) -> np.ndarray:
        return np.hstack([data.xdot, data.a])

    def library(self, data: Part) -> Any:
        from pysindy import PolynomialLibrary

        return PolynomialLibrary(self.degree)

    def optimizer(self, data: Part) -> Any:
        from pysindy import STLSQ

        return STLSQ(normalize_columns=self.normalise)

    def fit(self, data: Part) -> None:
        from pysindy import SINDy

        self.forced = data.forced  # a force that is zero throughout would be 0/0 when normalised
        model = SINDy(optimizer=self.optimizer(data), feature_library=self.library(data))
        self.model = model.fit(self.state(data), t=data.dt, x_dot=self.rate(data), u=data.F[:, self.forced])
        self.coefficients = np.asarray(self.model.coefficients())
        self.names = self.model.get_feature_names()

    @property
    def terms(self) -> int:
        return int(np.count_nonzero(self.coefficients))

    def linear(self, prefix: str, rows: slice) -> np.ndarray:
        """Coefficients of the terms x0.. or u0.. in some rows."""
        column = {name: i for i, name in enumerate(self.names)}
        count = sum(1 for name in self.names if name[:1] == prefix and name[1:].isdigit())
        return self.coefficients[rows][:, [column[f"{prefix}{i}"] for i in range(count)]]

    def to_absolute(self, rows: np.ndarray) -> np.ndarray:
        """Rows of accelerations of the state as absolute accelerations of the DOFs."""
        return rows

    def stiffness(self, n: int) -> np.ndarray:
        """d a / d x of the linear terms."""
        return self.linear("x", slice(n, 2 * n))[:, :n]

    def masses(self, data: Part) -> np.ndarray:
        n = data.n_dof
        inverse = self.to_absolute(self.linear("u", slice(n, 2 * n)))
        found = np.full(n, np.nan)
        with np.errstate(divide="ignore"):
            for k, j in enumerate(self.forced):
                found[j] = 1.0 / inverse[j, k]
        return np.where(np.isfinite(found), found, np.nan)

    def predict(self, state: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.model.predict(state, u=u))

    def accelerations(self, data: Part) -> np.ndarray:
        rates = self.predict(self.state(data), data.F[:, self.forced])
        return self.to_absolute(rates[:, data.n_dof :].T).T

    def hits(self, data: Part, truth: ChainModel) -> tuple[float, float]:
        """The true terms are those of an exact fit of the true accelerations at random points."""
        rng = np.random.default_rng(0)
        size = 3 * self.n_features(data)
        draw = [rng.standard_normal((size, y.shape[1])) * y.std(axis=0) for y in (data.v, data.s, data.F)]
        v, s, F = draw
        R = truth.restoring_force(np.hstack([np.zeros_like(s), v, s]))
        a = (F - R + np.hstack([R[:, 1:], np.zeros((size, 1))])) / truth.masses
        points = Part(a, v, s, F, data.dt)
        features = np.asarray(self.model.feature_library.transform(np.hstack([self.state(points), F[:, self.forced]])))
        scale = np.sqrt(np.mean(features**2, axis=0))
        target = self.rate(points)
        target_size = np.sqrt(np.mean(target**2, axis=0))
        exact, *_ = np.linalg.lstsq(features / scale, target / target_size, rcond=None)
        if np.abs(features / scale @ exact - target / target_size).max() > 1e-6:
            return np.nan, np.nan  # the library cannot hold the truth
        true = {tuple(i) for i in np.argwhere(np.abs(exact.T) > 1e-7)}
        return shares({tuple(i) for i in np.argwhere(self.coefficients)}, true)

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        """Stiffness of each storey from the balance above it and from the one below."""
        n = len(masses)
        if n == 1:
            return 0.0, "once"
        K = -masses[:, None] * self.stiffness(n)
        upper, lower = K[np.arange(1, n), np.arange(n - 1)], K[np.arange(n - 1), np.arange(1, n)]
        mean = 0.5 * (np.abs(upper) + np.abs(lower))
        return (float(np.max(100 * np.abs(upper - lower) / mean)) if mean.all() else np.nan), "twice"

    def run(self, data: Part, deadline: float) -> np.ndarray:
        """Runge-Kutta of order four, a step a sample, with the forces linear in between."""
        y, u, h = self.state(data), data.F[:, self.forced], data.dt
        limit = _DIVERGED * np.abs(y).max(axis=0)
        out = np.empty_like(y)
        out[0] = y[0]

        def rate(state: np.ndarray, force: np.ndarray) -> np.ndarray:
            return self.predict(state[None], force[None])[0]

        for i in range(len(y) - 1):
            middle = 0.5 * (u[i] + u[i + 1])
            k1 = rate(out[i], u[i])
            k2 = rate(out[i] + 0.5 * h * k1, middle)
            k3 = rate(out[i] + 0.5 * h * k2, middle)
            out[i + 1] = out[i] + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(out[i] + h * k3, u[i + 1]))
            if not (np.abs(out[i + 1]) <= limit).all():
                raise OverflowError
            if time.perf_counter() > deadline:
                raise TimeoutError
        return self.displacement(out[:, : data.n_dof])

    def displacement(self, position: np.ndarray) -> np.ndarray:
        return position
