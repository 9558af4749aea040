"""From the variables of a file to a record: which variable is which channel, in which unit, on which clock."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from ..record import Record, seconds_of
from .attributes import restored
from .expression import Expression, line_of, parse
from .names import channel_of
from .table import Table
from .units import dimension_of, factor, si_unit

_MATRICES = ("a", "v", "x", "F")
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")


@dataclass
class Source:
    """Where a channel came from.

    Attributes
    ----------
    text : str
        The mapping, or the column's name.
    unit : str
        Unit in the file.
    name : str
        The variable of the file.
    """

    text: str
    unit: str
    name: str = ""


@dataclass
class Reading:
    r"""A record and how the file was understood.

    Attributes
    ----------
    record : Record
    table : Table
    sources : dict of str to Source
        By channel.
    unused : tuple of str
        Variables of the file that are not in the record.
    clock : str
        How the sampling rate was found.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "own.csv")
    ...     _ = path.write_text("t,x1,remark\n" + "".join(f"{k / 100},{k % 7},0\n" for k in range(50)))
    ...     reading = io.inspect_record(path, units={"x": "mm"})
    >>> reading.record.measured, reading.unused
    (('F1', 'x1'), ('remark',))
    """

    record: Record
    table: Table
    sources: dict[str, Source]
    unused: tuple[str, ...]
    clock: str = ""


def understand(table: Table, *, mapping: Mapping[str, str] | None = None, fs: float | None = None,
               units: Mapping[str, str] | None = None, name: str | None = None,
               coordinates: str | None = None) -> Reading:  # fmt: skip
    """A record from the variables of a file."""
    own = table.attributes
    if coordinates not in (None, "relative", "absolute"):
        raise ChannelError(f"coordinates={coordinates!r} is unknown", "Choose 'relative' (to the base) or 'absolute'.")
    if own is not None and not mapping and not units and fs is None:
        record = restored(own, table.variables)
        if name or coordinates:
            record = record.replace(name=name or record.name, coordinates=coordinates or record.coordinates)
        sources = {c: Source(c, si_unit(c)) for c in own.columns}
        return Reading(record, table, sources, (), f"{record.fs:g} Hz, as written by this package")
    lines, sources = lines_of(table, mapping, units)
    if not any(dimension_of(c) not in (None, "force", "time") and c not in ("ag", "vg", "xg") for c in lines):
        raise FileFormatError(
            f"{table.path}: no column is known to be a motion; it holds {table.names}",
            "Name columns a1.., v1.., x1.., F1.., ag, t, or map them: mapping={'x1': 'name'}, --map x1=name.",
        )
    title = name or (own.name if own else table.path.stem)
    record, clock = record_of(table, lines, sources, fs, title, coordinates or (own.coordinates if own else "relative"))
    used = {source.name for source in sources.values()}
    unused = tuple(v for v in table.variables if v not in used)
    return Reading(record, table, sources, unused, clock)


def lines_of(
    table: Table, mapping: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> tuple[dict[str, np.ndarray], dict[str, Source]]:
    """Samples in SI and their origin, by channel."""
    chosen = _chosen(table, dict(mapping or {}))
    declared = _declared(units)
    lines: dict[str, np.ndarray] = {}
    sources: dict[str, Source] = {}
    unknown = []
    for channel, expression in chosen.items():
        if isinstance(expression, str):
            unknown.append(channel)
            continue
        line = line_of(expression, table, channel)
        unit = _unit(channel, expression, table, declared)
        if unit and dimension_of(channel) is not None and line.dtype.kind == "f":
            scale = factor(unit, channel)
            line = line if scale == 1 else line * scale
        lines[channel] = line
        sources[channel] = Source(_text(expression), unit or si_unit(channel), expression.name)
    stray = [key for key in declared if not any(key in (c, c[:1]) for c in lines)]
    if stray:
        raise ChannelError(
            f"A unit is given for {stray[0]!r}, which is not among the channels {', '.join(lines) or '(none)'}",
            "Name a channel (x1) or a kind (x, v, a, F, t).",
        )
    _same_length(table, lines)
    n = len(next(iter(lines.values()), ()))
    for channel in unknown:
        lines[channel] = np.full(n, np.nan)
        sources[channel] = Source("unknown", "")
    return lines, sources


def record_of(
    table: Table,
    lines: dict[str, np.ndarray],
    sources: Mapping[str, Source],
    fs: float | None,
    name: str,
    coordinates: str,
) -> tuple[Record, str]:
    """The record of lines in SI, and how its clock was found."""
    said = "as given"
    if "t" in lines and lines["t"].dtype == object:
        lines["t"] = _timestamps(table, lines["t"])
    elif "t" not in lines and fs is None:
        fs, said = table.fs, "as stated in the file"
        if fs is None:
            raise ChannelError(
                f"{table.path} has no time column", "Give the sampling rate, fs= (--fs, Hz), or map one: --map t=name."
            )
    channels = {c: line for c, line in lines.items() if dimension_of(c)}
    record = Record.from_frame(pd.DataFrame(channels), fs=fs, name=name, coordinates=coordinates)
    if len(channels) < len(lines):  # whatever a covariate is called, it is no channel
        record = record.replace(covariates={c: line for c, line in lines.items() if not dimension_of(c)})
    if "t" in lines:
        said = _clock(lines["t"], record, sources.get("t"))
    return record, f"{record.fs:g} Hz, {said}"


def _clock(time: Any, record: Record, source: Source | None) -> str:
    """How even the clock is, in words."""
    steps = np.diff(seconds_of(time, record.name)) * record.fs
    jitter = 100 * float(np.abs(steps - 1).max())
    even = "even" if jitter < 0.01 else f"steps vary by up to {jitter:.2g} %"
    return f"from the time{'' if source is None else ' ' + repr(source.text)}, {even}"


def _chosen(table: Table, mapping: dict[str, str]) -> dict[str, Expression | str]:
    """Expression by channel: the file's own names first, then the mapping."""
    chosen: dict[str, Expression | str] = {}
    extra = set(table.attributes.covariates) if table.attributes else set()
    for name, values in table.variables.items():
        if name in extra:
            chosen[name] = Expression(name)
            continue
        if name in _MATRICES and values.ndim == 2:
            for k in range(values.shape[1]):
                chosen[f"{name}{k + 1}"] = Expression(name, column=k)
        elif (channel := channel_of(name)) and values.ndim == 1:
            if channel in chosen:
                raise FileFormatError(
                    f"{table.path} has two columns that are channel {channel}",
                    f"Rename one, or map it: {channel}=name.",
                )
            chosen[channel] = Expression(name)
    for key, text in mapping.items():
        channel = channel_of(str(key)) or str(key)
        if channel in ("a", "v", "x", "F", "f", ""):
            raise ChannelError(
                f"The channel {key!r} has no number", "Write a1, v2, x3, F1, ag, vg, xg, t, or the name of a covariate."
            )
        if isinstance(text, str) and text.strip().lower() == "none":
            chosen.pop(channel, None)
        elif isinstance(text, str) and text.strip().lower() == "unknown":
            if dimension_of(channel) != "force":
                raise ChannelError(
                    f"Channel {channel} cannot be 'unknown'",
                    "Only a force can act and not be measured; write 'none' to drop a channel.",
                )
            chosen[channel] = "unknown"
        else:
            chosen[channel] = parse(text, table, channel)
    return chosen


def _declared(units: Mapping[str, str] | None) -> dict[str, str]:
    out = {}
    for key, unit in dict(units or {}).items():
        if not isinstance(unit, str) or not unit.strip():
            raise ChannelError(f"The unit of {key!r} is {unit!r}", "Give a text such as 'mm' or 'g'.")
        channel = channel_of(str(key)) or {"f": "F"}.get(str(key), str(key))
        out[channel] = unit.strip()
    return out


def _unit(channel: str, expression: Expression, table: Table, declared: Mapping[str, str]) -> str | None:
    if expression.unit:
        return expression.unit
    if channel in declared:
        return declared[channel]
    if dimension_of(channel) is not None and channel[0] in declared:
        return declared[channel[0]]
    written = table.units.get(expression.name)
    if written is None or expression.factor is None:
        return written
    try:
        size = factor(written, channel)
    except ChannelError:
        return None  # another quantity: the factor makes the channel's unit of it
    if size != 1:
        raise ChannelError(
            f"{channel} = {_text(expression)!r} has a factor, and the header says that {expression.name!r} is in "
            f"{written}: it is not clear in which unit the product is",
            f"Write '{_text(expression)} @ {written}' or '{_text(expression)} @ {si_unit(channel)}'.",
        )
    return written


def _text(expression: Expression) -> str:
    text = ("-" if expression.sign < 0 else "") + expression.name
    if expression.column is not None:
        text += f"[:, {expression.column}]"
    if expression.row is not None:
        text += f"[{expression.row}, :]"
    return text + (f" * {expression.factor}" if expression.factor else "")


def _same_length(table: Table, lines: Mapping[str, np.ndarray]) -> None:
    lengths = {c: len(line) for c, line in lines.items()}
    if len(set(lengths.values())) > 1:
        raise ChannelError(
            f"{table.path}: channels differ in length, " + ", ".join(f"{c} {n}" for c, n in lengths.items()),
            "Map channels of one test; resample those of another clock.",
        )


def _timestamps(table: Table, values: np.ndarray) -> pd.DatetimeIndex | pd.TimedeltaIndex:
    numbers = pd.to_numeric(pd.Series(values), errors="coerce").notna().to_numpy()
    if len(values) > numbers.sum() > len(values) / 2:  # a footer, or names that come again
        row = int(np.argmin(numbers))
        raise FileFormatError(
            f"{table.path}: the time holds the text {values[row]!r} in data row {row + 1}",
            "Remove this row; every row is one sample.",
        )
    try:
        if _TIME_OF_DAY.fullmatch(str(values[0]).strip()):
            return pd.TimedeltaIndex(pd.to_timedelta(pd.Series(values)))
        return pd.DatetimeIndex(pd.to_datetime(pd.Series(values)))
    except (ValueError, TypeError) as error:
        raise FileFormatError(
            f"{table.path}: the time {values[0]!r} is not understood",
            "Give seconds, or timestamps like 2024-05-01T12:00:00.125.",
        ) from error
