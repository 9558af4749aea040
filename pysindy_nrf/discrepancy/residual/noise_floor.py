"""What noise alone would leave of the forces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...diagnosis.residual import Residual, from_top, rms


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Residual that noise alone leaves, N; NaN where unknown.

    Attributes
    ----------
    balance, storey : ndarray of shape (n_dof,)
        Rms in balance j, and summed from the top in storey i.
    draws : list of Residual
        Of noise alone; may be empty.
    motions : dict
        What detection makes of the draws, for the next model.
    """

    balance: np.ndarray
    storey: np.ndarray
    draws: list[Residual] = field(default_factory=list)
    motions: dict[Any, list[Any]] = field(default_factory=dict)

    def at(self, name: str) -> float:
        """Rms at one balance (``"dof 2"``) or storey (``"storey 2"``), N."""
        kind, _, number = name.partition(" ")
        sizes = self.balance if kind == "dof" else self.storey
        return float(sizes[int(number) - 1])

    def covariance(self) -> np.ndarray:
        """Covariance of the noise between the balances, N^2, shape (n_dof, n_dof)."""
        out = np.diag(self.balance**2)
        known = np.isfinite(self.balance)
        sums, n_samples = np.zeros((known.sum(), known.sum())), 0
        for residual in self.draws:
            for balance in residual.balance:
                part = balance[:, known]
                if np.isfinite(part[0]).all():
                    sums += part.T @ part
                    n_samples += len(part)
        if n_samples:
            out[np.ix_(known, known)] = sums / n_samples
        return out

    @classmethod
    def from_draws(cls, draws: list[Residual]) -> NoiseFloor:
        """Noise floor from residuals of noise alone."""
        balances = []
        for residual in draws:
            balances += residual.balance
        return cls(rms(balances), rms([from_top(e) for e in balances]), draws)

    def without_draws(self) -> NoiseFloor:
        """The sizes alone."""
        return NoiseFloor(self.balance, self.storey)
