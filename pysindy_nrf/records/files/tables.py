"""Variables of one file, or of the files of one test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from ...exceptions import FileFormatError
from .formats import format_of
from .table import MAX_BYTES, Table, check_file
from .units import si_factor

AnyPath = str | PathLike[str]


def read_table(
    path: AnyPath | Sequence[AnyPath], *, max_bytes: int = MAX_BYTES
) -> Table:
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
    if not isinstance(path, (str, PathLike)):
        return _join([read_table(file, max_bytes=max_bytes) for file in path])

    file = Path(path)
    check_file(file, max_bytes)
    table = format_of(file).read(file, max_bytes)
    if all(values.size <= 1 for values in table.variables.values()):
        raise FileFormatError(
            f"{file} holds no channel of numbers",
            "Give one variable or column for each measured channel.",
        )
    return table


def _join(tables: Sequence[Table]) -> Table:
    """One table of the channels of one test in several files."""
    _require_different_files(tables)
    first = tables[0]
    fs = _common_rate(tables)

    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    notes: list[str] = []
    for table in tables:
        stem = table.path.stem
        variables |= {f"{stem}.{name}": line for name, line in table.variables.items()}
        units |= {f"{stem}.{name}": unit for name, unit in table.units.items()}
        notes += [f"{stem}: {note}" for note in table.notes]

    if all("t" in table.variables for table in tables):
        _require_one_time(tables)
        variables["t"] = first.variables["t"]
        if "t" in first.units:
            units["t"] = first.units["t"]

    kinds = ", ".join(dict.fromkeys(table.kind for table in tables))
    return Table(
        first.path,
        f"{kinds} ({len(tables)} files)",
        variables,
        units,
        tuple(notes),
        fs=fs,
        decimal=_decimal_mark(tables),
    )


def _decimal_mark(tables: Sequence[Table]) -> str:
    """A comma if it marks decimals in one of the files."""
    return "," if any(table.decimal == "," for table in tables) else "."


def _require_different_files(tables: Sequence[Table]) -> None:
    """Refuse no file, and two of one name, since variables are called after it."""
    if not tables:
        raise FileFormatError("No file was given", "Name at least one.")
    for stem, count in Counter(table.path.stem for table in tables).items():
        if count > 1:
            raise FileFormatError(
                f"Two files are called {stem!r}",
                "Rename one: variables are named after their file.",
            )


def _common_rate(tables: Sequence[Table]) -> float | None:
    """The sampling rate, Hz, that the files state; None if none does."""
    rates = {table.path.name: table.fs for table in tables if table.fs is not None}
    if len(set(rates.values())) > 1:
        shown = ", ".join(f"{name} {fs:g} Hz" for name, fs in rates.items())
        raise FileFormatError(
            f"The files are sampled differently: {shown}", "Resample them to one clock."
        )
    return next(iter(rates.values()), None)


def _require_one_time(tables: Sequence[Table]) -> None:
    """Refuse files whose times differ, or have different units."""
    first = tables[0]
    for table in tables[1:]:
        if not np.array_equal(table.variables["t"], first.variables["t"]):
            raise FileFormatError(
                f"The times of the files {first.path.stem!r} and {table.path.stem!r}"
                " differ",
                "Resample them to one clock.",
            )

    units = {table.units.get("t", "s") for table in tables}
    if len({si_factor(unit, "t") for unit in units}) > 1:
        raise FileFormatError(
            f"The times of the files have different units: {', '.join(sorted(units))}",
            "Export them in one unit.",
        )
