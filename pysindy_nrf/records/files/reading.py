"""From a file to a record, or to the excitation of a simulation."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypedDict, TypeVar, Unpack

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from ..channels import channel_of
from ..clock import seconds_of
from ..record import BASES, Record, require_coordinates
from .attributes import Attributes, restored
from .mapping.assignment import assign_channels
from .mapping.expression import Expression, line_of
from .table import MAX_BYTES, Table
from .tables import AnyPath, read_table
from .units import dimension_of, kind_of_unit, si_factor, si_unit, split_suffix

SLOW = 8.0  # Hz; accelerations of structures are sampled faster
EVEN_PERCENT = 0.01  # by which steps of an even clock may vary
_MOTIONS = ("length", "velocity", "acceleration")
T = TypeVar("T")
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")


@dataclass(frozen=True)
class Source:
    """Origin of a channel.

    Parameters
    ----------
    text : str
        Its mapping, or the name of its column.
    unit : str
    name : str
        The variable of the file.
    declared : bool
        Whether the unit was given, by the user or the file.
    """

    text: str
    unit: str
    name: str = ""
    declared: bool = False


@dataclass(frozen=True)
class Reading:
    """A record and how its file was understood.

    Parameters
    ----------
    record : Record
    table : Table
    sources : dict of str to Source
        By channel.
    unused : tuple of str
        Variables of the file that are not in the record.
    clock : str
        The sampling rate and how it was found, in words.
    """

    record: Record
    table: Table
    sources: dict[str, Source]
    unused: tuple[str, ...]
    clock: str = ""


class ReadingOptions(TypedDict, total=False):
    """How the variables of a file become channels; see :func:`read_record`."""

    mapping: Mapping[str, str] | None
    fs: float | None
    units: Mapping[str, str] | None
    name: str | None
    coordinates: str | None


def read_record(
    path: AnyPath | list[AnyPath],
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    coordinates: str | None = None,
    max_bytes: int = MAX_BYTES,
) -> Record:
    """Read the measured channels of one test from a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        See :func:`read_table` for the types and for several files of one test.
    mapping : mapping of str to str, optional
        Channels by ``[-] name [:, k] * factor @ unit``: ``{"x1": "qm", "F1":
        "vir*35.1507", "a2": "-acc[:, 2] @ g"}``. The factor may name a number held by
        the file. ``"none"`` drops a channel, ``"unknown"`` means that a force acts but
        was not measured. Channels are ``a1.., v1.., x1.., F1.., ag, vg, xg, t``; any
        other name becomes a covariate. Columns that carry a channel's name need no
        mapping; all others are left out.
    fs : float, optional
        Sampling rate, Hz, where the file has no time.
    units : mapping of str to str, optional
        Units by channel or by kind, ``{"a": "g", "x": "mm", "x3": "in"}``; ``@ unit``
        in the mapping goes first, a unit written in the file's header last. SI where
        nothing is said.
    name : str, optional
        Name of the test; if None, the name in the file, else the file's own.
    coordinates : {"relative", "absolute"}, optional
        Reference of velocities and displacements; if None, as the file says, else
        relative to the base.
    max_bytes : int

    Returns
    -------
    Record
        SI units. A file written by :func:`write_record` gives its record back bit for
        bit.

    Raises
    ------
    FileFormatError
        If the file cannot be read or has no such variable.
    ChannelError
        If a mapping or unit is not understood, or a channel does not hold finite
        numbers.
    MissingExtraError
        If the type of file or a unit needs an optional package.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.records.files import read_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "test 7.csv")
    ...     _ = path.write_text(
    ...         "t,laser [m],drive\\n0.00,0.1,0.1\\n0.01,0.5,0.2\\n0.02,0.1,0.1\\n"
    ...     )
    ...     rec = read_record(
    ...         path, mapping={"x1": "laser", "F1": "drive*35.15"}
    ...     )
    >>> rec, rec.force.ravel()
    (Record('test 7': 1 DOF, 3 samples at 100 Hz (0.03 s), channels F1, x1),
    array([3.515, 7.03 , 3.515]))
    """
    table = read_table(path, max_bytes=max_bytes)
    reading = understand(
        table, mapping=mapping, fs=fs, units=units, name=name, coordinates=coordinates
    )
    return reading.record


def inspect_record(
    path: AnyPath | list[AnyPath],
    *,
    max_bytes: int = MAX_BYTES,
    **options: Unpack[ReadingOptions],
) -> Reading:
    r"""Read a record as :func:`read_record`, and keep how the file was understood.

    Parameters
    ----------
    path : path-like or sequence of path-like
    max_bytes : int
    **options
        All others of :func:`read_record`.

    Returns
    -------
    Reading
        For :func:`describe`.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf import io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "own.csv")
    ...     _ = path.write_text(
    ...         "t,Deck\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(50))
    ...     )
    ...     reading = io.inspect_record(path, mapping={"x1": "Deck @ mm"})
    >>> print(io.describe(reading).splitlines()[3])
      x1  displacement relative to base     rms 0.003569 m, peak 0.006 m   <- Deck in mm
    """
    return understand(read_table(path, max_bytes=max_bytes), **options)


def read_excitation(
    path: AnyPath | list[AnyPath],
    n_dof: int,
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    max_bytes: int = MAX_BYTES,
) -> Record:
    """Read the excitation of a structure, to simulate its response.

    The motions of the record are zeros. A mapping, and units, of the whole test may
    name motions that are not in this file.

    Raises
    ------
    FileFormatError
        If no column is a force or the base acceleration.
    ChannelError
        If a force is unknown, or acts on a DOF beyond ``n_dof``.
    """
    table = read_table(path, max_bytes=max_bytes)
    mapping = _without_responses(mapping or {})
    units = _without_responses(units or {})
    base_moves = "ag" in mapping or "ag" in table.variables
    for kind in ("v", "x") if base_moves else ("v", "x", "a"):
        units.pop(kind, None)

    lines, sources = _lines_in_si(table, mapping, units)
    lines = _without_responses(lines)
    _require_excitation(lines, table, n_dof)

    n_samples = len(next(iter(lines.values())))
    clock = _clock_of(table, lines.get("t"), fs)
    for j in range(1, n_dof + 1):
        lines[f"x{j}"] = np.zeros(n_samples)  # a record needs motions
    record = _record_of(lines, clock, name or table.path.stem, "relative")
    _refuse_time_in_milliseconds(record, clock, sources, table)
    if record.unknown:
        raise ChannelError(
            f"F{record.unknown[0]} is unknown", "A simulation needs the force itself."
        )
    return record


def _is_response(channel: str) -> bool:
    """True for a motion; the base acceleration is an excitation."""
    return channel != "ag" and dimension_of(channel) in _MOTIONS


def _without_responses(by_channel: Mapping[str, T]) -> dict[str, T]:
    """Entries of channels other than motions of the structure."""
    return {c: entry for c, entry in by_channel.items() if not _is_response(c)}


def _require_excitation(
    lines: Mapping[str, np.ndarray], table: Table, n_dof: int
) -> None:
    """Refuse a file without forces, and forces beyond the structure."""
    forces = [channel for channel in lines if dimension_of(channel) == "force"]
    if not forces and "ag" not in lines:
        raise FileFormatError(
            f"{table.path}: no column is known to be a force or the base acceleration;"
            f" it holds {table.names}",
            "Name columns F1.., ag, t, or map them: mapping={'F1': 'name'}, --map"
            " F1=name.",
        )
    for channel in forces:
        if int(channel[1:]) > n_dof:
            raise ChannelError(
                f"{channel} acts on a DOF that the model does not have",
                f"It has DOFs 1 to {n_dof}.",
            )


def understand(
    table: Table,
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    coordinates: str | None = None,
) -> Reading:
    """Record and its origin from the variables of a file; see :func:`read_record`."""
    if coordinates is not None:
        require_coordinates(coordinates)
    if table.attributes is not None and not mapping and not units and fs is None:
        return _own_reading(table, table.attributes, name, coordinates)

    lines, sources = _lines_in_si(table, mapping or {}, units or {})
    _require_motion(lines, table)
    clock = _clock_of(table, lines.get("t"), fs)
    stated_name, stated_coordinates = _stated_in_file(table)
    record = _record_of(
        lines, clock, name or stated_name, coordinates or stated_coordinates
    )
    _refuse_time_in_milliseconds(record, clock, sources, table)

    return Reading(
        record,
        table,
        sources,
        unused=_unused_variables(table, sources),
        clock=_clock_in_words(record, clock, sources),
    )


def _stated_in_file(table: Table) -> tuple[str, str]:
    """Name and coordinates of the record of a file."""
    if table.attributes is None:
        return table.path.stem, "relative"
    return table.attributes.name, table.attributes.coordinates


def _unused_variables(table: Table, sources: Mapping[str, Source]) -> tuple[str, ...]:
    used = {source.name for source in sources.values()}
    return tuple(name for name in table.variables if name not in used)


def _require_motion(lines: Mapping[str, np.ndarray], table: Table) -> None:
    """Refuse a file without a motion of the structure."""
    bases = BASES.values()
    if any(_is_response(channel) and channel not in bases for channel in lines):
        return
    raise FileFormatError(
        f"{table.path}: no column is known to be a motion; it holds {table.names}",
        "Name columns a1.., v1.., x1.., F1.., ag, t, or map them: mapping={'x1':"
        " 'name'}, --map x1=name; pysindy-nrf inspect FILE --write-mapping FILE.toml"
        " proposes a mapping.",
    )


def _own_reading(
    table: Table, attributes: Attributes, name: str | None, coordinates: str | None
) -> Reading:
    """A record that this package wrote, under another name if one is given."""
    record = restored(attributes, table.variables)
    if name or coordinates:
        record = record.replace(
            name=name or record.name, coordinates=coordinates or record.coordinates
        )
    sources = {column: Source(column, si_unit(column)) for column in attributes.columns}
    clock = f"{record.fs:g} Hz, as written by this package"
    return Reading(record, table, sources, (), clock)


def _lines_in_si(
    table: Table, mapping: Mapping[str, str], units: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], dict[str, Source]]:
    """Samples in SI units and their origin, by channel."""
    assignment = assign_channels(table, mapping)
    declared = _declared_units(units)

    lines: dict[str, np.ndarray] = {}
    sources: dict[str, Source] = {}
    for channel, expression in assignment.items():
        if expression is not None:
            line = line_of(expression, table, channel)
            unit = _unit_of(channel, expression, table, declared)
            lines[channel] = _in_si(line, unit, channel)
            sources[channel] = Source(
                expression.text,
                unit or si_unit(channel),
                expression.name,
                declared=unit is not None,
            )
    _require_channels_of_units(declared, lines)
    n_samples = _common_length(lines, table)

    for channel, expression in assignment.items():
        if expression is None:
            lines[channel] = np.full(n_samples, np.nan)
            sources[channel] = Source("unknown", "")
    return lines, sources


def _declared_units(units: Mapping[str, str]) -> dict[str, str]:
    """Units that the user gave, by channel or by letter."""
    declared = {}
    for key, unit in units.items():
        if not isinstance(unit, str) or not unit.strip():
            raise ChannelError(
                f"The unit of {key!r} is {unit!r}", "Give a text such as 'mm' or 'g'."
            )
        name = str(key)
        channel = channel_of(name) or ("F" if name == "f" else name)
        declared[channel] = unit.strip()
    return declared


def _unit_of(
    channel: str, expression: Expression, table: Table, declared: Mapping[str, str]
) -> str | None:
    """Unit of a channel: as mapped, as declared, or as written in the file."""
    if expression.unit:
        return expression.unit
    if channel in declared:
        return declared[channel]
    if dimension_of(channel) is not None and channel[0] in declared:
        return declared[channel[0]]

    written = _written_unit(channel, expression.name, table)
    if written is None or expression.factor is None:
        return written
    return _unit_beside_factor(channel, expression, written)


def _written_unit(channel: str, name: str, table: Table) -> str | None:
    """Unit of a variable in the file, or at the end of its name."""
    if name in table.units:
        return table.units[name]
    _, suffix = split_suffix(name)
    if suffix is None or dimension_of(channel) is None:
        return None
    return suffix if kind_of_unit(suffix) == channel[0] else None


def _unit_beside_factor(
    channel: str, expression: Expression, written: str
) -> str | None:
    """Unit of a product whose first factor has a unit in the header.

    A factor for volts makes the channel's unit of them. One for millimetres may leave
    millimetres or not, which the user must say.
    """
    try:
        size = si_factor(written, channel)
    except ChannelError:  # another quantity, such as volts
        return None
    if size == 1:
        return written
    raise ChannelError(
        f"{channel} = {expression.text!r} has a factor, and the header says that"
        f" {expression.name!r} is in {written}: it is not clear in which unit the"
        " product is",
        f"Write '{expression.text} @ {written}' or '{expression.text} @"
        f" {si_unit(channel)}'.",
    )


def _in_si(line: np.ndarray, unit: str | None, channel: str) -> np.ndarray:
    """Samples of a channel in SI units; a covariate keeps its unit."""
    if not unit or dimension_of(channel) is None or line.dtype.kind != "f":
        return line
    scale = si_factor(unit, channel)
    return line if scale == 1 else line * scale


def _require_channels_of_units(
    declared: Mapping[str, str], lines: Mapping[str, np.ndarray]
) -> None:
    """Refuse a unit for a channel that is not there."""
    named = set(lines) | {channel[:1] for channel in lines}
    for key in declared:
        if key not in named:
            raise ChannelError(
                f"A unit is given for {key!r}, which is not among the channels"
                f" {', '.join(lines) or '(none)'}",
                "Name a channel (x1) or a kind (x, v, a, F, t).",
            )


def _common_length(lines: Mapping[str, np.ndarray], table: Table) -> int:
    """Number of samples of all channels."""
    lengths = {channel: len(line) for channel, line in lines.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{channel} {n}" for channel, n in lengths.items())
        raise ChannelError(
            f"{table.path}: channels differ in length, {shown}",
            "Map channels of one test; resample channels that were sampled with another"
            " clock.",
        )
    return max(lengths.values(), default=0)


@dataclass(frozen=True)
class _Clock:
    """Times of a file or a sampling rate, Hz, and where the rate came from."""

    time: np.ndarray | None
    fs: float | None
    origin: str = ""


def _clock_of(table: Table, time: np.ndarray | None, fs: float | None) -> _Clock:
    """The clock of a file: its time, a given rate, or the rate that it states."""
    if time is not None:
        is_text = time.dtype == object
        return _Clock(_timestamps(table, time) if is_text else time, fs)
    if fs is not None:
        return _Clock(None, fs, "as given")
    if table.fs is not None:
        return _Clock(None, table.fs, "as stated in the file")
    raise ChannelError(
        f"{table.path} has no time column",
        "Give the sampling rate, fs= (--fs, Hz), or map one: --map t=name.",
    )


def _record_of(
    lines: Mapping[str, np.ndarray], clock: _Clock, name: str, coordinates: str
) -> Record:
    """Record of lines in SI units."""
    channels = {c: line for c, line in lines.items() if dimension_of(c) and c != "t"}
    covariates = {c: line for c, line in lines.items() if dimension_of(c) is None}
    return Record.from_channels(
        channels,
        fs=clock.fs,
        time=clock.time,
        covariates=covariates,
        name=name,
        coordinates=coordinates,
    )


def _refuse_time_in_milliseconds(
    record: Record, clock: _Clock, sources: Mapping[str, Source], table: Table
) -> None:
    """Refuse a time without a unit at which accelerations come far too slowly."""
    time = clock.time
    if time is None or clock.fs is not None or sources["t"].declared:
        return
    if record.fs >= SLOW or record.acceleration is None or time.dtype.kind not in "iuf":
        return

    unit = "ms" if 1e3 * record.fs >= SLOW else "us"
    raise ChannelError(
        f"{table.path}: accelerations at {record.fs:.3g} Hz say that the time is in"
        f" {unit}, not in s",
        f"Declare its unit: units={{'t': '{unit}'}}, --unit t={unit} (or --unit t=s).",
    )


def _clock_in_words(
    record: Record, clock: _Clock, sources: Mapping[str, Source]
) -> str:
    """The sampling rate, where it came from, and how even the time is."""
    if clock.time is None:
        return f"{record.fs:g} Hz, {clock.origin}"

    steps = np.diff(seconds_of(clock.time, record.name))
    variation = 100 * float(np.abs(steps * record.fs - 1).max())
    evenness = "even"
    if variation >= EVEN_PERCENT:
        evenness = f"steps vary by up to {variation:.2g} %"
    return f"{record.fs:g} Hz, from the time {sources['t'].text!r}, {evenness}"


def _timestamps(table: Table, values: np.ndarray) -> np.ndarray:
    """Texts as time stamps, or as times of day."""
    texts = pd.Series(values)
    is_number = pd.to_numeric(texts, errors="coerce").notna().to_numpy()
    if len(values) / 2 < is_number.sum() < len(values):  # a footer, or names again
        row = int(np.argmin(is_number))
        raise FileFormatError(
            f"{table.path}: the time holds the text {values[row]!r} in data row"
            f" {row + 1}",
            "Remove this row; every row is one sample.",
        )

    try:
        if _TIME_OF_DAY.fullmatch(str(values[0]).strip()):
            return pd.to_timedelta(texts).to_numpy()
        return pd.DatetimeIndex(pd.to_datetime(texts)).to_numpy()
    except (ValueError, TypeError) as error:
        raise FileFormatError(
            f"{table.path}: the time {values[0]!r} is not understood",
            "Give seconds, or timestamps like 2024-05-01T12:00:00.125.",
        ) from error
