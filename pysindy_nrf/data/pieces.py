"""Where one contiguous record ends and the next begins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChannelError
from .channels import rows_text

# A step of the clock this many times the usual one is a gap.
GAP = 1.5


def by_record(record: Any, size: int) -> list[tuple[str, slice]]:
    """Name and rows of each record."""
    if record is None:
        return [("record", slice(0, size))]
    ids = np.asarray(record).ravel()
    if len(ids) != size:
        raise ChannelError(f"record has {len(ids)} ids, X has {size} samples", "Give one id for each sample.")
    lost = np.flatnonzero(pd.isna(ids))
    if lost.size:
        raise ChannelError(f"record has no id in {rows_text(lost)}", "Give one id for each sample.")
    cuts = np.flatnonzero(ids[1:] != ids[:-1]) + 1
    edges = [0, *cuts.tolist(), size]
    return [(str(ids[lo]), slice(lo, hi)) for lo, hi in zip(edges[:-1], edges[1:])]


def gaps(seconds: np.ndarray) -> np.ndarray:
    """Rows after which the clock of one record jumps."""
    steps = np.diff(seconds)
    return np.flatnonzero(steps > GAP * np.median(steps)) if len(steps) > 2 else np.zeros(0, dtype=int)


def contiguous(size: int, record: Any = None, seconds: np.ndarray | None = None) -> list[tuple[str, slice]]:
    """Pieces without a gap: rows with one record id whose clock ticks evenly."""
    pieces = by_record(record, size)
    if seconds is None:
        return pieces
    out = []
    for name, rows in pieces:
        cuts = rows.start + gaps(seconds[rows]) + 1
        edges = [rows.start, *cuts.tolist(), rows.stop]
        out += [(name, slice(lo, hi)) for lo, hi in zip(edges[:-1], edges[1:])]
    return out
