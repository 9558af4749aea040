"""Columns of the own motion of a site, few and cheap, filtered as the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...laws import Jenkins
from ...laws.shape import Motion
from ..period import mean_period
from ..residual import Filters, filtered

# Every k-th sample is enough for the regressions, as long as so many are left in all
# and in a period.
LEAST_SAMPLES = 8000
LEAST_PER_PERIOD = 8
# Yield drifts of the sliders, in multiples of the rms drift: small ones are friction,
# large ones springs.
YIELD_DRIFTS = (0.06, 0.15, 0.6, 1.6, 4.0)


def rms_of_all(parts: Sequence[np.ndarray]) -> float:
    """Rms of all parts; 1 where nothing moves."""
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) or 1.0


def thinning(parts: Sequence[np.ndarray]) -> int:
    """Every how many samples of a drift are enough for a regression."""
    in_all = sum(map(len, parts)) // LEAST_SAMPLES
    in_period = mean_period(parts) // LEAST_PER_PERIOD
    return int(max(1, min(in_all, in_period)))


def sliders(motion: Motion, scale: float, yields: Sequence[float]) -> np.ndarray:
    """Elastic-plastic sliders of several yield drifts (Prandtl-Ishlinskii)."""
    path = Motion(motion.s, motion.v, motion.a)
    columns = [Jenkins(uy=y * scale, Fy=1.0).features(path) for y in yields]
    return np.column_stack(columns)


def own_columns(
    motions: Sequence[Motion], filters: Filters, every: int = 1
) -> list[np.ndarray]:
    """Columns for friction, damping, springs and yielding of a site's own motion."""
    size = rms_of_all([motion.s for motion in motions])
    out = []
    for motion, filter_ in zip(motions, filters):
        s, v = motion.s, motion.v
        beyond = np.maximum(np.abs(s) - size, 0.0) * np.sign(s)
        smooth = np.column_stack([np.sign(v), v * np.abs(v), s**2, s**3, beyond])
        columns = np.column_stack([smooth, sliders(motion, size, YIELD_DRIFTS)])
        out.append(filtered(columns, filter_)[::every])
    return out
