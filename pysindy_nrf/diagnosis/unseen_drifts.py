"""Storeys whose drift is hidden in the noise of the sensors on both floors."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from ..records.dataset import Dataset, Segment

# Noise of the drift over its rms, from which on a storey may be anything. Of chains of
# two and three floors with 1 % noise, a ratio of 0.6 leaves masses within 0.3 %; from 2
# on they are within 2 % or gone.
HIDING_NOISE = 1.5


def unseen_drifts(data: Dataset, faults: Collection[str]) -> dict[int, float]:
    """Storeys whose drift is hidden by noise in every record.

    Parameters
    ----------
    data : Dataset
    faults : collection of str
        Channels that contradict each other. Where there are any, no drift is called
        hidden: what they disagree by was taken for noise.

    Returns
    -------
    dict of int to float
        Noise of the measured drift over the rms of the fused one, by storey.
    """
    if faults:
        return {}
    ratios = np.min([_ratios(segment) for segment in data.segments], axis=0)
    hidden = {}
    for storey, ratio in enumerate(ratios.tolist(), start=1):
        if ratio > HIDING_NOISE:
            hidden[storey] = ratio
    return hidden


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
