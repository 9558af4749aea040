"""HDF5 files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...common.extras import require
from ...exceptions import FileFormatError
from .flatten import flattened
from .table import MAX_BYTES, Table, check_file, check_size, unreadable

SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_hdf5(path: Path, max_bytes: int = MAX_BYTES, matlab: bool = False) -> Table:
    """Read the numeric data sets of an HDF5 file, groups joined by points."""
    check_file(path, max_bytes)
    h5py = require("h5py", "files", "Reading HDF5 and MATLAB v7.3 files")
    variables: dict[str, np.ndarray] = {}
    total = 0
    try:
        with h5py.File(path, "r") as file:
            for name, item in data_sets(h5py, file):
                if name.startswith("#") or item.dtype.kind not in "biufc" or "MATLAB_empty" in item.attrs:
                    continue
                if matlab and item.attrs.get("MATLAB_class") in (b"char", "char"):
                    continue
                if item.shape is None:
                    continue
                require_own(path, name, item)
                total += item.size * item.dtype.itemsize
                check_size(path, total, max_bytes)
                values = np.asarray(item[()])
                variables[name.replace("/", ".")] = values.T if matlab else values
    except FileFormatError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError, TypeError) as error:
        raise unreadable(path, "MATLAB v7.3" if matlab else "HDF5", error) from error
    return Table(path, "MATLAB v7.3" if matlab else "HDF5", flattened(variables))


def require_own(path: Any, name: str, item: Any) -> None:
    """Refuse a data set whose values lie in other files."""
    if item.external or item.is_virtual:
        raise FileFormatError(
            f"{path}: the data set {name!r} lies in another file, which is not opened",
            "Export the measured values themselves into one file.",
        )


def data_sets(h5py: Any, file: Any) -> Iterator[tuple[str, Any]]:
    """Every data set that the file itself holds, by name and once; links into other files are not followed."""

    def number(item: Any) -> Any:
        return h5py.h5g.get_objinfo(item.id).objno

    seen = {number(file["/"])}
    stack = [("", file)]
    while stack:
        name, item = stack.pop()
        if isinstance(item, h5py.Dataset):
            yield name, item
        if not isinstance(item, h5py.Group):
            continue
        inside = []
        for key in item:
            if isinstance(item.get(key, getlink=True), h5py.HardLink):
                own = number(item[key])
                if own not in seen:
                    seen.add(own)
                    inside.append((f"{name}/{key}" if name else key, item[key]))
        stack += reversed(inside)
