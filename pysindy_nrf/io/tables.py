"""The one door for files: which reader a file needs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..exceptions import FileFormatError
from .binary import HDF5_SIGNATURE, read_hdf5, read_mat, read_npz, read_parquet
from .delimited import read_delimited
from .table import MAX_BYTES, Table, check_file

READERS = {
    ".csv": read_delimited,
    ".txt": read_delimited,
    ".tsv": read_delimited,
    ".dat": read_delimited,
    ".asc": read_delimited,
    ".parquet": read_parquet,
    ".pq": read_parquet,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".npz": read_npz,
    ".npy": read_npz,
}
# What a file starts with, whatever it is called.
_SIGNATURES = (
    (b"PAR1", (".parquet", ".pq"), "Parquet"),
    (HDF5_SIGNATURE, (".h5", ".hdf5", ".mat"), "HDF5"),
    (b"MATLAB 5.0", (".mat",), "MATLAB"),
    (b"MATLAB 7.3", (".mat",), "MATLAB v7.3"),
    (b"PK\x03\x04", (".npz",), "a ZIP archive (an Excel sheet or NPZ)"),
    (b"\x93NUMPY", (".npy",), "NumPy"),
)


def read_table(path: Any, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read the variables of a file.

    Parameters
    ----------
    path : path-like
        CSV and other delimited text (``.csv .txt .tsv .dat .asc``), Parquet (``.parquet .pq``),
        MATLAB v5 and v7.3 (``.mat``), HDF5 (``.h5 .hdf5``) or NumPy (``.npz .npy``).
    max_bytes : int
        Larger files, and archives that unpack to more, are refused.

    Returns
    -------
    Table
        Variables by name, as in the file; units written in a header; notes on what was decided.

    Raises
    ------
    FileFormatError
        If the file is empty, cut off, of an unknown type, or not what its name says.
    MissingExtraError
        If the type needs an optional package.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pysindy_nrf.io import read_table
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "test 7.csv")
    >>> _ = path.write_text("t [s];x1 [mm];F1 [kN]\\n0,000;0,0;1,5\\n0,001;0,2;1,4\\n")
    >>> table = read_table(path)
    >>> table.units, table.variables["x1"]
    ({'t': 's', 'x1': 'mm', 'F1': 'kN'}, array([0. , 0.2]))
    >>> folder.cleanup()
    """
    path = Path(path)
    check_file(path, max_bytes)
    suffix = path.suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which is not read", f"Read are {' '.join(READERS)}."
        )
    with open(path, "rb") as file:
        head = file.read(10)
    for signature, suffixes, kind in _SIGNATURES:
        if head.startswith(signature) and suffix not in suffixes:
            raise FileFormatError(
                f"{path} is called {suffix} but holds {kind}", f"Rename it to {suffixes[0]}, or export it as {suffix}."
            )
    table = reader(path, max_bytes)
    if not any(values.size > 1 for values in table.variables.values()):
        raise FileFormatError(
            f"{path} holds no channel of numbers", "Give one variable or column for each measured channel."
        )
    return table
