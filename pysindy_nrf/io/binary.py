"""NPZ, MATLAB, HDF5 and Parquet files. Nothing that can run code on loading is ever loaded."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ..exceptions import FileFormatError
from .table import MAX_BYTES, Table, check_file, check_size, unreadable

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a NumPy archive; pickled objects are refused."""
    check_file(path, max_bytes)
    try:
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                check_size(path, sum(item.file_size for item in archive.infolist()), max_bytes)
        with open(path, "rb") as stream:
            loaded = np.load(stream, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                variables = {path.stem: loaded}
            else:
                variables = {name: loaded[name] for name in loaded.files}
    except FileFormatError:
        raise
    except ValueError as error:
        if "pickle" in str(error).lower():
            raise FileFormatError(
                f"{path} holds pickled Python objects, which could run code and are never loaded",
                "Save plain arrays: numpy.savez(path, a1=..., x1=...).",
            ) from error
        raise unreadable(path, "NumPy", error) from error
    except (OSError, EOFError, zipfile.BadZipFile, KeyError, NotImplementedError) as error:
        raise unreadable(path, "NumPy", error) from error
    return Table(path, "NumPy", _flattened(variables))


def read_mat(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a MATLAB file: v5 by SciPy, v7.3 (HDF5) by h5py."""
    check_file(path, max_bytes)
    with open(path, "rb") as file:
        head = file.read(520)
    if head[:8] == HDF5_SIGNATURE or head[512:520] == HDF5_SIGNATURE or b"MATLAB 7.3" in head:
        return read_hdf5(path, max_bytes, matlab=True)
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:  # a damaged stream raises zlib, struct, MatRead and many other errors
        raise unreadable(path, "MATLAB", error) from error
    content = {name: value for name, value in content.items() if not name.startswith("__")}
    return Table(path, "MATLAB", _flattened(content))


def read_hdf5(path: Path, max_bytes: int = MAX_BYTES, matlab: bool = False) -> Table:
    """Read the numeric data sets of an HDF5 file, groups joined by points; MATLAB's are transposed."""
    check_file(path, max_bytes)
    h5py = require("h5py", "files", "Reading HDF5 and MATLAB v7.3 files")
    variables: dict[str, np.ndarray] = {}
    total = 0
    try:
        with h5py.File(path, "r") as file:
            sets: list[tuple[str, Any]] = []
            file.visititems(lambda name, item: sets.append((name, item)) if isinstance(item, h5py.Dataset) else None)
            for name, item in sets:
                if name.startswith("#") or item.dtype.kind not in "biufc" or "MATLAB_empty" in item.attrs:
                    continue
                if matlab and item.attrs.get("MATLAB_class") in (b"char", "char"):
                    continue
                total += item.size * item.dtype.itemsize
                check_size(path, total, max_bytes)
                variables[name.replace("/", ".")] = np.asarray(item[()]).T if matlab else np.asarray(item[()])
    except FileFormatError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise unreadable(path, "MATLAB v7.3" if matlab else "HDF5", error) from error
    return Table(path, "MATLAB v7.3" if matlab else "HDF5", _flattened(variables))


def read_parquet(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a Parquet file; a time index becomes the column ``t``."""
    import pandas as pd

    check_file(path, max_bytes)
    pyarrow = require("pyarrow", "files", "Reading Parquet files")
    try:
        frame = pd.read_parquet(path, engine="pyarrow")
    except (pyarrow.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, "Parquet", error) from error
    twice = sorted({str(c) for c in frame.columns if list(map(str, frame.columns)).count(str(c)) > 1})
    if twice:
        raise FileFormatError(f"{path} has two columns named {twice[0]!r}", "Rename one.")
    variables = {}
    if frame.index.name in ("t", "time") or isinstance(frame.index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        variables["t"] = frame.index.to_numpy()
    for name in frame.columns:
        column = frame[name]
        if hasattr(column.dtype, "numpy_dtype") and column.dtype.kind in "biuf":
            column = column.astype(float)  # nullable numbers
        variables[str(name)] = column.to_numpy()
    return Table(path, "Parquet", variables)


def _flattened(content: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    """Numeric arrays by name; fields of structures as ``struct.field``; single columns one-dimensional."""
    out: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            out |= _flattened(value, f"{prefix}{name}.")
            continue
        array = np.asarray(value)
        if array.dtype.names:
            out |= _flattened({field: array[field] for field in array.dtype.names}, f"{prefix}{name}.")
            continue
        if array.dtype.kind not in "biufcmM":
            continue
        if array.ndim == 2 and 1 in array.shape:
            array = array.ravel() if array.size > 1 else array.reshape(())
        out[f"{prefix}{name}"] = array
    return out
