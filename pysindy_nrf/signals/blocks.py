"""Fusion of a whole structure; long records in overlapping blocks, so that memory stays flat."""

from __future__ import annotations

from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from .joint import fuse_jointly
from .spline_fusion import BasisLadder, FusedMotion, fuse, refine

Views = list[np.ndarray | None]

BLOCK = 32768  # samples fused at a time
OVERLAP = 4096  # samples over which neighbouring blocks are faded into each other
LISTEN = 6  # blocks from which noise levels are taken, so that they are the same in all


@threadpool_limits.wrap(limits=1)  # the banded matrices are narrow: threads only get in each other's way
def fuse_all(
    views: list[Views], levels: np.ndarray, corner: float | None = None, joint: bool = True
) -> list[FusedMotion]:
    """Motions of all degrees of freedom from their channels, in units of samples."""
    n = len(next(y for y in views[0] if y is not None))
    if n <= 3 * BLOCK // 2:
        return _fuse_block(views, levels, [corner] * len(views), BasisLadder(n), joint)
    starts = np.linspace(0, n - BLOCK, -(-(n - OVERLAP) // (BLOCK - OVERLAP))).astype(int)
    ladder = BasisLadder(BLOCK)
    heard = [_part(views, start) for start in starts[:: -(-len(starts) // LISTEN)]]
    first = [[fuse(y, ladder, s, corner) for y, s in zip(part, levels, strict=True)] for part in heard]
    levels = np.median([[m.noise for m in motions] for motions in first], axis=0)
    corners = np.median([[m.high_pass for m in motions] for motions in first], axis=0)
    motion = np.zeros((len(views), 3, n))
    spacing, total = np.zeros(len(views)), np.zeros(n)
    for i, start in enumerate(starts):
        block = _fuse_block(_part(views, start), levels, corners, ladder, joint)
        weight = np.ones(BLOCK)
        if i:
            rise = starts[i - 1] + BLOCK - start
            weight[:rise] = (np.arange(rise) + 0.5) / rise
        if i + 1 < len(starts):
            fall = start + BLOCK - starts[i + 1]
            weight[BLOCK - fall :] *= 1 - (np.arange(fall) + 0.5) / fall
        total[start : start + BLOCK] += weight
        for j, m in enumerate(block):
            motion[j, :, start : start + BLOCK] += weight * m.motion
            spacing[j] = max(spacing[j], m.spacing)
    motion /= total  # three blocks may overlap
    return [FusedMotion(motion[j], levels[j], spacing[j], corners[j]) for j in range(len(views))]


def _fuse_block(
    views: list[Views], levels: Any, corners: Any, ladder: BasisLadder, joint: bool
) -> list[FusedMotion]:
    single = [fuse(y, ladder, s, c) for y, s, c in zip(views, levels, corners, strict=True)]
    return fuse_jointly(views, single, ladder) if joint else refine(views, single, ladder)


def _part(views: list[Views], start: int) -> list[Views]:
    return [[None if y is None else y[start : start + BLOCK] for y in view] for view in views]
