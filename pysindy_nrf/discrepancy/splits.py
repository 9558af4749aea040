"""Contiguous blocks of equal energy: what is searched, what validates, what is held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..exceptions import ChannelError
from ..segments import Segment

HELDOUT_SHARE = 0.25
N_BLOCKS = 10


@dataclass(frozen=True)
class BlockRows:
    """Consecutive valid rows of one record.

    Attributes
    ----------
    segment : int
        Number of the record.
    rows : slice
        Counted from the first valid row of the record.
    """

    segment: int
    rows: slice


def energy(segment: Segment, scale: np.ndarray) -> np.ndarray:
    """Running share of the motion, each channel divided by its rms over all records.

    Parameters
    ----------
    segment : Segment
    scale : ndarray of shape (2 n_dof,)
        Rms of accelerations and inter-storey velocities.

    Returns
    -------
    ndarray of shape (n_valid_samples,)
        Cumulative sum.
    """
    both = np.hstack([segment.a[segment.valid], segment.v[segment.valid]]).astype(float) / scale
    return np.cumsum((both**2).sum(axis=1))


def split(
    segments: Sequence[Segment], heldout: Sequence[int] | None = None, n_blocks: int = N_BLOCKS
) -> tuple[list[BlockRows], list[BlockRows]]:
    """Blocks for the search, and blocks held out.

    Parameters
    ----------
    segments : sequence of Segment
    heldout : sequence of int, optional
        Records held out whole. None: the last quarter (of the energy) of every record.
    n_blocks : int
        Blocks of the search, at least; one record or more.

    Returns
    -------
    search, held : list of BlockRows
        Blocks of equal energy, so that each weighs the same whether the record is steady or a hammer
        blow that dies away.

    Raises
    ------
    ChannelError
        If the records are too short to be split.
    """
    chosen = [i for i in range(len(segments)) if heldout is None or i not in heldout]
    parts = [
        np.hstack([segments[i].a[segments[i].valid], segments[i].v[segments[i].valid]]).astype(float) for i in chosen
    ]
    scale = np.sqrt(np.mean(np.vstack([(p**2).mean(axis=0) for p in parts]), axis=0))
    scale[scale == 0] = 1.0
    sums = [energy(seg, scale) for seg in segments]
    held = [BlockRows(i, slice(0, len(sums[i]))) for i in heldout or ()]
    share = 1.0 - HELDOUT_SHARE if heldout is None else 1.0
    total = sum(sums[i][-1] for i in chosen)
    search: list[BlockRows] = []
    for i in chosen:
        mine = max(1, round(n_blocks * sums[i][-1] / total), -(-n_blocks // len(chosen)))
        marks = np.searchsorted(sums[i], sums[i][-1] * share * np.arange(1, mine + 1) / mine)
        edges = [0, *np.minimum(marks + 1, len(sums[i]))]
        if heldout is not None:
            edges[-1] = len(sums[i])
        search += [BlockRows(i, slice(int(lo), int(hi))) for lo, hi in zip(edges[:-1], edges[1:]) if hi > lo]
        if heldout is None and edges[-1] < len(sums[i]):
            held.append(BlockRows(i, slice(int(edges[-1]), len(sums[i]))))
    if len(search) < 3 or not held:
        raise ChannelError(
            "The records are too short to be split into search, validation and held-out parts", "Give longer records."
        )
    return search, held
