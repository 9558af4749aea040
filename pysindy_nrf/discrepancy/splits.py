"""Contiguous blocks of equal energy: what is searched, what validates, what is held out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..exceptions import ChannelError
from ..regression.segments import BlockRows, Segment

HELDOUT_SHARE = 0.25
N_BLOCKS = 10
# Part of a record that starts in motion which the laws with memory get to forget their unknown start.
SETTLING = 0.04
# Share of its rms that a motion at rest may show at the start: noise.
AT_REST = 0.25
# Share of the mean force energy of a block below which its forces rest; blocks that must be left when such are joined.
RESTING, FEWEST_BLOCKS = 0.1, 4
# Share of the energy of each force that the search must see, where some arrangement of the pieces allows it.
SEEN = 0.5
# Fewer samples than this let any law of a hundred fit.
LEAST_ROWS = 200


def energy(segment: Segment, scale: np.ndarray) -> np.ndarray:
    """Running share of the motion, each channel divided by its rms over all records."""
    both = np.hstack([segment.a[segment.valid], segment.v[segment.valid]]).astype(float) / scale
    return np.cumsum((both**2).sum(axis=1))


def settled(segment: Segment) -> int:
    """First valid row that is judged."""
    s, v = (y[segment.valid].astype(float) for y in (segment.s, segment.v))
    few = max(4, len(s) // 1000)
    rms = [np.sqrt((y**2).mean(axis=0)) for y in (s, v)]
    start = [np.sqrt((y[:few] ** 2).mean(axis=0)) for y in (s, v)]
    moving = any((begin > AT_REST * whole).any() for begin, whole in zip(start, rms))
    return int(SETTLING * len(s)) if moving else 0


def pieces(n_blocks: int, share: float, most: int = 4, shift: int = 0) -> tuple[np.ndarray, list[bool]]:
    """How one record is cut: blocks of the search, and the pieces held out between them."""
    count = min(most, 4 if n_blocks >= 8 else 2 if n_blocks >= 4 else 1)
    if count > 1:
        after = [n_blocks - 1 - (n_blocks // (count + 1)) * k for k in range(count)]
        after = [k - shift % after[-1] for k in after]
    else:
        after = [1 + ((n_blocks + 1) // 2 - 1 - shift) % max(1, n_blocks - 1)]
    widths, held = [], []
    for k in range(1, n_blocks + 1):
        widths.append((1.0 - share) / n_blocks)
        held.append(False)
        if share and k in after:
            widths.append(share / len(after))
            held.append(True)
    return np.cumsum(widths), held


def joined(blocks: Iterable[slice]) -> list[slice]:
    """Blocks of one record that follow each other, as one."""
    runs: list[slice] = []
    for rows in blocks:
        if runs and runs[-1].stop == rows.start:
            runs[-1] = slice(runs[-1].start, rows.stop)
        else:
            runs.append(rows)
    return runs


def split(
    segments: Sequence[Segment], heldout: Sequence[int] | None = None, n_blocks: int = N_BLOCKS
) -> tuple[list[BlockRows], list[BlockRows]]:
    """Blocks for the search, and blocks held out."""
    chosen = [i for i in range(len(segments)) if heldout is None or i not in heldout]
    parts = [
        np.hstack([segments[i].a[segments[i].valid], segments[i].v[segments[i].valid]]).astype(float) for i in chosen
    ]
    scale = np.sqrt(np.mean(np.vstack([(p**2).mean(axis=0) for p in parts]), axis=0))
    scale[scale == 0] = 1.0
    sums = [energy(seg, scale) for seg in segments]
    first = [settled(seg) for seg in segments]
    sums = [line - (line[k - 1] if k else 0.0) for line, k in zip(sums, first)]
    apart = [BlockRows(i, slice(first[i], len(sums[i]))) for i in heldout or ()]
    total = sum(sums[i][-1] for i in chosen)
    if not total > 0:
        raise ChannelError(
            "Nothing moves in the records that are searched: accelerations and velocities are zero",
            "Dead sensors or wrong columns; check them.",
        )

    def cut(most: int, shift: int) -> tuple[list[BlockRows], list[BlockRows]]:
        search: list[BlockRows] = []
        held = list(apart)
        for i in chosen:
            mine = max(1, round(n_blocks * sums[i][-1] / total), -(-n_blocks // len(chosen)))
            shares, out = pieces(mine, HELDOUT_SHARE if heldout is None else 0.0, most, shift)
            marks = np.searchsorted(sums[i], sums[i][-1] * shares[:-1]) + 1
            edges = np.minimum([first[i], *marks, len(sums[i])], len(sums[i]))
            for lo, hi, kept in zip(edges[:-1], edges[1:], out):
                if hi > lo:
                    (held if kept else search).append(BlockRows(i, slice(int(lo), int(hi))))
        return search, held

    search, held = cut(4, 0)
    if heldout is None and seen(search, held, segments).min() < SEEN:
        ways = [cut(most, shift) for most in (4, 2, 1) for shift in range(n_blocks)]
        search, held = max(ways, key=lambda way: _balanced(seen(way[0], way[1], segments)))
    if len(search) < 3 or not held or sum(b.rows.stop - b.rows.start for b in search) < LEAST_ROWS:
        raise ChannelError(
            "The records are too short to be split into search, validation and held-out parts", "Give longer records."
        )
    return awake(search, segments), held


def force_energy(blocks: Sequence[BlockRows], segments: Sequence[Segment]) -> np.ndarray:
    """Sum of squares of each force in each block."""
    force = [np.nan_to_num(segments[b.segment].F[segments[b.segment].valid][b.rows].astype(float)) for b in blocks]
    return np.array([(F**2).sum(axis=0) for F in force]).reshape(len(blocks), segments[0].n_dof)


def seen(search: Sequence[BlockRows], held: Sequence[BlockRows], segments: Sequence[Segment]) -> np.ndarray:
    """Share of the energy of each measured force that lies in blocks of the search."""
    inside, outside = (force_energy(blocks, segments).sum(axis=0) for blocks in (search, held))
    if not np.any(inside + outside > 0):
        return np.ones(1)
    forced = inside + outside > 0
    return inside[forced] / (inside + outside)[forced]


def _balanced(shares: np.ndarray) -> tuple[bool, float]:
    """How near each force is to its part in the search and in what is held out; the search goes first."""
    nearest = np.minimum(shares / (1 - HELDOUT_SHARE), (1 - shares) / HELDOUT_SHARE).min()
    return bool(shares.min() >= SEEN), float(nearest)


def awake(blocks: list[BlockRows], segments: Sequence[Segment]) -> list[BlockRows]:
    """Blocks in which the forces rest, joined to their neighbours."""
    energy = force_energy(blocks, segments)
    total = energy.sum(axis=0)
    if not total.any():
        return blocks
    rests = (energy[:, total > 0] / total[total > 0]).mean(axis=1) < RESTING / len(blocks)
    out: list[BlockRows] = []
    asleep = False  # whether the last block of the list still waits for a force
    for block, resting in zip(blocks, rests):
        last = out[-1] if out else None
        if last and last.segment == block.segment and last.rows.stop == block.rows.start and (resting or asleep):
            out[-1] = BlockRows(block.segment, slice(last.rows.start, block.rows.stop))
            asleep = asleep and bool(resting)
        else:
            out.append(block)
            asleep = bool(resting)
    return out if len(out) >= FEWEST_BLOCKS else blocks
