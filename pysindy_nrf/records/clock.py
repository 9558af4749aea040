"""Clocks of records: sampling rates, times in seconds, gaps and jitter."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ..common import number_of
from ..exceptions import ChannelError
from .channels import GAP, as_matrix, by_record

# Steps, and the deviation from an even grid, may vary by this share of a step.
MAX_JITTER = 0.05
# A rate given beside the time may differ from the time's own by this share.
RATE_TOLERANCE = 0.01
# Jitter shortens as many steps as it lengthens; where the shortest step is at least
# this share of the usual one, long steps are gaps.
MIN_STEP_BESIDE_GAPS = 0.75


@np.errstate(over="ignore")
def clock_of(
    fs: float | None, time: ArrayLike | None, n_samples: int, name: str
) -> tuple[float, float]:
    """Sampling rate (Hz) and time of the first sample (s) of a record.

    Parameters
    ----------
    fs : float or None
        Sampling rate, Hz.
    time : array-like of shape (n_samples,) or None
        Times of the samples, s, or time stamps.
    n_samples : int
    name : str
        Name of the record, for messages.

    Raises
    ------
    ChannelError
        If neither is given, the clock is not even, or the two contradict each other.
    """
    stated = number_of(fs)
    if fs is not None and not 0 < stated < np.inf:
        raise ChannelError(
            f"Record {name!r}: fs={fs!r} is not a sampling rate",
            "Give a positive number in Hz.",
        )
    if time is None and fs is None:
        raise ChannelError(
            f"Record {name!r} has no clock",
            "Give fs= in Hz, or the time of the samples.",
        )
    if time is None:
        return stated, 0.0

    seconds = seconds_of(time, name)
    if len(seconds) != n_samples:
        raise ChannelError(
            f"Record {name!r}: {len(seconds)} times for {n_samples} samples",
            "Give one time for each sample.",
        )
    rate = _even_rate(seconds, name)
    if fs is not None and abs(stated - rate) > RATE_TOLERANCE * rate:
        raise ChannelError(
            f"Record {name!r}: fs={fs} Hz contradicts the time, which has {rate:g} Hz",
            "Leave one out.",
        )
    return rate, float(seconds[0])


def _even_rate(seconds: np.ndarray, name: str) -> float:
    """Sampling rate, Hz, of times that rise in even steps."""
    steps = np.diff(seconds)
    _require_rising(steps, name)

    step = (seconds[-1] - seconds[0]) / (len(seconds) - 1)
    if not 0 < 1.0 / step < np.inf:
        raise ChannelError(
            f"Record {name!r}: the time runs from {seconds[0]:g} to {seconds[-1]:g} s"
            f" in {len(seconds)} samples, which is not a time in seconds",
            "Check its unit, and that the column is the time; or leave it out (t ="
            " 'none') and give fs.",
        )

    off_grid = np.abs(seconds - seconds[0] - step * np.arange(len(seconds))).max()
    uneven = np.abs(steps - step).max()
    if off_grid > MAX_JITTER * step and uneven > MAX_JITTER * step:
        raise _uneven_clock(steps, step, name)
    return rate_of(step)


def _require_rising(steps: np.ndarray, name: str) -> None:
    """Refuse times that stand still or run backwards."""
    bad = np.flatnonzero(steps <= 0)
    if not bad.size:
        return

    kind = "stands still" if (steps[bad] == 0).all() else "runs backwards"
    raise ChannelError(
        f"Record {name!r}: the time {kind} after row {int(bad[0])}",
        "Sort the rows and drop repeated ones; if the time is only rounded, leave it"
        " out (t = 'none') and give fs.",
    )


def _uneven_clock(steps: np.ndarray, step: float, name: str) -> ChannelError:
    """Error for a clock with gaps or jitter, which names the worst step."""
    usual = float(np.median(steps))
    worst = int(np.abs(steps - usual).argmax())
    jumps = steps[steps > GAP * usual]

    if jumps.size and steps.min() > MIN_STEP_BESIDE_GAPS * usual:
        lost = float((jumps / usual - 1).sum())
        noun = "gaps" if jumps.size > 1 else "gap"
        kind = f"{jumps.size} {noun}, about {lost:.0f} samples are missing"
        cure = (
            "Split the record at gaps (alignment.split_at_gaps), or resample it to an"
            " even clock."
        )
    else:
        kind = f"jitter, steps of {steps.min():g} to {steps.max():g} s"
        cure = (
            "If the time is only rounded, leave it out (t = 'none') and give"
            f" fs={1 / step:g}; else resample it to an even clock."
        )

    return ChannelError(
        f"Record {name!r}: the clock is uneven, {steps[worst]:g} s after row {worst}"
        f" where {usual:g} s is usual; {kind}",
        cure,
    )


def rate_of(step: float, tolerance: float = 1e-6) -> float:
    """Sampling rate, Hz, of a step in s.

    It is a whole number where rounding of the step explains the difference.
    """
    rate = 1.0 / step
    if abs(rate - round(rate)) < tolerance * rate:
        return float(round(rate))
    return float(rate)


def seconds_of(time: ArrayLike, name: str = "record") -> np.ndarray:
    """Times as float seconds; time stamps count from the first of them."""
    if isinstance(time, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        elapsed = (time - time[0]) / pd.Timedelta(seconds=1)
        seconds = elapsed.to_numpy(dtype=float)
    else:
        array = plain_times(time)
        if array.dtype.kind in "mM":
            seconds = (array - array[0]) / np.timedelta64(1, "ns") * 1e-9
        else:
            seconds = as_matrix(array, ["time"], 1, "time")[:, 0].astype(float)

    bad = np.flatnonzero(~np.isfinite(seconds))
    if bad.size:
        raise ChannelError(
            f"Record {name!r}: the time is not finite in row {int(bad[0])}",
            "Repair it.",
        )
    return seconds


def row_times(
    time: ArrayLike, size: int, pieces: Iterable[tuple[str, slice]]
) -> np.ndarray:
    """Times of rows in s, one for each, rising within every named piece."""
    seconds = seconds_of(time, "time")
    if len(seconds) != size:
        raise ChannelError(
            f"time has {len(seconds)} values, X has {size} samples",
            "Give one time for each sample.",
        )

    for name, rows in pieces:
        bad = np.flatnonzero(np.diff(seconds[rows]) <= 0)
        if bad.size:
            raise ChannelError(
                f"The time of {name} does not increase after row"
                f" {rows.start + int(bad[0])}",
                "Pass record= ids where several records are stacked; sort the rows of"
                " each; never shuffle them.",
            )
    return seconds


def plain_times(time: ArrayLike) -> np.ndarray:
    """Times as an array of numbers, ``datetime64`` or ``timedelta64``.

    Times with a time zone become UTC.
    """
    array = np.asarray(time)
    if array.dtype == object and array.size and isinstance(array.flat[0], datetime):
        stamps = pd.DatetimeIndex(pd.to_datetime(array.ravel(), utc=True))
        return stamps.tz_localize(None).to_numpy()
    return array


def times_of_table(
    table: pd.DataFrame, time: ArrayLike | None, record: ArrayLike | None = None
) -> np.ndarray | None:
    """Time of the rows in s, increasing in each record; None if unknown.

    Parameters
    ----------
    table : DataFrame
        Its index is the time if it is a time index, or numbers named ``t`` or ``time``.
    time : array-like of shape (n_samples,), optional
        Goes before the index.
    record : array-like of shape (n_samples,), optional
        Record ids of the rows.
    """
    clock = time_in_index(table.index) if time is None else time
    if clock is None:
        return None
    return row_times(clock, len(table), by_record(record, len(table)))


def time_in_index(index: pd.Index) -> pd.Index | np.ndarray | None:
    """The index of a table if it is a time, else None."""
    if isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        return index
    if index.name in ("t", "time") and index.dtype.kind in "fiu":
        return index.to_numpy()
    return None
