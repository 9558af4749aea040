"""Informative bands: where a chain explains its balances, and errors are reported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .error_reduction import REDUCTION


@dataclass(frozen=True)
class BandSettings:
    """Numbers that make a band informative."""

    # Share of the energy of a balance that its core of strongest bands holds.
    core_energy: float = 0.9
    # A band is informative if a chain leaves less than half of its power: then the
    # signal exceeds what is not explained.
    unexplained: float = 0.5
    # Errors are reported in bands that leave at most ten times (10 dB) the typical
    # share; the top band of the Silverbox leaves 30 dB more.
    above_typical: float = 10.0
    # Iterations of the bands and the fits in them; they settle in three or four.
    rounds: int = 6


BANDS = BandSettings()


@dataclass(frozen=True, eq=False)
class InformativeBands:
    """Bands of each balance that decide, and those in which errors are reported.

    Attributes
    ----------
    informative, clear : ndarray of bool, shape (n_balances, n_bands)
    """

    informative: np.ndarray
    clear: np.ndarray

    @classmethod
    def all(cls, n_balances: int, n_bands: int) -> InformativeBands:
        """All bands."""
        every = np.ones((n_balances, n_bands), dtype=bool)
        return cls(every, every)

    @property
    def n_bands(self) -> int:
        """Number of bands."""
        return self.informative.shape[1]

    def with_lowest(self) -> InformativeBands:
        """The same with the lowest band, in which the means are, in every balance."""
        informative, clear = self.informative.copy(), self.clear.copy()
        informative[:, 0] = True
        clear[:, 0] = True
        return InformativeBands(informative, clear)

    def up_to_last(self) -> InformativeBands:
        """The same without the bands above the last informative one."""
        last = int(np.flatnonzero(self.informative.any(axis=0))[-1])
        lowest = slice(0, last + 1)
        return InformativeBands(self.informative[:, lowest], self.clear[:, lowest])

    def clear_power(self, power: np.ndarray) -> np.ndarray:
        """Power of each balance in its clear bands."""
        return (power * self.clear).sum(axis=1)

    def limits(
        self, edges: np.ndarray, fastest: float
    ) -> tuple[float | None, float | None]:
        """Lowest and highest frequency of all clear bands, Hz.

        None where no end was found: at zero, and at half the sampling rate.
        """
        n_bands = len(edges) - 1
        inside = np.flatnonzero(self.clear.reshape(-1, n_bands).any(axis=0))
        low, high = float(edges[inside[0]]), float(edges[inside[-1] + 1])
        return low or None, None if high >= fastest else high


def strongest_bands(power: np.ndarray) -> np.ndarray:
    """Mask of the bands that hold most of the energy of a balance."""
    order = np.argsort(-power)
    reached = np.cumsum(power[order])
    count = 1 + int(np.searchsorted(reached, BANDS.core_energy * power.sum()))
    mask = np.zeros(len(power), dtype=bool)
    mask[order[:count]] = True
    return mask


def connected_bands(
    good: np.ndarray, shares: np.ndarray, power: np.ndarray, core: np.ndarray
) -> np.ndarray:
    """The run of good bands that explains most and touches the core of a balance.

    Parameters
    ----------
    good, core : ndarray of bool, shape (n_bands,)
    shares, power : ndarray of shape (n_bands,)
        Share of the power that is left unexplained, and the power.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    worth = power * (1.0 - np.minimum(shares, 1.0))
    best, largest = None, -np.inf
    for start, stop in zip(edges[::2], edges[1::2]):
        run = slice(start, stop)
        if core[run].any() and worth[run].sum() > largest:
            best, largest = run, worth[run].sum()

    if best is None:
        return core
    mask = np.zeros(len(good), dtype=bool)
    mask[best] = True
    return mask


def clear_bands(
    informative: np.ndarray, shares: np.ndarray, power: np.ndarray
) -> np.ndarray:
    """The run of informative bands that leave not much more than is typical."""
    limit = BANDS.above_typical * _typical_share(shares, power)
    return connected_bands(informative & (shares <= limit), shares, power, informative)


def _typical_share(shares: np.ndarray, power: np.ndarray) -> float:
    """Share of the power that is left where half of the energy is."""
    order = np.argsort(shares)
    reached = np.cumsum(power[order])
    middle = order[int(np.searchsorted(reached, 0.5 * power.sum()))]
    least = REDUCTION.resolution**2 / BANDS.above_typical
    return max(float(shares[middle]), least)
