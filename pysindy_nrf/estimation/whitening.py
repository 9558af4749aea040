"""Balances weighted by frequency as their own noise asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .spectra import Smooth


@dataclass
class Whitener:
    """A zero-phase filter of given amplitude, the same for every row of a balance.

    The record is mirrored at its ends (a cosine transform does that), so nothing is taken to be periodic.

    Attributes
    ----------
    weight : Smooth
        Squared amplitude by frequency, one column.
    band : (float or None, float or None)
        Hz; zero outside.
    """

    weight: Smooth
    band: tuple[float | None, float | None] = (None, None)

    def amplitude(self, f: np.ndarray) -> np.ndarray:
        """Amplitude at frequencies in Hz."""
        low, high = self.band
        inside = (f >= (low or 0.0)) & (f <= (np.inf if high is None else high))
        return np.where(inside, np.sqrt(self.weight(f)[:, 0]), 0.0)

    def apply(self, rows: np.ndarray, dt: float) -> np.ndarray:
        """Filter rows of one record."""
        from scipy.fft import dct, idct

        n = rows.shape[1]
        return idct(dct(rows, axis=1) * self.amplitude(np.arange(n) / (2 * n * dt)), axis=1)
