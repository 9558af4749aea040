"""Clocks and sampling rates of tables of signals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ..data.channels import by_record
from ..data.record import seconds_of
from ..exceptions import ChannelError


def clock_of(X: Any, time: Any, size: int, record: Any = None) -> np.ndarray | None:
    """Time of the rows in s, from ``time`` or from the index of a table, increasing in each record; None if unknown."""
    index: Any = getattr(X, "index", None)
    if time is None and isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        time = index
    elif time is None and getattr(index, "name", None) in ("t", "time") and index.dtype.kind in "fiu":
        time = index.to_numpy()
    if time is None:
        return None
    seconds = seconds_of(time, "time")
    if len(seconds) != size:
        raise ChannelError(f"time has {len(seconds)} values, X has {size} samples", "Give one time for each sample.")
    for name, rows in by_record(record, size):
        bad = np.flatnonzero(np.diff(seconds[rows]) <= 0)
        if bad.size:
            raise ChannelError(
                f"The time of {name} does not increase after row {rows.start + int(bad[0])}",
                "Pass record= ids where several records are stacked; sort the rows of each; never shuffle them.",
            )
    return seconds


def check_rate(fs: Any) -> float:
    """A sampling rate in Hz, or an error."""
    try:
        rate = float(fs)
    except (TypeError, ValueError):
        rate = np.nan
    if not np.isfinite(rate) or rate <= 0:
        raise ChannelError(f"fs={fs!r} is not a sampling rate", "Give a positive number in Hz.")
    return rate
