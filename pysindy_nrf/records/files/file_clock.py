"""The clock of a file, or of the files of one test."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from ..channels import channel_of
from ..clock import clock_of, seconds_of
from ..quality import QualityNote
from ..record import Record
from .mapping.column_facts import SLOW, unit_of_ticks
from .mapping.expression import Expression, line_of
from .mapping.words import letter_named
from .own_clocks import on_one_clock
from .table import Clock, Table
from .units import (
    dimension_of,
    kind_of_unit,
    si_factor,
    split_suffix,
    split_unit,
)

EVEN_PERCENT = 0.01  # by which steps of an even clock may vary
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")


@dataclass(frozen=True)
class Source:
    """Origin of a channel.

    Parameters
    ----------
    text : str
        Its mapping, or the name of its column.
    unit : str
    columns : tuple of str
        The variables of the file.
    declared : bool
        Whether the unit was given, by the user or the file.
    from_name : bool
        Whether the unit is only the end of the name of the column, as in ``a1_g``.
    """

    text: str
    unit: str
    columns: tuple[str, ...] = ()
    declared: bool = False
    from_name: bool = False


@dataclass(frozen=True)
class FileClock:
    """The clock of a record, and where it came from.

    Parameters
    ----------
    path : str
        The file, for messages.
    time : ndarray, optional
        Times of all channels.
    fs : float, optional
        Sampling rate, Hz.
    start : float, optional
        Time of the first sample, s, where the channels were brought to one clock.
    origin : str
        Where the rate came from, in words.
    unit_is_known : bool
        Whether the unit of the time was said, or there is no time.
    rate_is_stated : bool
        Whether a file states the rate or the times.
    notes : tuple of QualityNote
        Shifts and changes of rate of channels with their own clocks.
    columns : tuple of str
        Columns of the file that are times.
    """

    path: str
    time: np.ndarray | None = None
    fs: float | None = None
    start: float | None = None
    origin: str = ""
    unit_is_known: bool = True
    rate_is_stated: bool = True
    notes: tuple[QualityNote, ...] = ()
    columns: tuple[str, ...] = ()

    def in_words(self, record: Record) -> str:
        """The sampling rate, where it came from, and how even the time is."""
        if self.time is None:
            return f"{record.fs:g} Hz, {self.origin}"

        steps = np.diff(seconds_of(self.time, record.name))
        variation = 100 * float(np.abs(steps / steps.mean() - 1).max())
        evenness = "even"
        if variation >= EVEN_PERCENT:
            evenness = f"steps vary by up to {variation:.2g} %"
        return f"{record.fs:g} Hz, {self.origin}, {evenness}"

    def refuse_slow_rate(self, rate: float) -> None:
        """Refuse a time without a unit at which accelerations come far too slowly."""
        if self.unit_is_known or rate >= SLOW:
            return
        unit = unit_of_ticks(1.0 / rate)
        raise ChannelError(
            f"{self.path}: accelerations at {rate:.3g} Hz say that the time is in"
            f" {unit}, not in s",
            f"Declare its unit: units={{'t': '{unit}'}}, --unit t={unit} (or --unit"
            " t=s).",
        )


def clock_of_file(
    table: Table,
    lines: Mapping[str, np.ndarray],
    sources: Mapping[str, Source],
    fs: float | None,
) -> tuple[FileClock, dict[str, np.ndarray]]:
    """The clock of the channels of a file, and the channels on it.

    Parameters
    ----------
    table : Table
    lines : mapping of str to ndarray of shape (n_samples,)
        In SI units by channel, with the time ``t`` if there is any.
    sources : mapping of str to Source
    fs : float or None
        Sampling rate, Hz, as the user gave it.

    Raises
    ------
    ChannelError
        If no clock is known, or channels with their own clocks have too little time
        in common.
    """
    channels = {c: line for c, line in lines.items() if c != "t"}
    path = str(table.path)
    own_clocks = _own_clocks(table, channels, lines.get("t"), sources, fs)
    if own_clocks is not None and channels:
        return _brought_to_one(path, table, channels, own_clocks)

    time = lines.get("t")
    if time is not None:
        if time.dtype == object:
            time = timestamps(path, time)
        origin = f"from the time {sources['t'].text!r}"
        known = sources["t"].declared or fs is not None or time.dtype.kind in "mM"
        return FileClock(path, time, fs, origin=origin, unit_is_known=known), channels
    if fs is not None:
        clock = FileClock(path, fs=fs, origin="as given", rate_is_stated=False)
        return clock, channels
    if table.fs is not None:
        return FileClock(path, fs=table.fs, origin="as stated in the file"), channels
    raise ChannelError(
        f"{table.path} has no time column",
        "Give the sampling rate, fs= (--fs, Hz), or map one: --map t=name.",
    )


@dataclass(frozen=True)
class _OwnClocks:
    """Clocks by channel, and where they came from."""

    by_channel: dict[str, Clock]
    origin: str
    unit_is_known: bool = True
    columns: tuple[str, ...] = ()


def _own_clocks(
    table: Table,
    channels: Mapping[str, np.ndarray],
    time: np.ndarray | None,
    sources: Mapping[str, Source],
    fs: float | None,
) -> _OwnClocks | None:
    """Clocks of channels that have their own; None if they share one."""
    if table.files:
        return _clocks_of_files(table, channels, sources, fs)
    if time is not None or not table.clocks:
        return None

    by_channel = {}
    for channel in channels:
        clocks = {table.clocks.get(name) for name in sources[channel].columns}
        clock = clocks.pop()
        if clock is None or clocks:
            return None
        by_channel[channel] = clock if fs is None else replace(clock, fs=fs)
    origin = "as stated in the file" if fs is None else "as given"
    return _OwnClocks(by_channel, origin)


def _brought_to_one(
    path: str, table: Table, channels: Mapping[str, np.ndarray], own_clocks: _OwnClocks
) -> tuple[FileClock, dict[str, np.ndarray]]:
    """Channels on the clock of the slowest of them."""
    clocks = _from_one_origin(path, own_clocks.by_channel)
    resampled = on_one_clock(channels, clocks, table.path.stem)
    clock = FileClock(
        path,
        fs=resampled.clock.fs,
        start=resampled.clock.start,
        origin=own_clocks.origin,
        unit_is_known=own_clocks.unit_is_known,
        notes=resampled.notes,
        columns=own_clocks.columns,
    )
    return clock, resampled.lines


def _from_one_origin(path: str, clocks: Mapping[str, Clock]) -> dict[str, Clock]:
    """Clocks whose starts count from the earliest origin."""
    origins = {channel: clock.origin for channel, clock in clocks.items()}
    stamped = [origin for origin in origins.values() if origin is not None]
    if not stamped:
        return dict(clocks)
    if len(stamped) < len(origins):
        without = next(c for c, origin in origins.items() if origin is None)
        raise ChannelError(
            f"{path}: {without} has no time of day, other channels have one",
            "Give all of them the same kind of time.",
        )

    first = min(stamped)
    counted = {}
    for channel, clock in clocks.items():
        assert clock.origin is not None  # checked above
        later = (clock.origin - first) / np.timedelta64(1, "ns") * 1e-9
        counted[channel] = Clock(clock.fs, clock.start + float(later))
    return counted


# -- several files -------------------------------------------------------------


def _clocks_of_files(
    table: Table,
    channels: Mapping[str, np.ndarray],
    sources: Mapping[str, Source],
    fs: float | None,
) -> _OwnClocks | None:
    """Clocks of the channels of several files; None if none has one."""
    named = sources.get("t")
    clocks: dict[str, Clock] = {}
    times = {}
    for file in table.files:
        time = _time_of_file(table, file, named)
        if time is not None:
            times[file] = time
            clocks[file] = _clock_of_time(table, file, time)
        elif fs is not None:
            clocks[file] = Clock(fs)

    by_channel = {}
    for channel, line in channels.items():
        clock = _clock_of_channel(table, sources[channel], clocks)
        if clock is None:
            clock = _clock_of_equal_length(table, len(line), clocks)
        if clock is None:
            return None
        by_channel[channel] = clock

    origin = "as given" if fs is not None else "as stated in the files"
    if times:
        columns = ", ".join(time.column for time in times.values())
        origin = f"from the times {columns}"
    return _OwnClocks(
        by_channel,
        origin,
        unit_is_known=all(time.unit for time in times.values()),
        columns=tuple(time.column for time in times.values()),
    )


@dataclass(frozen=True)
class _TimeColumn:
    """A column that is the time of a file, and its unit if one is known."""

    column: str
    unit: str | None


def _time_of_file(table: Table, file: str, named: Source | None) -> _TimeColumn | None:
    """The time of one of several files.

    It is the column that is mapped, else the one of the same name, else the one that
    is called the time.
    """
    if named is not None and named.columns:
        (column,) = named.columns[:1]
        unit = named.unit if named.declared else None
        if table.file_of(column) in ("", file):
            return _TimeColumn(column, unit)
        same = file + column.removeprefix(table.file_of(column))
        if same in table.variables:
            return _TimeColumn(same, unit)

    columns = [name for name in table.variables if table.file_of(name) == file]
    for is_time in (_is_called_t, _means_time):
        for name in columns:
            bare = name.removeprefix(f"{file}.")
            if table.variables[name].ndim == 1 and is_time(bare):
                return _TimeColumn(name, written_unit("t", name, table))
    return None


def _is_called_t(name: str) -> bool:
    bare, unit = split_unit(name)
    return channel_of(bare if unit else split_suffix(name)[0]) == "t"


def _means_time(name: str) -> bool:
    return letter_named(name) == "t"


def _clock_of_time(table: Table, file: str, time: _TimeColumn) -> Clock:
    """The clock of a file from its time."""
    values = line_of(Expression(time.column), table, "t")
    if values.dtype == object:
        values = timestamps(f"{file} of {table.path}", values)
    kind = values.dtype.kind
    if kind not in "mM":
        values = in_si(np.asarray(values, dtype=float), time.unit, "t")

    rate, start = clock_of(None, values, len(values), file)
    if kind == "M":
        return Clock(rate, 0.0, values[0].astype("datetime64[ns]"))
    if kind == "m":
        start = float(values[0] / np.timedelta64(1, "ns")) * 1e-9
    return Clock(rate, start)


def _clock_of_channel(
    table: Table, source: Source, clocks: Mapping[str, Clock]
) -> Clock | None:
    """The clock of a channel: that of its file, or as the file states."""
    clocks_of_columns = {
        clocks.get(table.file_of(name)) or table.clocks.get(name)
        for name in source.columns
    }
    if len(clocks_of_columns) > 1:
        raise ChannelError(
            f"{table.path}: {source.text} combines columns with clocks of their own",
            "Combine columns of one file.",
        )
    return clocks_of_columns.pop()


def _clock_of_equal_length(
    table: Table, n_samples: int, clocks: Mapping[str, Clock]
) -> Clock | None:
    """The clock of another file of as many samples, for a file that has none."""
    for name, values in table.variables.items():
        clock = clocks.get(table.file_of(name)) or table.clocks.get(name)
        if clock is not None and values.shape[:1] == (n_samples,):
            return clock
    return None


# -- times ---------------------------------------------------------------------


def timestamps(path: str, values: np.ndarray) -> np.ndarray:
    """Texts as time stamps, or as times of day."""
    texts = pd.Series(values)
    is_number = pd.to_numeric(texts, errors="coerce").notna().to_numpy()
    if len(values) / 2 < is_number.sum() < len(values):  # a footer, or names again
        row = int(np.argmin(is_number))
        raise FileFormatError(
            f"{path}: the time holds the text {values[row]!r} in data row {row + 1}",
            "Remove this row; every row is one sample.",
        )

    try:
        if _TIME_OF_DAY.fullmatch(str(values[0]).strip()):
            return pd.to_timedelta(texts).to_numpy()
        return pd.DatetimeIndex(pd.to_datetime(texts)).to_numpy()
    except (ValueError, TypeError) as error:
        raise FileFormatError(
            f"{path}: the time {values[0]!r} is not understood",
            "Give seconds, or timestamps like 2024-05-01T12:00:00.125.",
        ) from error


# -- units ---------------------------------------------------------------------


def written_unit(channel: str, name: str, table: Table) -> str | None:
    """Unit of a variable in the file, or at the end of its name."""
    if name in table.units:
        return table.units[name]
    _, suffix = split_suffix(name)
    if suffix is None or dimension_of(channel) is None:
        return None
    return suffix if kind_of_unit(suffix) == channel[0] else None


def is_end_of_names(unit: str | None, expression: Expression, table: Table) -> bool:
    """Whether a unit is only the end of the names of columns, as in ``a1_g``."""
    for name in expression.columns:
        if name in table.units or split_suffix(name)[1] != unit:
            return False
    return unit is not None


def in_si(line: np.ndarray, unit: str | None, channel: str) -> np.ndarray:
    """Samples of a channel in SI units; a covariate keeps its unit."""
    if not unit or dimension_of(channel) is None or line.dtype.kind != "f":
        return line
    scale = si_factor(unit, channel)
    return line if scale == 1 else line * scale
