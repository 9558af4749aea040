"""How far down accelerations alone tell the displacement."""

from __future__ import annotations

import numpy as np
from scipy import signal

from .zero_phase_filter import FairFilter

# Noise of the displacement that integration may bring along, as a share of the displacement.
SHARE = 0.02
# Part of the spectrum, from the top, that holds noise alone.
_TOP = 0.2
# A filter may spoil this share of the record at each end.
_SPOILT = 0.2
# Share of the displacement's power that a short record, which asks for a higher edge, must keep.
_KEPT = 0.8


def lowest_frequency(accelerations: np.ndarray, fs: float) -> float | None:
    r"""Frequency above which displacements integrated from noisy accelerations can be trusted."""
    channels = np.column_stack([accelerations, np.diff(accelerations, axis=1)])
    channels = channels[:, channels.any(axis=0)]
    if channels.shape[1] == 0:
        return None
    f, density = signal.welch(channels, fs, nperseg=max(64, len(channels) // 6), axis=0)
    f, density = f[1:], density[1:]
    noise = np.median(density[f > (1 - _TOP) * f[-1]], axis=0)
    weight = f[:, None] ** -4.0
    above = lambda y: np.cumsum(y[::-1], axis=0)[::-1]  # noqa: E731
    told, untold = above(np.maximum(density - noise, 0.0) * weight), above(noise * weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sqrt(untold / told)
    worst = np.where(np.isfinite(share), share, np.inf).max(axis=1)
    good = np.flatnonzero(worst <= SHARE)
    at = int(good[0]) if good.size else int(np.argmin(worst))
    if not np.isfinite(worst[at]):
        return None
    for i in range(at, int(np.searchsorted(f, 0.1 * fs))):
        if (told[i] < _KEPT * told[at]).any():
            break
        if FairFilter((float(f[i]), None), fs).edge <= _SPOILT * len(channels):
            return float(f[i])
    return None
