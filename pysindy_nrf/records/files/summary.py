"""Summaries of records and files, in words and as plain data."""

from typing import Any

import numpy as np

from ..channels import finite_span
from ..record import BASES, Record
from .reading import Reading
from .table import Table, short
from .units import si_unit

_KINDS = {
    "a": "absolute acceleration",
    "v": "velocity",
    "x": "displacement",
    "F": "force",
}


def describe(what: Record | Reading) -> str:
    """Describe a record in words: clock, channels, units, sizes, and which DOFs are
    forced.

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
    reading = what if isinstance(what, Reading) else None
    record = what.record if isinstance(what, Reading) else what
    assumed = (
        set()
        if reading is None
        else {f"F{j}" for j in range(1, record.n_dof + 1)} - set(reading.sources)
    )
    columns = record.channels()
    shown = [name for name in columns if name not in assumed]
    width = max(map(len, shown))
    where = f" from {reading.table.path}" if reading else ""
    dofs = f"{record.n_dof} DOF{'s' if record.n_dof > 1 else ''}"
    lasts = record.n_samples / record.fs
    lines = [
        f"{record.name}{where}: {dofs}, {record.n_samples} samples at {record.fs:g} Hz,"
        f" {lasts:.4g} s"
    ]
    if reading:
        lines.append(
            f"  read as {'; '.join([reading.table.kind, *reading.table.notes])}"
        )
        lines.append(f"  clock: {reading.clock}")
    for name in shown:
        source = _origin(reading, name) if reading else ""
        lines.append(
            f"  {name:{width}s}  {kind_of(record, name):33s}"
            f" {_size(record, name, columns[name])}{source}"
        )
    lines.append(f"  {_forces(record)}")
    valid = finite_span(list(columns.values()), list(columns), record.name)
    lost = record.n_samples - (valid.stop - valid.start)
    if lost:
        lines.append(
            f"  {lost} rows at the edges are empty in some channel and not used"
        )
    if reading and reading.unused:
        lines.append(
            "  not used:"
            f" {', '.join(reading.unused[:12])}{' and more' if len(reading.unused) > 12 else ''}"
        )
    return "\n".join(lines)


def contents(table: Table, most: int = 40) -> str:
    """List of the variables of a file, for a user who has to map them."""
    width = min(max((len(name) for name in table.variables), default=0), 40)
    lines = [f"{table.path} holds ({'; '.join([table.kind, *table.notes])}):"]
    for name, values in list(table.variables.items())[:most]:
        unit = f" {table.units[name]}" if name in table.units else ""
        lines.append(f"  {short(name):{width}s}  {_extent(values)}{unit}")
    rest = len(table.variables) - most
    return "\n".join([*lines, *([f"  and {rest} more"] if rest > 0 else [])])


def _extent(values: np.ndarray) -> str:
    if values.ndim == 0:
        return f"{values[()]:.6g}" if values.dtype.kind in "iuf" else str(values[()])
    shape = (
        f"{len(values)} values"
        if values.ndim == 1
        else " x ".join(map(str, values.shape))
    )
    if values.dtype.kind not in "iuf" or not np.isfinite(values).any():
        return f"{shape}, no numbers" if values.dtype.kind in "OUS" else shape
    return f"{shape}, {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"


def summary(record: Record) -> dict[str, Any]:
    """Summary of a record as plain data, for JSON."""
    return {
        "name": record.name,
        "n_dof": record.n_dof,
        "n_samples": record.n_samples,
        "fs": record.fs,
        "duration": record.n_samples / record.fs,
        "coordinates": record.coordinates,
        "forced": list(record.forced),
        "force_unknown": list(record.unknown),
        "base_moves": record.base_moves,
        "channels": {
            name: {
                "unit": si_unit(name),
                "rms": _rms(line),
                "peak": float(np.nanmax(np.abs(line))),
            }
            for name, line in record.channels().items()
        },
    }


def kind_of(record: Record, name: str) -> str:
    """Quantity of a channel, in words."""
    bases = {short: key.replace("_", " ") for key, short in BASES.items()}
    if name in bases:
        return bases[name]
    if name[:1] not in _KINDS or not name[1:].isdigit():
        return "covariate"
    reference = (
        " relative to base" if record.coordinates == "relative" else ", absolute"
    )
    return _KINDS[name[0]] + (reference if name[0] in "vx" else "")


def _rms(line: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(line.astype(float) ** 2)))


def _size(record: Record, name: str, line: np.ndarray) -> str:
    peak = np.nanmax(np.abs(line))
    if peak == 0:
        return "zero throughout"
    unit = "" if name in record.covariates else f" {si_unit(name)}"
    return f"rms {_rms(line):.4g}{unit}, peak {peak:.4g}{unit}"


def _origin(reading: Reading, name: str) -> str:
    if name not in reading.sources:
        return ""
    source = reading.sources[name]
    unit = f"in {source.unit}" if source.unit not in ("", si_unit(name)) else ""
    came = " ".join(filter(None, [source.text if source.text != name else "", unit]))
    return f"   <- {came}" if came else ""


def _dofs(numbers: Any) -> str:
    return f"DOF{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def _forces(record: Record) -> str:
    forced, unknown = record.forced, record.unknown
    idle = sorted(set(range(1, record.n_dof + 1)) - {*forced, *unknown})
    parts = [f"forced: {_dofs(forced)}" if forced else "no force is measured"]
    if idle:
        parts.append(f"known to be unforced: {_dofs(idle)}")
    if unknown:
        parts.append(f"force unknown: {_dofs(unknown)}")
    parts.append("the base moves" if record.base_moves else "the base is at rest")
    return "; ".join(parts)
