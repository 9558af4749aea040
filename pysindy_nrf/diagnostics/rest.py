"""Samples next to rest, where a force that jumps with the rate may have the wrong sign; how many to leave out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..common.jackknife import variance

# Shares of the rms rate below which a sample counts as next to rest, in the order in which they are tried.
SHARES = (0.0, 0.03, 0.1, 0.2, 0.4)
# Samples on each side of a turn that are left out with them.
_BESIDE = 2
# Part of its rms that the column of a force must keep where samples are left out.
_LIVES = 0.1
# Standard errors of a difference that are no longer chance, and the share of a coefficient that an engineer allows.
_BEYOND, _WRONG = 3.0, 0.1


def moving(rate: np.ndarray, share: float) -> np.ndarray:
    """Samples away from the turns of a motion, and faster than a share of its rms rate."""
    out = np.abs(rate) >= share
    turns = np.flatnonzero(np.diff(np.sign(rate)))
    near = (turns[:, None] + np.arange(1 - _BESIDE, 1 + _BESIDE)).ravel()
    out[np.clip(near, 0, len(out) - 1)] = False
    return out


def lives_there(kept: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Which forces still act in the samples that are left; what rises only next to rest is not told by the others."""
    return kept >= _LIVES * whole


def first_settled(found: Sequence[np.ndarray], without: Sequence[np.ndarray]) -> int:
    """The first of several estimates, each from fewer samples, from which none of the later ones differs but by
    chance.
    """
    for i in range(len(found) - 1):
        apart = [
            _beyond_chance(later - found[i], rest - without[i])
            for later, rest in zip(found[i + 1 :], without[i + 1 :])
        ]
        if not np.any(apart):
            return i
    return len(found) - 1


def made_wrong(found: np.ndarray, away: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Which coefficients from all samples differ from those away from rest by more than a tenth, and than chance."""
    gap = away - found
    return (np.abs(gap) > _WRONG * np.abs(away)) & _beyond_chance(gap, difference)


def _beyond_chance(gap: np.ndarray, parts: np.ndarray) -> np.ndarray:
    return np.abs(gap) > _BEYOND * np.sqrt(variance(parts))
