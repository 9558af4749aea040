"""From a file to a record, or to the excitation of a simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict, TypeVar, Unpack

import numpy as np

from ...common.warn import warn_user
from ...exceptions import ChannelError, DataQualityWarning, FileFormatError
from ..channels import channel_of
from ..quality import QualityNote
from ..record import BASES, Record, require_coordinates
from .attributes import Attributes, restored
from .file_clock import (
    FileClock,
    Source,
    clock_of_file,
    in_si,
    is_end_of_names,
    written_unit,
)
from .mapping.assignment import assign_channels
from .mapping.expression import Expression, line_of
from .mapping.words import MOTION_LETTERS, WORDS_OF_BASE, letter_named, names_one_of
from .preparation import Preparation
from .table import MAX_BYTES, Table
from .tables import AnyPath, read_table
from .units import dimension_of, kind_of_unit, rotation_factor, si_factor, si_unit

MAX_CHANNELS_SHOWN = 4  # of one length, in a message
_MOTIONS = ("length", "velocity", "acceleration")
T = TypeVar("T")


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
    hold: str | None
    preparation: Preparation | None


def read_record(
    path: AnyPath | list[AnyPath],
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    coordinates: str | None = None,
    hold: str | None = None,
    preparation: Preparation | None = None,
    max_bytes: int = MAX_BYTES,
) -> Record:
    """Read the measured channels of one test from a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        See :func:`read_table` for the types and for several files of one test.
    mapping : mapping of str to str, optional
        Channels by ``[-] name [:, k] * factor @ unit``: ``{"x1": "qm", "F1":
        "vir*35.1507", "a2": "-acc[:, 2] @ g"}``, or by several columns, ``"mean(left,
        right) @ g"``. The factor may name a number in the file. ``"none"`` drops a
        channel, ``"unknown"`` means that a force acts but was not measured. Channels
        are ``a1.., v1.., x1.., F1.., ag, vg, xg, t``; any other name becomes a
        covariate. Columns that carry a channel's name need no mapping; all others are
        left out.
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
    hold : {"cubic", "linear", "zero"}, optional
        Course of the forces between the samples: band-limited as measured ones are,
        straight, or constant from each sample to the next, as the command of a D/A
        converter is. If None, as the file says, else unknown.
    preparation : Preparation, optional
        A part of the test, a lower rate, rows left out, accelerations relative to the
        base.
    max_bytes : int

    Returns
    -------
    Record
        SI units. Channels with separate clocks (several files, start times and
        rates in the file) are brought to the slowest; ``quality`` says how. A file
        written by :func:`write_record` gives its record back bit for bit.

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
        table,
        mapping=mapping,
        fs=fs,
        units=units,
        name=name,
        coordinates=coordinates,
        hold=hold,
        preparation=preparation,
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
    >>> print(io.describe(reading).splitlines()[4])
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

    The motions of the record are zeros. A mapping, and units, of the entire test may
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

    measured, sources = _measured_in_si(table, mapping, units)
    measured = _without_responses(measured)
    _require_excitation(measured, sources, table, n_dof)

    clock, lines = clock_of_file(table, measured, sources, fs)
    lines = _with_unknown_forces(lines, sources, table, clock)
    n_samples = len(next(iter(lines.values())))
    for j in range(1, n_dof + 1):
        lines[f"x{j}"] = np.zeros(n_samples)  # a record needs motions
    record = _record_of(lines, clock, name or table.path.stem)
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
    lines: Mapping[str, np.ndarray],
    sources: Mapping[str, Source],
    table: Table,
    n_dof: int,
) -> None:
    """Refuse a file without forces, and forces beyond the structure."""
    forces = [channel for channel in sources if dimension_of(channel) == "force"]
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
    hold: str | None = None,
    preparation: Preparation | None = None,
) -> Reading:
    """Record and its origin from the variables of a file; see :func:`read_record`."""
    preparation = preparation or Preparation()
    if coordinates is not None:
        require_coordinates(coordinates)
    as_written = not mapping and not units and fs is None
    if table.attributes is not None and as_written and preparation == Preparation():
        return _own_reading(table, table.attributes, name, coordinates, hold)

    measured, sources = _measured_in_si(table, mapping or {}, units or {})
    measured = preparation.of_lines(measured)
    _require_motion(measured, table)
    clock, lines = clock_of_file(table, measured, sources, fs)
    lines = _with_unknown_forces(lines, sources, table, clock)
    labels = _labels(table, name, coordinates, hold)
    record = _record_of(lines, clock, *labels)
    record = _noted_if_rotating(preparation.of_record(record), sources)
    assumed = _assumed(sources, clock, record)
    record = record.with_quality(record.quality + assumed)

    unused = _unused_variables(table, sources, clock)
    _warn_of_overlooked(table, sources, unused)
    return Reading(record, table, sources, unused, clock=clock.in_words(record))


def _warn_of_overlooked(
    table: Table, sources: Mapping[str, Source], unused: Sequence[str]
) -> None:
    """Warn of a force or a motion of the base that no channel uses.

    Only where none is mapped, so that it would be taken as zero.
    """
    has_force = any(dimension_of(channel) == "force" for channel in sources)
    has_base = any(channel in sources for channel in BASES.values())
    for name in _as_long_as_used(table, sources, unused):
        letter = kind_of_unit(written_unit("", name, table)) or letter_named(name)
        is_motion_of_base = letter in MOTION_LETTERS and names_one_of(
            name, WORDS_OF_BASE
        )
        if letter == "F" and not has_force:
            what = (
                f"The column {name!r} seems to be a force, and no channel uses it: all"
                " floors are taken as unforced"
            )
            cure = "Map it (F1 = name), or leave it out of the file."
            warn_user(DataQualityWarning(what, cure))
        elif is_motion_of_base and not has_base:
            what = (
                f"The column {name!r} seems to be a motion of the base, and no channel"
                " uses it: the base is taken at rest"
            )
            cure = "Map it (ag = name), or leave it out of the file."
            warn_user(DataQualityWarning(what, cure))


def _as_long_as_used(
    table: Table, sources: Mapping[str, Source], names: Sequence[str]
) -> list[str]:
    """Variables with as many samples as one that a channel uses."""
    lengths: set[tuple[int, ...]] = set()
    for source in sources.values():
        lengths.update(table.variables[name].shape[:1] for name in source.columns)
    return [name for name in names if table.variables[name].shape[:1] in lengths]


def _noted_if_rotating(record: Record, sources: Mapping[str, Source]) -> Record:
    """The record; of rotations if a source is one."""
    if not any(is_rotation(c, source) for c, source in sources.items() if c != "t"):
        return record
    return record.of_rotations()


def _assumed(
    sources: Mapping[str, Source], clock: FileClock, record: Record
) -> tuple[QualityNote, ...]:
    """Units and a rate that nothing in the file states."""
    bare = [name for name in record.channels() if _has_bare_unit(name, sources)]
    sentences = []
    if bare:
        units = ", ".join(dict.fromkeys(si_unit(channel) for channel in bare))
        sentences.append(
            f"{', '.join(bare)} are taken in {units}: no unit is given for them."
        )
    sentences += _units_from_names(sources)
    if not clock.rate_is_stated:
        sentences.append(
            f"The rate of {record.fs:g} Hz is {clock.origin}: no time is read."
        )
    elif not clock.unit_is_known:
        sentences.append("The time is taken in s: no unit is given for it.")
    return tuple(
        QualityNote("assumed", sentence, record=record.name) for sentence in sentences
    )


def _units_from_names(sources: Mapping[str, Source]) -> list[str]:
    """A sentence on channels whose unit is only the end of a name."""
    channels_by_unit: dict[str, list[str]] = {}
    for channel, source in sources.items():
        if source.from_name:
            channels_by_unit.setdefault(source.unit, []).append(channel)
    if not channels_by_unit:
        return []
    groups = [
        f"{', '.join(group)} in {unit}" for unit, group in channels_by_unit.items()
    ]
    return [f"Units are read from the ends of names: {'; '.join(groups)}."]


def _has_bare_unit(channel: str, sources: Mapping[str, Source]) -> bool:
    """Whether a channel of the file has a dimension, and no unit."""
    source = sources.get(channel)
    if source is None or source.declared:
        return False
    return dimension_of(channel) is not None


def _labels(
    table: Table, name: str | None, coordinates: str | None, hold: str | None
) -> tuple[str, str, str | None]:
    """Name, coordinates and course of the forces: as asked for, or as the file says."""
    stated = table.attributes
    if stated is None:
        return name or table.path.stem, coordinates or "relative", hold
    return (
        name or stated.name,
        coordinates or stated.coordinates,
        hold or stated.hold,
    )


def _unused_variables(
    table: Table, sources: Mapping[str, Source], clock: FileClock
) -> tuple[str, ...]:
    used = {name for source in sources.values() for name in source.columns}
    used.update(clock.columns)
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
    table: Table,
    attributes: Attributes,
    name: str | None,
    coordinates: str | None,
    hold: str | None,
) -> Reading:
    """A record that this package wrote, under another name if one is given."""
    record = restored(attributes, table.variables)
    if name or coordinates or hold:
        record = record.replace(
            name=name or record.name,
            coordinates=coordinates or record.coordinates,
            hold=hold or record.hold,
        )
    sources = {column: Source(column, si_unit(column)) for column in attributes.columns}
    clock = f"{record.fs:g} Hz, as written by this package"
    return Reading(record, table, sources, (), clock)


def _measured_in_si(
    table: Table, mapping: Mapping[str, str], units: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], dict[str, Source]]:
    """Measured samples in SI units by channel, and the origin of all channels."""
    assignment = assign_channels(table, mapping)
    declared = _declared_units(units)

    lines: dict[str, np.ndarray] = {}
    sources: dict[str, Source] = {}
    for channel, expression in assignment.items():
        if expression is None:
            sources[channel] = Source("unknown", "")
            continue
        line = line_of(expression, table, channel)
        unit = _unit_of(channel, expression, table, declared)
        lines[channel] = in_si(line, unit, channel)
        is_given = _is_given_by_user(channel, mapping, declared)
        sources[channel] = Source(
            expression.text,
            unit or si_unit(channel),
            expression.columns,
            declared=unit is not None,
            from_name=not is_given and is_end_of_names(unit, expression, table),
        )
    _require_channels_of_units(declared, lines)
    _require_one_kind_of_motion(sources)
    return lines, sources


def _require_one_kind_of_motion(sources: Mapping[str, Source]) -> None:
    """Refuse rotations beside translations: a chain has one kind of motion."""
    channels = [c for c, source in sources.items() if c != "t" and source.declared]
    rotating = [c for c in channels if is_rotation(c, sources[c])]
    others = [c for c in channels if dimension_of(c) and c not in rotating]
    if rotating and others:
        first, second = rotating[0], others[0]
        raise ChannelError(
            f"{first} in {sources[first].unit} is a rotation, {second} in"
            f" {sources[second].unit} is a translation",
            "A chain has one kind of motion: N m with rad, rad/s and kg m^2, or N with"
            " m, m/s and kg. Leave one out ('none'), or scale it by a lever arm.",
        )


def is_rotation(channel: str, source: Source) -> bool:
    """Whether a channel is an angle, its rate or a torque, by its unit."""
    return bool(source.unit) and rotation_factor(source.unit, channel) is not None


def _with_unknown_forces(
    lines: Mapping[str, np.ndarray],
    sources: Mapping[str, Source],
    table: Table,
    clock: FileClock,
) -> dict[str, np.ndarray]:
    """Lines of one length, and NaN for forces that act and were not measured."""
    times = {} if clock.time is None else {"t": clock.time}
    n_samples = _common_length({**times, **lines}, table)
    unknown = {
        channel: np.full(n_samples, np.nan)
        for channel, source in sources.items()
        if source.text == "unknown" and not source.columns
    }
    return {**lines, **unknown}


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


def _is_given_by_user(
    channel: str, mapping: Mapping[str, str], declared: Mapping[str, str]
) -> bool:
    """Whether the user gave the unit of a channel."""
    return (
        channel in declared or channel[0] in declared or "@" in mapping.get(channel, "")
    )


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

    written = _written_unit_of_columns(channel, expression, table)
    if written is None or expression.factor is None:
        return written
    return _unit_beside_factor(channel, expression, written)


def _written_unit_of_columns(
    channel: str, expression: Expression, table: Table
) -> str | None:
    """The unit that the file says of the columns of a channel, which is one."""
    units = {written_unit(channel, name, table) for name in expression.columns}
    if len(units) > 1:
        shown = ", ".join(sorted(str(unit or "no unit") for unit in units))
        raise ChannelError(
            f"{channel} = {expression.text!r} combines columns in {shown}",
            "Combine columns of one unit, or bring them to one by factors and say it:"
            f" '{expression.text} @ {si_unit(channel)}'.",
        )
    return units.pop()


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
        f" {expression.text!r} is in {written}: it is not clear in which unit the"
        " product is",
        f"Write '{expression.text} @ {written}' or '{expression.text} @"
        f" {si_unit(channel)}'.",
    )


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
        raise ChannelError(
            f"{table.path}: channels differ in length, {_lengths_in_words(lengths)}",
            "Map channels of one test. Where they have clocks of their own, give each"
            " its file with its own time, or resample them.",
        )
    return max(lengths.values(), default=0)


def _lengths_in_words(lengths: Mapping[str, int]) -> str:
    """Channels by their length: ``1500 of t, 3 of a1, a2, a3 and 97 more``."""
    by_length: dict[int, list[str]] = {}
    for channel, length in lengths.items():
        by_length.setdefault(length, []).append(channel)

    parts = []
    for length, channels in by_length.items():
        shown = ", ".join(channels[:MAX_CHANNELS_SHOWN])
        hidden = len(channels) - MAX_CHANNELS_SHOWN
        more = f" and {hidden} more" if hidden > 0 else ""
        parts.append(f"{shown}{more} {length}")
    return "; ".join(parts[:MAX_CHANNELS_SHOWN])


def _record_of(
    lines: Mapping[str, np.ndarray],
    clock: FileClock,
    name: str,
    coordinates: str = "relative",
    hold: str | None = None,
) -> Record:
    """Record of lines in SI units."""
    channels = {c: line for c, line in lines.items() if dimension_of(c)}
    covariates = {c: line for c, line in lines.items() if dimension_of(c) is None}
    record = Record.from_channels(
        channels,
        fs=clock.fs,
        time=clock.time,
        covariates=covariates,
        name=name,
        coordinates=coordinates,
        hold=hold,
    )
    if clock.start is not None:
        record = record.starting_at(clock.start)
    if record.acceleration is not None:
        clock.refuse_slow_rate(record.fs)
    return record.with_quality(clock.notes)
