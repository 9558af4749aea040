"""What every model of the comparison sees, and the one ruler."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...regression.chain_model import ChainModel
from ...regression.errors import Pooled, Sizes


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
        pooled = Pooled()
        rms = lambda y: float(np.sqrt(np.mean(y**2)))  # noqa: E731
        for j in range(rest.n_dof):
            force, inertia = rms(rest.F[:, j]), rms(masses[j] * rest.a[:, j])
            residual = rms(masses[j] * (a_hat[:, j] - rest.a[:, j]))
            pooled.add(Sizes(residual, force or inertia, float(self.size[j]), "F" if force else "m a", len(rest.a)))
        return pooled.percent


def shares(kept: set, true: set) -> tuple[float, float]:
    """Precision and recall of the terms kept."""
    right = len(kept & true)
    return right / len(kept) if kept else np.nan, right / len(true) if true else np.nan
