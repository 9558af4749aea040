"""Plain SINDy, SINDy set up by an expert, and this package: the contenders of a comparison, on the same data."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...estimation.regressor import NRFRegressor
from ...regression.chain_model import ChainModel
from ...regression.errors import Sizes, pooled_percent
from ..sparsity import select_sparsity


@dataclass
class Part:
    """Absolute accelerations, inter-storey rates and drifts, forces of one record."""

    a: np.ndarray
    v: np.ndarray
    s: np.ndarray
    F: np.ndarray
    dt: float

    def part(self, rows: slice) -> Part:
        return Part(self.a[rows], self.v[rows], self.s[rows], self.F[rows], self.dt)

    @property
    def x(self) -> np.ndarray:
        return self.s.cumsum(axis=1)

    @property
    def xdot(self) -> np.ndarray:
        return self.v.cumsum(axis=1)

    @property
    def X(self) -> np.ndarray:
        return np.hstack([self.a, self.v, self.s])

    @property
    def n_dof(self) -> int:
        return self.a.shape[1]

    @property
    def forced(self) -> np.ndarray:
        return np.flatnonzero(self.F.any(axis=0))


@dataclass
class Ruler:
    """What every row is judged by: masses, true storey forces on the held-out part, their rms."""

    model: ChainModel
    known: bool
    R: np.ndarray
    size: np.ndarray

    @classmethod
    def of(cls, model: ChainModel, known: bool, whole: Part, cut: int) -> Ruler:
        R = model.restoring_force(whole.X, dt=whole.dt)[cut:]
        return cls(model, known, R, np.sqrt(np.mean(R**2, axis=0)))

    def force_error(self, R: np.ndarray) -> float:
        share = np.sqrt(np.mean((R - self.R) ** 2, axis=0)) / self.size
        return float(100 * np.sqrt(np.mean(share**2)))

    def balance_error(self, masses: np.ndarray, a_hat: np.ndarray, rest: Part) -> float:
        balances = []
        rms = lambda y: float(np.sqrt(np.mean(y**2)))  # noqa: E731
        for j in range(rest.n_dof):
            force, inertia = rms(rest.F[:, j]), rms(masses[j] * rest.a[:, j])
            residual = rms(masses[j] * (a_hat[:, j] - rest.a[:, j]))
            size = float(self.size[j])
            balances.append(Sizes(residual, force or inertia, size, "F" if force else "m a", len(rest.a)))
        return pooled_percent(balances)


def shares(kept: set, true: set) -> tuple[float, float]:
    """Precision and recall of the terms kept."""
    right = len(kept & true)
    return right / len(kept) if kept else np.nan, right / len(true) if true else np.nan


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


class Ours:
    """NRFRegressor with some optimizer, or with the one of several that the held-out rule chooses."""

    finds_masses = True
    note = ""

    def __init__(self, degree: int, optimizer: Any) -> None:
        self.degree, self.optimizer = degree, optimizer
        self._chosen: dict[str, Any] = {"optimizer": optimizer}

    def work(self, data: Part) -> float:
        return 0.0

    def fit(self, data: Part) -> None:
        if isinstance(self.optimizer, Sequence):
            self._choose(data)
        self.model = NRFRegressor(degree=self.degree, dt=data.dt).set_params(**self._chosen).fit(data.X, data.F)

    def _choose(self, data: Part) -> None:
        """By the held-out rule, once: the second fit, which measures the memory, takes what the first has chosen."""
        found = select_sparsity(data.X, data.F, paths={"path": self.optimizer}, degree=self.degree, dt=data.dt)
        self.note = f"chosen: {found.table.index[found.table['chosen']][0][1]}"
        one = found.regressor("path").get_params(deep=False)
        self._chosen = {"optimizer": one["optimizer"], "laws": one["laws"]}
        self.optimizer = None

    @property
    def terms(self) -> int:
        laws = sum(int(np.count_nonzero(R.coefficients)) for R in self.model.restoring_forces_.values())
        return len(self.model.masses_) + laws

    def masses(self, data: Part) -> np.ndarray:
        return self.model.masses_

    def accelerations(self, data: Part) -> np.ndarray:
        return data.a + (data.F - self.model.predict(data.X)) / self.model.masses_

    def hits(self, data: Part, truth: ChainModel) -> tuple[float, float]:
        def kept(forces: Any) -> set[tuple[str, str]]:
            return {(str(site), label) for site, R in forces.items() for label, c in R.coefficients.items() if c}

        return shares(kept(self.model.restoring_forces_), kept(truth.restoring_forces))

    def third_law(self, masses: np.ndarray) -> tuple[float, str]:
        gap = self.model.third_law_gap_
        return (float(gap.max()), "twice") if len(gap) else (0.0, "once")

    def run(self, data: Part, deadline: float) -> np.ndarray:
        return self.model.simulate(data.F, x0=data.x[0], v0=data.xdot[0]).displacement
