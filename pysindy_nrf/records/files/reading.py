"""From a file to its variables, to a record, or to the excitation of a simulation:
reader, columns, units, clock.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import ChannelError, FileFormatError
from ..channels import channel_of
from ..record import BASES, MATRICES, Record, seconds_of
from .arrays import SIGNATURE, read_hdf5, read_mat, read_npz, read_parquet, read_tdms
from .delimited import read_delimited, read_excel, split_unit
from .mapping import Expression, line_of, parse
from .strong_motion import is_strong_motion, read_strong_motion
from .table import MAX_BYTES, Table, check_file, restored
from .uff import read_uff
from .units import dimension_of, factor, kind_of_unit, si_unit, split_suffix

_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")
_FORCE = re.compile(
    r"(?:F|[Ff]orce)[\s_]*([1-9]\d*)(?![^\W_])"
)  # not: F2kg, f2 (a frequency)
SLOW = 8.0  # Hz; accelerations of structures are sampled faster
_MOTIONS = ("length", "velocity", "acceleration")


@dataclass
class Source:
    """Origin of a channel: the mapping or the column's name, the unit, the variable of
    the file; was the unit said?
    """

    text: str
    unit: str
    name: str = ""
    declared: bool = False


@dataclass
class Reading:
    """A record and how the file was understood."""

    record: Record
    table: Table
    sources: dict[str, Source]  # by channel
    unused: tuple[str, ...]  # variables of the file that are not in the record
    clock: str = ""  # sampling rate and how it was found, in words


def read_record(
    path: Any,
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
    return inspect_record(
        path,
        mapping=mapping,
        fs=fs,
        units=units,
        name=name,
        coordinates=coordinates,
        max_bytes=max_bytes,
    ).record


def inspect_record(path: Any, *, max_bytes: int = MAX_BYTES, **options: Any) -> Reading:
    r"""Read a record as :func:`read_record` does and keep how the file was understood,
    for :func:`describe`.

    Parameters
    ----------
    **options
        All others of :func:`read_record`.

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
    path: Any,
    n_dof: int,
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    max_bytes: int = MAX_BYTES,
) -> Record:
    """Read the excitation of a structure, to simulate its response; the motions of the
    record are zeros.
    """
    table = read_table(path, max_bytes=max_bytes)
    # a mapping file of the whole test may name motions that are not in this file
    mapping = {c: text for c, text in (mapping or {}).items() if not _is_motion(c)}
    base = "ag" in mapping or "ag" in table.variables
    units = {
        c: unit
        for c, unit in (units or {}).items()
        if not _is_motion(c) and c not in ("v", "x", "a"[base:])
    }
    lines, sources = lines_of(table, mapping, units)
    lines = {c: line for c, line in lines.items() if not _is_motion(c)}
    if not any(dimension_of(c) == "force" or c == "ag" for c in lines):
        what = (
            f"{table.path}: no column is known to be a force or the base acceleration;"
            f" it holds {table.names}"
        )
        raise FileFormatError(
            what,
            "Name columns F1.., ag, t, or map them: mapping={'F1': 'name'}, --map"
            " F1=name.",
        )
    beyond = [
        c for c in lines if c[:1] == "F" and c[1:].isdigit() and int(c[1:]) > n_dof
    ]
    if beyond:
        raise ChannelError(
            f"{beyond[0]} acts on a DOF that the model does not have",
            f"It has DOFs 1 to {n_dof}.",
        )
    n = len(next(iter(lines.values())))
    lines |= {
        f"x{j}": np.zeros(n) for j in range(1, n_dof + 1)
    }  # a record needs motions
    record = record_of(table, lines, sources, fs, name or table.path.stem, "relative")[
        0
    ]
    if record.unknown:
        raise ChannelError(
            f"F{record.unknown[0]} is unknown", "A simulation needs the force itself."
        )
    return record


def _is_motion(channel: str) -> bool:
    """True for a response channel; the base acceleration is an excitation."""
    return channel != "ag" and dimension_of(channel) in _MOTIONS


def understand(
    table: Table,
    *,
    mapping: Mapping[str, str] | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    name: str | None = None,
    coordinates: str | None = None,
) -> Reading:
    """Record and its origin from the variables of a file."""
    own = table.attributes
    if coordinates not in (None, "relative", "absolute"):
        raise ChannelError(
            f"coordinates={coordinates!r} is unknown",
            "Choose 'relative' (to the base) or 'absolute'.",
        )
    if own is not None and not mapping and not units and fs is None:
        record = restored(own, table.variables)
        if name or coordinates:
            record = record.replace(
                name=name or record.name, coordinates=coordinates or record.coordinates
            )
        sources = {c: Source(c, si_unit(c)) for c in own.columns}
        return Reading(
            record, table, sources, (), f"{record.fs:g} Hz, as written by this package"
        )
    lines, sources = lines_of(table, mapping, units)
    if not any(dimension_of(c) in _MOTIONS and c not in BASES.values() for c in lines):
        cure = (
            "Name columns a1.., v1.., x1.., F1.., ag, t, or map them: mapping={'x1':"
            " 'name'}, --map x1=name; "
        )
        cure += "pysindy-nrf inspect FILE --write-mapping FILE.toml proposes a mapping."
        raise FileFormatError(
            f"{table.path}: no column is known to be a motion; it holds {table.names}",
            cure,
        )
    title = name or (own.name if own else table.path.stem)
    record, clock = record_of(
        table,
        lines,
        sources,
        fs,
        title,
        coordinates or (own.coordinates if own else "relative"),
    )
    used = {source.name for source in sources.values()}
    return Reading(
        record,
        table,
        sources,
        tuple(v for v in table.variables if v not in used),
        clock,
    )


def lines_of(
    table: Table, mapping: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> tuple[dict[str, np.ndarray], dict[str, Source]]:
    """Samples in SI units and their origin, by channel."""
    chosen = _chosen(table, mapping or {})
    declared = _declared(units)
    lines: dict[str, np.ndarray] = {}
    sources: dict[str, Source] = {}
    for channel, expression in chosen.items():
        if expression is None:
            continue
        line = line_of(expression, table, channel)
        unit = _unit(channel, expression, table, declared)
        if unit and dimension_of(channel) is not None and line.dtype.kind == "f":
            scale = factor(unit, channel)
            line = line if scale == 1 else line * scale
        lines[channel] = line
        sources[channel] = Source(
            expression.text, unit or si_unit(channel), expression.name, unit is not None
        )
    stray = [key for key in declared if not any(key in (c, c[:1]) for c in lines)]
    if stray:
        what = (
            f"A unit is given for {stray[0]!r}, which is not among the channels"
            f" {', '.join(lines) or '(none)'}"
        )
        raise ChannelError(what, "Name a channel (x1) or a kind (x, v, a, F, t).")
    lengths = {c: len(line) for c, line in lines.items()}
    if len(set(lengths.values())) > 1:
        what = f"{table.path}: channels differ in length, " + ", ".join(
            f"{c} {n}" for c, n in lengths.items()
        )
        raise ChannelError(
            what,
            "Map channels of one test; resample channels that were sampled with another"
            " clock.",
        )
    for channel in (c for c, expression in chosen.items() if expression is None):
        lines[channel] = np.full(max(lengths.values(), default=0), np.nan)
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
    """Record of lines in SI units, and a text on its clock."""
    said = "as given"
    if "t" in lines and lines["t"].dtype == object:
        lines["t"] = _timestamps(table, lines["t"])
    elif "t" not in lines and fs is None:
        fs, said = table.fs, "as stated in the file"
        if fs is None:
            cure = "Give the sampling rate, fs= (--fs, Hz), or map one: --map t=name."
            raise ChannelError(f"{table.path} has no time column", cure)
    channels = {c: line for c, line in lines.items() if dimension_of(c)}
    record = Record.from_frame(
        pd.DataFrame(channels), fs=fs, name=name, coordinates=coordinates
    )
    if len(channels) < len(lines):  # no name of a covariate makes it a channel
        record = record.replace(
            covariates={c: line for c, line in lines.items() if not dimension_of(c)}
        )
    bare = (
        "t" in lines
        and fs is None
        and not (sources["t"].declared if "t" in sources else False)
    )
    if (
        bare
        and record.fs < SLOW
        and lines["t"].dtype.kind in "iuf"
        and any(re.fullmatch(r"a\d+", c) for c in channels)
    ):
        unit = "ms" if 1e3 * record.fs >= SLOW else "us"
        what = (
            f"{table.path}: accelerations at {record.fs:.3g} Hz say that the time is in"
            f" {unit}, not in s"
        )
        raise ChannelError(
            what,
            f"Declare its unit: units={{'t': '{unit}'}}, --unit t={unit} (or --unit"
            " t=s).",
        )
    if "t" in lines:
        jitter = 100 * float(
            np.abs(np.diff(seconds_of(lines["t"], record.name)) * record.fs - 1).max()
        )
        even = "even" if jitter < 0.01 else f"steps vary by up to {jitter:.2g} %"
        said = (
            f"from the time{' ' + repr(sources['t'].text) if 't' in sources else ''},"
            f" {even}"
        )
    return record, f"{record.fs:g} Hz, {said}"


def _chosen(table: Table, mapping: Mapping[str, str]) -> dict[str, Expression | None]:
    """Expression by channel, None for an unknown force: the file's own names first,
    then the mapping.
    """
    chosen: dict[str, Expression | None] = {}
    extra = set(table.attributes.covariates) if table.attributes else set()
    for name, values in table.variables.items():
        if name in extra:
            chosen[name] = Expression(name)
        elif name in MATRICES.values() and values.ndim == 2:
            for k in range(values.shape[1]):
                chosen[f"{name}{k + 1}"] = Expression(name, column=k)
        elif (channel := channel_of(name)) and values.ndim == 1:
            if channel in chosen:
                cure = f"Rename one, or map it: {channel}=name."
                raise FileFormatError(
                    f"{table.path} has two columns that are channel {channel}", cure
                )
            chosen[channel] = Expression(name)
    said = {channel_of(str(key)) or str(key): text for key, text in mapping.items()}
    for name in table.variables:
        bare, unit = split_unit(name)
        bare, unit = (bare, unit) if unit else split_suffix(name)
        channel = channel_of(bare) or ""
        used = (
            channel in chosen
            or channel in said
            or any(name in str(text) for text in said.values())
        )
        if (
            unit
            and table.variables[name].ndim == 1
            and not used
            and kind_of_unit(unit) == channel[:1]
        ):
            chosen[channel] = Expression(name, unit=unit)
        elif unit and dimension_of(channel) == "force" and not used:
            factor(
                unit, channel
            )  # an error: a force that acts is not "known to be unforced"
            chosen[channel] = Expression(name, unit=unit)
    lengths = {table.variables[one.name].shape[:1] for one in chosen.values() if one}
    for name in (v for v in table.variables if table.variables[v].shape in lengths):
        at = _FORCE.match(name)
        if at and not (
            f"F{at[1]}" in {*chosen, *said}
            or any(name in str(text) for text in said.values())
        ):
            what = (
                f"{table.path}: the column {name!r} seems to be the force F{at[1]}, in"
                " no unit that is known"
            )
            raise ChannelError(
                what,
                f"Map it, mapping={{'F{at[1]}': 'name * number @ N'}} (--map), or say"
                " 'none'.",
            )
    for channel, text in said.items():
        if channel in ("a", "v", "x", "F", "f", ""):
            cure = "Write a1, v2, x3, F1, ag, vg, xg, t, or the name of a covariate."
            raise ChannelError(f"The channel {channel!r} has no number", cure)
        word = text.strip().lower() if isinstance(text, str) else ""
        if word == "none":
            chosen.pop(channel, None)
        elif word == "unknown":
            if dimension_of(channel) != "force":
                cure = (
                    "Only a force can act and not be measured; write 'none' to drop a"
                    " channel."
                )
                raise ChannelError(f"Channel {channel} cannot be 'unknown'", cure)
            chosen[channel] = None
        else:
            chosen[channel] = parse(text, table, channel)
    return chosen


def _declared(units: Mapping[str, str] | None) -> dict[str, str]:
    out = {}
    for key, unit in (units or {}).items():
        if not isinstance(unit, str) or not unit.strip():
            raise ChannelError(
                f"The unit of {key!r} is {unit!r}", "Give a text such as 'mm' or 'g'."
            )
        out[channel_of(str(key)) or {"f": "F"}.get(str(key), str(key))] = unit.strip()
    return out


def _unit(
    channel: str, expression: Expression, table: Table, declared: Mapping[str, str]
) -> str | None:
    if expression.unit:
        return expression.unit
    if channel in declared:
        return declared[channel]
    if dimension_of(channel) is not None and channel[0] in declared:
        return declared[channel[0]]
    written = table.units.get(expression.name)
    suffix = split_suffix(expression.name)[1]
    if (
        written is None
        and suffix is not None
        and kind_of_unit(suffix) == channel[:1]
        and dimension_of(channel)
    ):
        written = suffix
    if written is None or expression.factor is None:
        return written
    try:
        size = factor(written, channel)
    except ChannelError:
        # another quantity, such as volts: the factor converts it to the channel's unit
        return None
    if size != 1:
        raise ChannelError(
            f"{channel} = {expression.text!r} has a factor, and the header says that"
            f" {expression.name!r} is in {written}: it is not clear in which unit the"
            " product is",
            f"Write '{expression.text} @ {written}' or '{expression.text} @"
            f" {si_unit(channel)}'.",
        )
    return written


def _timestamps(
    table: Table, values: np.ndarray
) -> pd.DatetimeIndex | pd.TimedeltaIndex:
    numbers = pd.to_numeric(pd.Series(values), errors="coerce").notna().to_numpy()
    if len(values) > numbers.sum() > len(values) / 2:  # a footer, or repeated names
        row = int(np.argmin(numbers))
        cure = "Remove this row; every row is one sample."
        raise FileFormatError(
            f"{table.path}: the time holds the text {values[row]!r} in data row"
            f" {row + 1}",
            cure,
        )
    try:
        if _TIME_OF_DAY.fullmatch(str(values[0]).strip()):
            return pd.TimedeltaIndex(pd.to_timedelta(pd.Series(values)))
        return pd.DatetimeIndex(pd.to_datetime(pd.Series(values)))
    except (ValueError, TypeError) as error:
        cure = "Give seconds, or timestamps like 2024-05-01T12:00:00.125."
        raise FileFormatError(
            f"{table.path}: the time {values[0]!r} is not understood", cure
        ) from error


READERS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), read_delimited),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
    ".mat": read_mat,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    **dict.fromkeys((".npz", ".npy"), read_npz),
    **dict.fromkeys((".uff", ".unv"), read_uff),
    **dict.fromkeys((".xlsx", ".xlsm"), read_excel),
    ".tdms": read_tdms,
    **dict.fromkeys((".v2", ".v2c", ".v1", ".v1c", ".v0c"), read_strong_motion),
}
# First bytes of a file, the suffixes that fit them, and their name.
_SIGNATURES = (
    (b"PAR1", (".parquet", ".pq"), "Parquet"),
    (SIGNATURE, (".h5", ".hdf5", ".mat"), "HDF5"),
    (b"MATLAB 5.0", (".mat",), "MATLAB"),
    (b"MATLAB 7.3", (".mat",), "MATLAB v7.3"),
    (
        b"PK\x03\x04",
        (".npz", ".xlsx", ".xlsm"),
        "a ZIP archive (an Excel sheet or NPZ)",
    ),
    (b"TDSm", (".tdms",), "TDMS"),
    (b"\x93NUMPY", (".npy",), "NumPy"),
)


def read_table(path: Any, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read the variables of a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        CSV and other delimited text (``.csv .txt .tsv .dat .asc``), Parquet (``.parquet
        .pq``), Excel (``.xlsx``), TDMS (``.tdms``), MATLAB v5 and v7.3 (``.mat``), HDF5
        (``.h5 .hdf5``), NumPy (``.npz .npy``), UFF 58 (``.uff .unv``) or strong motion
        (CSMIP and COSMOS, ``.v2 .v2c .v1 .v1c``, or ``.txt`` that starts as one).
        Several files are channels of one test: their variables are called
        ``<file>.<variable>``.
    max_bytes : int
        Larger files, and archives that unpack to more, are refused.

    Returns
    -------
    Table
        Variables by name, as in the file; units written in a header; notes on the
        decisions of the reader.

    Raises
    ------
    FileFormatError
        If the file is empty, cut off, of an unknown type, or not what its name says.
    MissingExtraError
        If the type needs an optional package.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.records.files import read_table
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "test 7.csv")
    ...     _ = path.write_text(
    ...         "t [s];x1;F1\\n0,000;0,0;1,5\\n0,001;0,2;1,4\\n"
    ...     )
    ...     read_table(path).variables["x1"]
    array([0. , 0.2])
    """
    if isinstance(path, (list, tuple)):
        return _together([read_table(one, max_bytes=max_bytes) for one in path])
    path = Path(path)
    check_file(path, max_bytes)
    suffix = path.suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        cure = f"Supported types are {' '.join(READERS)}."
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which is not read", cure
        )
    with open(path, "rb") as file:
        head = file.read(400)
    for signature, suffixes, kind in _SIGNATURES:
        if head.startswith(signature) and suffix not in suffixes:
            cure = f"Rename it to {suffixes[0]}, or export it as {suffix}."
            raise FileFormatError(f"{path} is called {suffix} but holds {kind}", cure)
    if reader is read_delimited and is_strong_motion(head.decode("latin-1")):
        reader = read_strong_motion
    table = reader(path, max_bytes)
    if not any(values.size > 1 for values in table.variables.values()):
        cure = "Give one variable or column for each measured channel."
        raise FileFormatError(f"{path} holds no channel of numbers", cure)
    return table


def _together(tables: list[Table]) -> Table:
    """One table of the channels of one test in several files."""
    if not tables:
        raise FileFormatError("No file was given", "Name at least one.")
    by_stem = {table.path.stem: table for table in tables}
    if len(by_stem) < len(tables):
        twice = next(
            table.path.stem for table in tables if by_stem[table.path.stem] is not table
        )
        raise FileFormatError(
            f"Two files are called {twice!r}",
            "Rename one: variables are named after their file.",
        )
    rates = {table.path.name: table.fs for table in tables if table.fs is not None}
    if len(set(rates.values())) > 1:
        shown = ", ".join(f"{name} {fs:g} Hz" for name, fs in rates.items())
        raise FileFormatError(
            f"The files are sampled differently: {shown}", "Resample them to one clock."
        )
    first = tables[0]
    together = Table(first.path, "", {}, fs=next(iter(rates.values()), None))
    together.kind = (
        f"{', '.join(dict.fromkeys(table.kind for table in tables))} ({len(tables)}"
        " files)"
    )
    together.decimal = "," if any(table.decimal == "," for table in tables) else "."
    for stem, table in by_stem.items():
        together.variables |= {
            f"{stem}.{name}": values for name, values in table.variables.items()
        }
        together.units |= {f"{stem}.{name}": unit for name, unit in table.units.items()}
        together.notes += [f"{stem}: {note}" for note in table.notes]
    if all("t" in table.variables for table in tables):
        for stem, table in by_stem.items():
            if not np.array_equal(table.variables["t"], first.variables["t"]):
                cure = "Resample them to one clock."
                raise FileFormatError(
                    f"The times of the files {first.path.stem!r} and {stem!r} differ",
                    cure,
                )
        written = {table.units.get("t", "s") for table in tables}
        if len({factor(unit, "t") for unit in written}) > 1:
            cure = "Export them in one unit."
            raise FileFormatError(
                "The times of the files have different units:"
                f" {', '.join(sorted(written))}",
                cure,
            )
        together.variables["t"] = first.variables["t"]
        together.units |= {"t": first.units["t"]} if "t" in first.units else {}
    return together
