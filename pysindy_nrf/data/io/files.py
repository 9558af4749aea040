"""Reading of any file: the reader is chosen by the file's type and signature."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...exceptions import FileFormatError
from .arrays import SIGNATURE, read_hdf5, read_mat, read_npz, read_parquet
from .delimited import read_delimited
from .strong_motion import is_strong_motion, read_strong_motion
from .table import MAX_BYTES, Table, check_file
from .uff import read_uff
from .units import factor

READERS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), read_delimited),
    **dict.fromkeys((".parquet", ".pq"), read_parquet),
    ".mat": read_mat,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    **dict.fromkeys((".npz", ".npy"), read_npz),
    **dict.fromkeys((".uff", ".unv"), read_uff),
    **dict.fromkeys((".v2", ".v2c", ".v1", ".v1c", ".v0c"), read_strong_motion),
}
# First bytes of a file, the suffixes that fit them, and their name.
_SIGNATURES = (
    (b"PAR1", (".parquet", ".pq"), "Parquet"),
    (SIGNATURE, (".h5", ".hdf5", ".mat"), "HDF5"),
    (b"MATLAB 5.0", (".mat",), "MATLAB"),
    (b"MATLAB 7.3", (".mat",), "MATLAB v7.3"),
    (b"PK\x03\x04", (".npz",), "a ZIP archive (an Excel sheet or NPZ)"),
    (b"\x93NUMPY", (".npy",), "NumPy"),
)


def read_table(path: Any, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read the variables of a file.

    Parameters
    ----------
    path : path-like or sequence of path-like
        CSV and other delimited text (``.csv .txt .tsv .dat .asc``), Parquet (``.parquet .pq``),
        MATLAB v5 and v7.3 (``.mat``), HDF5 (``.h5 .hdf5``), NumPy (``.npz .npy``), UFF 58 (``.uff .unv``) or
        strong motion (CSMIP and COSMOS, ``.v2 .v2c .v1 .v1c``, or ``.txt`` that starts as one). Several files are
        channels of one test: their variables are called ``<file>.<variable>``.
    max_bytes : int
        Larger files, and archives that unpack to more, are refused.

    Returns
    -------
    Table
        Variables by name, as in the file; units written in a header; notes on the decisions of the reader.

    Raises
    ------
    FileFormatError
        If the file is empty, cut off, of an unknown type, or not what its name says.
    MissingExtraError
        If the type needs an optional package.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.data.io import read_table
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "test 7.csv")
    >>> _ = path.write_text("t [s];x1;F1\\n0,000;0,0;1,5\\n0,001;0,2;1,4\\n")
    >>> table = read_table(path)
    >>> table.units, table.variables["x1"]
    ({'t': 's'}, array([0. , 0.2]))
    >>> folder.cleanup()
    """
    if isinstance(path, (list, tuple)):
        return _together([read_table(one, max_bytes=max_bytes) for one in path])
    path = Path(path)
    check_file(path, max_bytes)
    suffix = path.suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which is not read", f"Supported types are {' '.join(READERS)}."
        )
    with open(path, "rb") as file:
        head = file.read(400)
    for signature, suffixes, kind in _SIGNATURES:
        if head.startswith(signature) and suffix not in suffixes:
            raise FileFormatError(
                f"{path} is called {suffix} but holds {kind}", f"Rename it to {suffixes[0]}, or export it as {suffix}."
            )
    if reader is read_delimited and is_strong_motion(head.decode("latin-1")):
        reader = read_strong_motion
    table = reader(path, max_bytes)
    if not any(values.size > 1 for values in table.variables.values()):
        raise FileFormatError(
            f"{path} holds no channel of numbers", "Give one variable or column for each measured channel."
        )
    return table


def _together(tables: list[Table]) -> Table:
    """One table of the channels of one test in several files."""
    if not tables:
        raise FileFormatError("No file was given", "Name at least one.")
    by_stem = {table.path.stem: table for table in tables}
    if len(by_stem) < len(tables):
        twice = next(table.path.stem for table in tables if by_stem[table.path.stem] is not table)
        raise FileFormatError(f"Two files are called {twice!r}", "Rename one: variables are named after their file.")
    rates = {table.path.name: table.fs for table in tables if table.fs is not None}
    if len(set(rates.values())) > 1:
        shown = ", ".join(f"{name} {fs:g} Hz" for name, fs in rates.items())
        raise FileFormatError(f"The files are sampled differently: {shown}", "Resample them to one clock.")
    first = tables[0]
    together = Table(first.path, "", {}, fs=next(iter(rates.values()), None))
    together.kind = f"{', '.join(dict.fromkeys(table.kind for table in tables))} ({len(tables)} files)"
    together.decimal = "," if any(table.decimal == "," for table in tables) else "."
    for stem, table in by_stem.items():
        together.variables |= {f"{stem}.{name}": values for name, values in table.variables.items()}
        together.units |= {f"{stem}.{name}": unit for name, unit in table.units.items()}
        together.notes += [f"{stem}: {note}" for note in table.notes]
    if all("t" in table.variables for table in tables):
        for stem, table in by_stem.items():
            if not np.array_equal(table.variables["t"], first.variables["t"]):
                raise FileFormatError(
                    f"The times of the files {first.path.stem!r} and {stem!r} differ", "Resample them to one clock."
                )
        written = {table.units.get("t", "s") for table in tables}
        if len({factor(unit, "t") for unit in written}) > 1:
            raise FileFormatError(
                f"The times of the files have different units: {', '.join(sorted(written))}", "Export them in one unit."
            )
        together.variables["t"] = first.variables["t"]
        together.units |= {"t": first.units["t"]} if "t" in first.units else {}
    return together
