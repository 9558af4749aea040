"""What noise alone would leave of the forces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ...chain.sites import Site
from ..residual import Residual, from_top, rms

if TYPE_CHECKING:
    from .detection import MotionRegression

# Sites of a chain, and every how many samples are read.
SitesAndThinning = tuple[tuple[Site, ...], int]


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

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.diagnosis import NoiseFloor
    >>> floor = NoiseFloor(
    ...     balance=np.array([0.3, 0.2]), storey=np.array([0.4, 0.2])
    ... )
    >>> float(floor.rms_at("storey 1"))
    0.4
    """

    balance: np.ndarray
    storey: np.ndarray
    draws: list[Residual] = field(default_factory=list)
    motions: dict[SitesAndThinning, list[MotionRegression]] = field(
        default_factory=dict
    )

    def rms_at(self, name: str) -> float:
        """Rms at one balance or storey, N.

        Parameters
        ----------
        name : str
            Such as ``"dof 2"`` or ``"storey 2"``.
        """
        kind, _, number = name.partition(" ")
        sizes = self.balance if kind == "dof" else self.storey
        return float(sizes[int(number) - 1])

    def covariance(self) -> np.ndarray:
        """Covariance of the noise between the balances.

        Returns
        -------
        ndarray of shape (n_dof, n_dof)
            N^2.
        """
        out = np.diag(self.balance**2)
        known = np.isfinite(self.balance)
        sums, n_samples = np.zeros((known.sum(), known.sum())), 0
        for residual in self.draws:
            for balance in residual.balance:
                known_part = balance[:, known]
                if np.isfinite(known_part[0]).all():
                    sums += known_part.T @ known_part
                    n_samples += len(known_part)
        if n_samples:
            out[np.ix_(known, known)] = sums / n_samples
        return out

    @classmethod
    def from_draws(cls, draws: list[Residual]) -> NoiseFloor:
        """Noise floor from residuals of noise alone.

        Parameters
        ----------
        draws : list of Residual
        """
        balances = []
        for residual in draws:
            balances += residual.balance
        return cls(rms(balances), rms([from_top(e) for e in balances]), draws)

    def without_draws(self) -> NoiseFloor:
        """The sizes alone."""
        return NoiseFloor(self.balance, self.storey)
