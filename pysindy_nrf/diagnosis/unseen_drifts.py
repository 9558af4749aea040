"""Storeys whose drift is hidden in the noise of the sensors on both floors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..records.dataset import Dataset, Segment

# Noise of the drift over its rms, from which on a storey may be anything. Of chains of
# two and three floors with 1 % noise, a ratio of 0.6 leaves masses within 0.3 %; from 2
# on they are within 2 % or gone.
HIDING_NOISE = 1.5
# Noise of a displacement over its rms from which on it is none, but another channel.
MAX_NOISE = 0.2


def unseen_drifts(data: Dataset) -> dict[int, float]:
    """Storeys whose drift is hidden by noise in every record.

    Returns
    -------
    dict of int to float
        Noise of the measured drift over the rms of the fused one, by storey.
    """
    if any(_is_contradicted(segment) for segment in data.segments):
        return {}
    ratios = np.min([_ratios(segment) for segment in data.segments], axis=0)
    return {
        storey: float(ratio)
        for storey, ratio in enumerate(ratios, start=1)
        if ratio > HIDING_NOISE
    }


def _is_contradicted(segment: Segment) -> bool:
    """Whether what other channels of a floor contradict was taken for noise."""
    x = np.cumsum(segment.s[segment.valid].astype(float), axis=1)
    for dof, rms in enumerate(np.std(x, axis=0), start=1):
        if segment.noise.get(f"x{dof}", 0.0) > MAX_NOISE * rms:
            return True
    return False


def _ratios(segment: Segment) -> list[float]:
    """Noise over rms of each drift; zero where the noise is not known."""
    rms = np.std(segment.s[segment.valid].astype(float), axis=0)
    ratios = []
    for storey in range(1, segment.n_dof + 1):
        noise = _noise_of_drift(segment.noise, storey)
        ratios.append(noise / max(float(rms[storey - 1]), np.finfo(float).tiny))
    return ratios


def _noise_of_drift(noise: Mapping[str, float], storey: int) -> float:
    """Rms noise of the difference of two measured displacements, m."""
    below = 0.0 if storey == 1 else noise.get(f"x{storey - 1}", 0.0)
    return float(np.hypot(noise.get(f"x{storey}", 0.0), below))
