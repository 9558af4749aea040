"""Which column of a file is which channel: by its name, its unit, or as mapped."""

import re
from collections.abc import Mapping

from ....exceptions import ChannelError, FileFormatError
from ...channels import channel_of
from ...record import MATRICES
from ..table import Table
from ..units import dimension_of, kind_of_unit, si_factor, split_suffix, split_unit
from .expression import Expression, parse

# "F2kg" and "f2" (a frequency) are no forces.
_FORCE_NAME = re.compile(r"(?:F|[Ff]orce)[\s_]*([1-9]\d*)(?![^\W_])")
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
        If a mapping is not understood, or a column seems to be a force in no known
        unit: a force that acts is never "known to be unforced".
    """
    mapped = {channel_of(str(key)) or str(key): text for key, text in mapping.items()}

    assignment = _by_name(table)
    _add_by_name_and_unit(assignment, table, mapped)
    _refuse_unread_forces(assignment, table, mapped)
    for channel, text in mapped.items():
        _map(assignment, channel, text, table)
    return assignment


def _by_name(table: Table) -> Assignment:
    """Columns that carry the name of a channel, columns of matrices, own covariates."""
    covariates = table.attributes.covariates if table.attributes else ()
    assignment: Assignment = {}
    for name, values in table.variables.items():
        channel = channel_of(name)
        if name in covariates:
            assignment[name] = Expression(name)
        elif name in MATRICES.values() and values.ndim == 2:
            for k in range(values.shape[1]):
                assignment[f"{name}{k + 1}"] = Expression(name, column=k)
        elif channel and values.ndim == 1:
            if channel in assignment:
                raise FileFormatError(
                    f"{table.path} has two columns that are channel {channel}",
                    f"Rename one, or map it: {channel}=name.",
                )
            assignment[channel] = Expression(name)
    return assignment


def _add_by_name_and_unit(
    assignment: Assignment, table: Table, mapped: Mapping[str, str]
) -> None:
    """Add columns whose names are a channel and its unit: ``a1_g``, ``F2 [kN]``."""
    for name, values in table.variables.items():
        bare, unit = _name_and_unit(name)
        channel = channel_of(bare)
        if unit is None or channel is None or _is_used(name, mapped):
            continue
        if channel in assignment or channel in mapped:
            continue

        if values.ndim == 1 and kind_of_unit(unit) == channel[0]:
            assignment[channel] = Expression(name, unit=unit)
        elif dimension_of(channel) == "force":
            si_factor(unit, channel)  # an error that names the unit
            assignment[channel] = Expression(name, unit=unit)


def _name_and_unit(column: str) -> tuple[str, str | None]:
    """Name of a column without the unit in brackets or at its end, and the unit."""
    name, unit = split_unit(column)
    return (name, unit) if unit else split_suffix(column)


def _is_used(name: str, mapped: Mapping[str, str]) -> bool:
    """Whether a mapping uses a column."""
    return any(name in str(text) for text in mapped.values())


def _refuse_unread_forces(
    assignment: Assignment, table: Table, mapped: Mapping[str, str]
) -> None:
    """Refuse columns that seem to be forces and would be left out."""
    columns = [expression.name for expression in assignment.values() if expression]
    lengths = {table.variables[name].shape[:1] for name in columns}
    for name, values in table.variables.items():
        match = _FORCE_NAME.match(name)
        if match is None or values.shape not in lengths or _is_used(name, mapped):
            continue
        channel = f"F{match[1]}"
        if channel not in assignment and channel not in mapped:
            raise ChannelError(
                f"{table.path}: the column {name!r} seems to be the force {channel}, in"
                " no unit that is known",
                f"Map it, mapping={{'{channel}': 'name * number @ N'}} (--map), or say"
                " 'none'.",
            )


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
