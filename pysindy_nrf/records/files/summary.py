"""Summaries of records and files: in words, as HTML and as plain data."""

from collections.abc import Sequence
from html import escape

import numpy as np
import pandas as pd

from ..channels import finite_span
from ..quality import messages
from ..record import BASES, Record
from .file_clock import Source
from .reading import Reading
from .table import Table, short
from .units import SI_OF_ROTATION, si_unit

_KINDS = {
    "a": "absolute acceleration",
    "v": "velocity",
    "x": "displacement",
    "F": "force",
}
_KINDS_OF_ROTATION = {
    "a": "absolute angular acceleration",
    "v": "angular velocity",
    "x": "angle",
    "F": "torque",
}
MAX_VARIABLES_SHOWN = 40
MAX_UNUSED_SHOWN = 12
MAX_NAME_WIDTH = 40  # characters


def describe(what: Record | Reading) -> str:
    """Describe a record in words: clock, channels, units, sizes, and forced DOFs.

    Parameters
    ----------
    what : Record or Reading
        For a Reading (see :func:`inspect_record`) the origin of each channel is added.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record, io
    >>> t = np.arange(1000) / 200
    >>> x = np.column_stack([np.sin(9 * t), 2 * np.sin(9 * t)])
    >>> force = np.column_stack([np.cos(9 * t), 0 * t])
    >>> print(
    ...     io.describe(
    ...         Record(
    ...             displacement=x, force=force, fs=200.0, name="shaker on 1"
    ...         )
    ...     )
    ... )
    shaker on 1: 2 DOFs, 1000 samples at 200 Hz, 5 s
      F1  force                             rms 0.7109 N, peak 1 N
      F2  force                             zero throughout
      x1  displacement relative to base     rms 0.7033 m, peak 1 m
      x2  displacement relative to base     rms 1.407 m, peak 2 m
      forced: DOF 1; known to be unforced: DOF 2; the base is at rest
    """
    if isinstance(what, Reading):
        return _describe_reading(what)
    lines = [_title(what, what.name)]
    lines += _channel_lines(what, what.channels(), sources={})
    lines += _lines_on_use(what)
    return "\n".join(lines)


def _describe_reading(reading: Reading) -> str:
    record, table = reading.record, reading.table
    lines = [
        _title(record, f"{record.name} from {table.path}"),
        f"  read as {table.in_words}",
        f"  clock: {reading.clock}",
    ]
    lines += [f"    {sentence}" for sentence in messages(record.quality)]

    # a force that is not in the file is not shown: it is known to be zero
    assumed = {f"F{j}" for j in range(1, record.n_dof + 1)} - set(reading.sources)
    channels = {c: line for c, line in record.channels().items() if c not in assumed}
    lines += _channel_lines(record, channels, reading.sources)
    lines += _lines_on_use(record, reading.sources)

    if reading.unused:
        shown = ", ".join(reading.unused[:MAX_UNUSED_SHOWN])
        more = " and more" if len(reading.unused) > MAX_UNUSED_SHOWN else ""
        lines.append(f"  not used: {shown}{more}")
    return "\n".join(lines)


def _title(record: Record, name: str) -> str:
    dofs = _plural("DOF", record.n_dof)
    return (
        f"{name}: {record.n_dof} {dofs}, {record.n_samples} samples at {record.fs:g}"
        f" Hz, {record.n_samples / record.fs:.4g} s"
    )


def _channel_lines(
    record: Record, channels: dict[str, np.ndarray], sources: dict[str, Source]
) -> list[str]:
    """A line for each channel: name, quantity, size and origin."""
    width = max(map(len, channels))
    lines = []
    for name, line in channels.items():
        origin = _origin(record, name, sources[name]) if name in sources else ""
        quantity = kind_of(record, name)
        size = _size(record, name, line)
        lines.append(f"  {name:{width}s}  {quantity:33s} {size}{origin}")
    return lines


def _lines_on_use(
    record: Record, sources: dict[str, Source] | None = None
) -> list[str]:
    """Which DOFs are forced, and which rows are not used."""
    lines = [f"  {_forces(record, sources)}"]
    columns = record.channels()
    valid = finite_span(list(columns.values()), list(columns), record.name)
    n_lost = record.n_samples - (valid.stop - valid.start)
    if n_lost:
        lines.append(
            f"  {n_lost} rows at the edges are empty in some channel and not used"
        )
    return lines


def contents(table: Table) -> str:
    """List of the variables of a file, for a user who has to map them."""
    longest = max((len(name) for name in table.variables), default=0)
    width = min(longest, MAX_NAME_WIDTH)
    lines = [f"{table.path} holds ({table.in_words}):"]
    for name, values in list(table.variables.items())[:MAX_VARIABLES_SHOWN]:
        line = f"  {short(name):{width}s}  {_extent(values)}"
        if name in table.units:
            line += f" {table.units[name]}"
        lines.append(line)

    n_hidden = len(table.variables) - MAX_VARIABLES_SHOWN
    if n_hidden > 0:
        lines.append(f"  and {n_hidden} more")
    return "\n".join(lines)


def _extent(values: np.ndarray) -> str:
    """Shape and range of a variable."""
    is_real = values.dtype.kind in "iuf"
    if values.ndim == 0:
        return f"{values[()]:.6g}" if is_real else str(values[()])

    shape = " x ".join(map(str, values.shape))
    if values.ndim == 1:
        shape = f"{len(values)} values"
    if values.dtype.kind in "OUS":
        return f"{shape}, no numbers"
    if not is_real or not np.isfinite(values).any():
        return shape
    return f"{shape}, {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"


def summary(record: Record) -> dict[str, object]:
    """Summary of a record as plain data, for JSON."""
    channels = {
        name: {"unit": unit_of(record, name), "rms": _rms(line), "peak": _peak(line)}
        for name, line in record.channels().items()
    }
    return {
        "name": record.name,
        "n_dof": record.n_dof,
        "n_samples": record.n_samples,
        "fs": record.fs,
        "duration": record.n_samples / record.fs,
        "coordinates": record.coordinates,
        "hold": record.hold,
        "forced": list(record.forced),
        "force_unknown": list(record.unknown),
        "base_moves": record.base_moves,
        "channels": channels,
    }


def record_html(record: Record) -> str:
    """A record as a small table for notebooks; every name is escaped."""
    body = channel_table(record).to_html(
        index=False, border=0, float_format="{:.4g}".format
    )
    title = escape(f"Record: {_title(record, record.name)}")
    forces = escape(_forces(record))
    return f"<div><p><b>{title}</b></p><p>{forces}</p>{body}</div>"


def channel_table(record: Record) -> pd.DataFrame:
    """Quantity, unit, root mean square and peak of every channel."""
    rows = [
        [name, kind_of(record, name), unit_of(record, name), _rms(line), _peak(line)]
        for name, line in record.channels().items()
    ]
    return pd.DataFrame(rows, columns=["channel", "what", "unit", "rms", "peak"])


def kind_of(record: Record, name: str) -> str:
    """Quantity of a channel, in words."""
    for key, channel in BASES.items():
        if channel == name:
            return key.replace("_", " ")
    if name[:1] not in _KINDS or not name[1:].isdigit():
        return "covariate"

    kind = (_KINDS_OF_ROTATION if record.rotates else _KINDS)[name[0]]
    if name[0] not in "vx":
        return kind
    is_relative = record.coordinates == "relative"
    return f"{kind} relative to base" if is_relative else f"{kind}, absolute"


def unit_of(record: Record, name: str) -> str:
    """SI unit of a channel of a record, whose motion may be a rotation."""
    unit = si_unit(name)
    return SI_OF_ROTATION[name[0]] if unit and record.rotates else unit


def _rms(line: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(line.astype(float) ** 2)))


def _peak(line: np.ndarray) -> float:
    return float(np.nanmax(np.abs(line)))


def _size(record: Record, name: str, line: np.ndarray) -> str:
    """Root mean square and peak of a channel with their unit."""
    peak = _peak(line)
    if peak == 0:
        return "zero throughout"
    unit = "" if name in record.covariates else f" {unit_of(record, name)}"
    return f"rms {_rms(line):.4g}{unit}, peak {peak:.4g}{unit}"


def _origin(record: Record, name: str, source: Source) -> str:
    """Column and unit that a channel came from, where they are not its own."""
    parts = []
    if source.text != name:
        parts.append(source.text)
    if source.unit not in ("", si_unit(name), unit_of(record, name)):
        parts.append(f"in {source.unit}")
    return f"   <- {' '.join(parts)}" if parts else ""


def _forces(record: Record, sources: dict[str, Source] | None = None) -> str:
    """Which DOFs are forced, unforced and unknown, and whether the base moves.

    With the sources of a file: what it does not hold is said to be taken as zero.
    """
    forced, unknown = record.forced, record.unknown
    others = set(range(1, record.n_dof + 1)).difference(forced, unknown)
    without_column: set[int] = set()
    if sources is not None:
        without_column = {j for j in others if f"F{j}" not in sources}

    parts = ["no force is measured"]
    if forced:
        parts = [f"forced: {_dofs(forced)}"]
    if others - without_column:
        parts.append(f"known to be unforced: {_dofs(sorted(others - without_column))}")
    if without_column:
        dofs = _dofs(sorted(without_column))
        parts.append(f"no column is a force on {dofs}, taken as unforced")
    if unknown:
        parts.append(f"force unknown: {_dofs(unknown)}")
    parts.append(_motion_of_base(record, sources))
    return "; ".join(parts)


def _motion_of_base(record: Record, sources: dict[str, Source] | None) -> str:
    if record.base_moves:
        return "the base moves"
    if sources is None or any(channel in sources for channel in BASES.values()):
        return "the base is at rest"
    return "no column is a motion of the base, taken at rest"


def _dofs(numbers: Sequence[int]) -> str:
    return f"{_plural('DOF', len(numbers))} {', '.join(map(str, numbers))}"


def _plural(noun: str, number: int) -> str:
    return f"{noun}s" if number > 1 else noun
