"""Which column of a file is which channel: by its name, its unit, or as mapped."""

import re
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from ....exceptions import ChannelError, FileFormatError
from ...channels import channel_of
from ...record import MATRICES
from ..table import Table
from ..units import (
    dimension_of,
    kind_of_unit,
    si_factor,
    si_unit,
    split_suffix,
    split_unit,
)
from .expression import Expression, as_name, parse

# Names that begin as a channel: "F2 [kg]", "a1_raw". "F2kg" and "f2" (a frequency) are
# none.
_FORCE_NAME = re.compile(r"(?:F|[Ff]orce)[\s_]*([1-9]\d*)(?![^\W_])")
_MOTION_NAME = re.compile(r"([avx](?:[1-9]\d*|g))(?![^\W_])")
UNNUMBERED = ("a", "v", "x", "F", "f", "")

# The mapping of each channel; None for a force that acts and was not measured.
Assignment = dict[str, Expression | None]


def assign_channels(table: Table, mapping: Mapping[str, str]) -> Assignment:
    """The column of each channel.

    Names of the file count first, then units behind names, then the mapping, which
    replaces either.

    Raises
    ------
    FileFormatError
        If two columns are one channel.
    ChannelError
        If a mapping is not understood, or a column is a force or a motion by its name
        in no known unit: it is neither zero nor left out.
    """
    mapped = {channel_of(str(key)) or str(key): text for key, text in mapping.items()}

    assignment = _by_name(table)
    used = _used_columns(mapped, table)
    _add_by_name_and_unit(assignment, table, mapped, used)
    _refuse_unread_channels(assignment, table, mapped, used)
    for channel, text in mapped.items():
        _map(assignment, channel, text, table)
    return assignment


def _by_name(table: Table) -> Assignment:
    """Columns that carry the name of a channel, columns of matrices, own covariates."""
    covariates = table.attributes.covariates if table.attributes else ()
    n_samples = _number_of_times(table)
    assignment: Assignment = {}
    for name, values in table.variables.items():
        channel = channel_of(name)
        if name in covariates:
            assignment[name] = Expression(name)
        elif name in MATRICES.values() and values.ndim == 2:
            assignment |= _lines_of_matrix(name, values, n_samples)
        elif channel and values.ndim == 1:
            if channel in assignment:
                raise FileFormatError(
                    f"{table.path} has two columns that are channel {channel}",
                    f"Rename one, or map it: {channel}=name.",
                )
            assignment[channel] = Expression(name)
    return assignment


def _number_of_times(table: Table) -> int | None:
    """Length of the time, if the file has one by name."""
    for name, values in table.variables.items():
        bare, unit = _name_and_unit(name)
        if values.ndim == 1 and channel_of(bare if unit else name) == "t":
            return len(values)
    return None


def _lines_of_matrix(
    name: str, values: np.ndarray, n_samples: int | None
) -> dict[str, Expression | None]:
    """The columns of a matrix as channels; its rows, if these are as long as the time.

    Raises
    ------
    ChannelError
        If it has more columns than rows and nothing says that these are samples.
    """
    n_rows, n_columns = values.shape
    is_transposed = n_columns == n_samples != n_rows
    if is_transposed:
        return {f"{name}{k + 1}": Expression(name, row=k) for k in range(n_rows)}
    if n_rows < n_columns and n_rows != n_samples:
        raise ChannelError(
            f"{name!r} has {n_rows} rows and {n_columns} columns, so it seems to be"
            " transposed: rows are samples, columns are channels",
            f"Save it transposed, or map its rows: {name}1 = '{name}[0, :]'.",
        )
    return {f"{name}{k + 1}": Expression(name, column=k) for k in range(n_columns)}


def _used_columns(mapped: Mapping[str, str], table: Table) -> set[str]:
    """Columns that a mapping uses."""
    used: set[str] = set()
    for channel, text in mapped.items():
        with suppress(ChannelError):  # it is refused when it is assigned
            used.update(parse(text, table, channel).columns)
    return used


def _add_by_name_and_unit(
    assignment: Assignment,
    table: Table,
    mapped: Mapping[str, str],
    used: set[str],
) -> None:
    """Add columns whose names are a channel and its unit: ``a1_g``, ``F2 [kN]``."""
    for name, values in table.variables.items():
        bare, unit = _name_and_unit(name)
        channel = channel_of(bare)
        if unit is None or channel is None or name in used or values.ndim != 1:
            continue
        if channel in assignment or channel in mapped:
            continue

        if channel == "t" and (values.dtype.kind in "OmM" or not _is_time(unit)):
            if values.dtype.kind in "OmM":  # "Time (UTC)"
                assignment[channel] = Expression(name)
            continue
        _require_unit(table, name, unit, channel)
        assignment[channel] = Expression(name, unit=unit)


def _is_time(unit: str) -> bool:
    return kind_of_unit(unit) == "t"


def _require_unit(table: Table, name: str, unit: str, channel: str) -> None:
    """Refuse a column that is a channel by its name, in a unit of another kind."""
    try:
        si_factor(unit, channel)
    except ChannelError as error:
        column, si = as_name(name), si_unit(channel)
        raise ChannelError(
            f"{table.path}: the column {name!r} is {channel} by its name. {error.what}",
            f"Say its unit, '{column} @ {si}', a factor, '{column} * number @ {si}', or"
            f" 'none': mapping={{'{channel}': ...}} (--map {channel}=...).",
        ) from error


def _name_and_unit(column: str) -> tuple[str, str | None]:
    """Name of a column without the unit in brackets or at its end, and the unit."""
    name, unit = split_unit(column)
    return (name, unit) if unit else split_suffix(column)


def _refuse_unread_channels(
    assignment: Assignment, table: Table, mapped: Mapping[str, str], used: set[str]
) -> None:
    """Refuse columns that begin as the name of a channel and would be left out."""
    columns = [name for e in assignment.values() if e for name in e.columns]
    lengths = {table.variables[name].shape[:1] for name in columns}
    for name, values in table.variables.items():
        channel = _begins_as(name)
        if channel is None or values.shape not in lengths or name in used:
            continue
        if channel not in assignment and channel not in mapped:
            kind = "force" if channel[0] == "F" else "motion"
            raise ChannelError(
                f"{table.path}: the column {name!r} seems to be the {kind} {channel},"
                " in no unit that is known",
                f"Map it, mapping={{'{channel}': 'name * number @ {si_unit(channel)}'}}"
                " (--map), or say 'none'.",
            )


def _begins_as(name: str) -> str | None:
    """The channel with whose name a column begins."""
    force = _FORCE_NAME.match(name)
    if force:
        return f"F{force[1]}"
    motion = _MOTION_NAME.match(name)
    return motion[1] if motion else None


def _map(assignment: Assignment, channel: str, text: str, table: Table) -> None:
    """Assign one channel as the mapping says."""
    if channel in UNNUMBERED:
        raise ChannelError(
            f"The channel {channel!r} has no number",
            "Write a1, v2, x3, F1, ag, vg, xg, t, or the name of a covariate.",
        )

    word = text.strip().lower() if isinstance(text, str) else ""
    if word == "none":
        assignment.pop(channel, None)
    elif word != "unknown":
        assignment[channel] = parse(text, table, channel)
    elif dimension_of(channel) == "force":
        assignment[channel] = None
    else:
        raise ChannelError(
            f"Channel {channel} cannot be 'unknown'",
            "Only a force can act and not be measured; write 'none' to drop a channel.",
        )
