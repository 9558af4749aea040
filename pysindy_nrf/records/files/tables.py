"""Variables of one file, or of the files of one test."""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...common.files import atomic_write
from ...exceptions import FileFormatError
from ..clock import rate_of
from .formats import format_of
from .table import MAX_BYTES, Clock, Table, check_file, check_size, reading_as

AnyPath = str | PathLike[str]


def read_table(
    path: AnyPath | Sequence[AnyPath], *, max_bytes: int = MAX_BYTES
) -> Table:
    """Read the variables of a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        Each may be compressed (``.csv.gz``, ``.bz2``, ``.xz``).

        - CSV and other delimited text (``.csv .txt .tsv .dat .asc .out .prn``).
        - Parquet (``.parquet .pq``), Excel (``.xlsx``), HDF5 (``.h5 .hdf5``).
        - MATLAB v5 and v7.3 (``.mat``), NumPy (``.npz .npy``).
        - TDMS (``.tdms``), LabVIEW measurement (``.lvm``), UFF 58 (``.uff .unv``).
        - Strong motion: CSMIP and COSMOS (``.v2 .v2c .v1 .v1c``), PEER (``.at2 .vt2
          .dt2``), K-NET and KiK-net (``.ew .ns .ud``, ``.ew1``), SMC (``.smc``).

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
    with unpacked(file, max_bytes) as plain:
        table = _with_stated_rate(format_of(plain).read(plain, max_bytes))
    if plain != file:
        table = replace(table, path=file.with_suffix(""))
    if all(values.size <= 1 for values in table.variables.values()):
        raise FileFormatError(
            f"{file} holds no channel of numbers",
            "Give one variable or column for each measured channel.",
        )
    return table


_OPENERS: dict[str, Any] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}
PIECE_BYTES = 1 << 20  # that are unpacked at once


@contextmanager
def unpacked(path: Path, max_bytes: int) -> Iterator[Path]:
    """The path itself, or a temporary copy of a compressed file (``.csv.gz``)."""
    opener = _OPENERS.get(path.suffix.lower())
    if opener is None:
        yield path
        return

    with TemporaryDirectory() as folder:
        plain = Path(folder, path.stem)
        size = 0
        with reading_as(path, "a compressed file"):
            with opener(path, "rb") as packed, atomic_write(plain, "wb") as file:
                while piece := packed.read(PIECE_BYTES):
                    size += len(piece)
                    check_size(path, size, max_bytes)
                    file.write(piece)
        yield plain


def _join(tables: Sequence[Table]) -> Table:
    """One table of the channels of one test in several files."""
    names = _names_of_files(tables)
    variables: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, Clock] = {}
    notes: list[str] = []
    for stem, table in zip(names, tables):
        variables |= {f"{stem}.{name}": line for name, line in table.variables.items()}
        units |= {f"{stem}.{name}": unit for name, unit in table.units.items()}
        clocks |= {f"{stem}.{name}": clock for name, clock in _stated_clocks(table)}
        notes += [f"{stem}: {note}" for note in table.notes]

    kinds = ", ".join(dict.fromkeys(table.kind for table in tables))
    return Table(
        tables[0].path,
        f"{kinds} ({len(tables)} files)",
        variables,
        units,
        tuple(notes),
        fs=_common_rate(tables),
        decimal=_decimal_mark(tables),
        clocks=clocks,
        files=tuple(names),
    )


def _stated_clocks(table: Table) -> Iterator[tuple[str, Clock]]:
    """Variables of a file with the clocks that it states."""
    for name, values in table.variables.items():
        clock = table.clocks.get(name)
        if clock is not None:
            yield name, clock
        elif table.fs is not None and values.ndim:
            yield name, Clock(table.fs)


def _decimal_mark(tables: Sequence[Table]) -> str:
    """A comma if it marks decimals in one of the files."""
    return "," if any(table.decimal == "," for table in tables) else "."


def _names_of_files(tables: Sequence[Table]) -> list[str]:
    """Names of files without their ends; with them where they differ in the end alone.

    Raises
    ------
    FileFormatError
        If there is no file, or two have one name.
    """
    if not tables:
        raise FileFormatError("No file was given", "Name at least one.")
    stems = [table.path.stem for table in tables]
    names = [
        table.path.name.replace(".", "_") if stems.count(stem) > 1 else stem
        for stem, table in zip(stems, tables)
    ]
    for name, count in Counter(names).items():
        if count > 1:
            raise FileFormatError(
                f"Two files are called {stems[names.index(name)]!r}",
                "Rename one: variables are named after their file.",
            )
    return names


def _common_rate(tables: Sequence[Table]) -> float | None:
    """The sampling rate, Hz, that all files state; None if there is not one."""
    rates = {table.fs for table in tables}
    return rates.pop() if len(rates) == 1 else None


# Names by which a number beside arrays is their sampling rate, Hz, or step, s.
_RATE_NAMES = ("fs", "samplerate", "samplingrate", "samplingfrequency", "samplefreq")
_STEP_NAMES = ("dt", "deltat", "ts", "timestep", "samplinginterval")


def _with_stated_rate(table: Table) -> Table:
    """The table with the sampling rate that a number of the file states."""
    if table.fs is not None or table.clocks or table.attributes is not None:
        return table

    rates = {}
    for name, values in table.variables.items():
        plain = name.rpartition(".")[2].lower().replace("_", "")
        if values.size != 1 or values.dtype.kind not in "iuf":
            continue
        number = float(values.reshape(()))
        if plain in _STEP_NAMES and number > 0:
            rates[name] = rate_of(number)
        elif plain in _RATE_NAMES and number > 0:
            rates[name] = number

    if len(set(rates.values())) != 1:
        return table
    name, rate = next(iter(rates.items()))
    note = f"the number {name!r} is its sampling rate, {rate:g} Hz"
    return replace(table, fs=rate, notes=(*table.notes, note))
