"""NumPy files. Pickled objects, which could run code, are never loaded."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...exceptions import FileFormatError
from .flatten import flattened
from .table import MAX_BYTES, Table, check_file, check_size, unreadable


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a NumPy archive or array; what its headers declare is checked before memory is taken."""
    check_file(path, max_bytes)
    try:
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                members = [item for item in archive.infolist() if item.filename.endswith(".npy")]
                check_size(path, sum(item.file_size for item in members), max_bytes)
                for item in members:
                    with archive.open(item) as stream:
                        _check_header(stream, item.file_size)
            with np.load(path, allow_pickle=False) as loaded:
                variables = {name: loaded[name] for name in loaded.files if f"{name}.npy" in loaded.zip.namelist()}
        else:
            with open(path, "rb") as stream:
                _check_header(stream, path.stat().st_size)
                stream.seek(0)
                variables = {path.stem: np.load(stream, allow_pickle=False)}
    except FileFormatError:
        raise
    except ValueError as error:
        if "pickle" in str(error).lower() or "object" in str(error).lower():
            raise FileFormatError(
                f"{path} holds pickled Python objects, which could run code and are never loaded",
                "Save plain arrays: numpy.savez(path, a1=..., x1=...).",
            ) from error
        raise unreadable(path, "NumPy", error) from error
    except (OSError, EOFError, zipfile.BadZipFile, KeyError, NotImplementedError, RuntimeError) as error:
        raise unreadable(path, "NumPy", error) from error
    except Exception as error:  # a damaged deflate stream
        raise unreadable(path, "NumPy", error) from error
    return Table(path, "NumPy", flattened(variables))


def _check_header(stream: IO[bytes], held: int) -> None:
    """Refuse an array whose header declares more than the file holds; NumPy would take the memory first."""
    read: Any = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in read:
        return  # NumPy itself refuses what it does not know
    shape, _, dtype = read[version](stream)
    if dtype.hasobject:
        raise ValueError("object arrays are pickled")
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize > held:
        raise ValueError(f"an array declares the shape {shape} of {dtype} but the file holds {held} bytes")
