"""What is done to the channels of a file: blank rows, absolute motion, cut, rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...exceptions import ChannelError
from ..quality import QualityNote
from ..record import ARRAYS, Record
from .own_clocks import CUTOFF, FLAT_BELOW, interpolated


@dataclass(frozen=True)
class Preparation:
    """What is done to the channels of a file before they are a record.

    Parameters
    ----------
    start, stop : float, optional
        The part of the test that is used, s on the clock of the file; ``stop`` is not
        included.
    fs : float, optional
        Sampling rate to which the record is slowed down, Hz, with a band limit.
    drop_blank : bool
        Leave out rows in which a channel that is used is empty. The clock must stay
        even.
    relative_acceleration : bool
        Accelerations were measured relative to the base: that of the base is added.

    Raises
    ------
    ChannelError
        If the part is empty, or the rate is not slower than the record's.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records import Preparation
    >>> record = Preparation(start=1.0, stop=3.0).of_record(
    ...     datasets.load_demo()
    ... )
    >>> record.n_samples / record.fs
    2.0
    """

    start: float | None = None
    stop: float | None = None
    fs: float | None = None
    drop_blank: bool = False
    relative_acceleration: bool = False

    def of_lines(self, lines: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Channels, without blank rows if these are to be left out."""
        return _without_blank_rows(lines) if self.drop_blank else dict(lines)

    def of_record(self, record: Record) -> Record:
        """The part of a record, in absolute accelerations, at the rate wanted."""
        if self.relative_acceleration:
            record = _with_absolute_accelerations(record)
        if self.start is not None or self.stop is not None:
            start = -np.inf if self.start is None else self.start
            stop = np.inf if self.stop is None else self.stop
            record = record.window(start, stop)
        return record if self.fs is None else _slowed_down(record, self.fs)


def _without_blank_rows(lines: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rows in which every channel is filled; the time shows what is missing."""
    if "t" not in lines:
        raise ChannelError(
            "Blank rows cannot be left out of a file without a time",
            "Map its time (t = name), which shows what is missing there.",
        )
    lengths = {len(line) for line in lines.values()}
    if len(lengths) > 1:
        return dict(lines)  # of other clocks; refused where they are brought together

    filled = np.ones(lengths.pop(), dtype=bool)
    for line in lines.values():
        if line.dtype.kind in "fmM":
            filled &= ~np.isnan(line)
    return {channel: line[filled] for channel, line in lines.items()}


def _with_absolute_accelerations(record: Record) -> Record:
    """A record with the acceleration of the base added to those of the floors."""
    if record.base_acceleration is None or record.acceleration is None:
        raise ChannelError(
            f"Record {record.name!r} lacks the acceleration of the base or of a floor,"
            " which --relative-acceleration adds",
            "Map them: ag = name, a1 = name.",
        )
    absolute = record.acceleration + record.base_acceleration[:, None]
    return record.replace(acceleration=absolute)


def _slowed_down(record: Record, fs: float) -> Record:
    """A record at a lower rate, with a band limit."""
    if not 0 < fs < record.fs:
        raise ChannelError(
            f"Record {record.name!r} has {record.fs:g} Hz and cannot be resampled to"
            f" {fs:g} Hz",
            "Give a lower rate: a higher one adds nothing that was measured.",
        )
    ratio = record.fs / fs
    position = np.arange(0, record.n_samples - 1, ratio)

    def slowed(line: np.ndarray) -> np.ndarray:
        if np.isnan(line).all():
            return np.full(len(position), np.nan)
        finite = np.flatnonzero(np.isfinite(line))
        first, last = finite[0], finite[-1]
        values = interpolated(
            line[first : last + 1].astype(float), position - first, CUTOFF / ratio
        )
        values[(position < first) | (position > last)] = np.nan
        return values

    changes = {}
    for key in ARRAYS:
        array = getattr(record, key)
        if array is not None:
            changes[key] = np.apply_along_axis(slowed, 0, array)
    covariates = {name: slowed(line) for name, line in record.covariates.items()}

    limit = 0.5 * fs * CUTOFF * FLAT_BELOW
    message = (
        f"resampled from {record.fs:g} to {fs:g} Hz, as measured below {limit:.3g} Hz"
    )
    note = QualityNote("resampled", message, "", record.name, ratio)
    slow = record.replace(**changes, covariates=covariates, fs=fs)
    return slow.with_quality((*record.quality, note))
