"""NumPy archives (.npz) and arrays (.npy).

Sizes that a header declares are checked before memory is taken. Pickled objects, which
could run code, are never loaded.
"""

import math
import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from ....exceptions import FileFormatError
from ..table import MAX_BYTES, Table, check_size, reading_as
from .numeric_arrays import numeric_arrays

_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the arrays of a NumPy archive."""
    with reading_as(path, "NumPy"):
        names = _check_archive(path, max_bytes)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files if name in names}
    return Table(path, "NumPy", numeric_arrays(arrays))


def read_npy(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a NumPy array; it is called as its file."""
    with reading_as(path, "NumPy"), open(path, "rb") as stream:
        _check_header(path, stream, path.stat().st_size)
        stream.seek(0)
        array = np.load(stream, allow_pickle=False)
    return Table(path, "NumPy", numeric_arrays({path.stem: array}))


def _check_archive(path: Path, max_bytes: int) -> set[str]:
    """Check the sizes of the arrays in an archive; return their names."""
    with zipfile.ZipFile(path) as archive:
        members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
        check_size(path, sum(member.file_size for member in members), max_bytes)

        for member in members:
            with archive.open(member) as stream:
                _check_header(path, stream, member.file_size)
    return {member.filename.removesuffix(".npy") for member in members}


def _check_header(path: Path, stream: IO[bytes], size: int) -> None:
    """Refuse an array whose header declares more bytes than there are.

    NumPy would allocate them first.
    """
    version = np.lib.format.read_magic(stream)
    read_header = _HEADER_READERS.get(version)
    if read_header is None:
        return  # NumPy itself refuses unknown versions

    shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise FileFormatError(
            f"{path} holds pickled Python objects, which could run code and are never"
            " loaded",
            "Save plain arrays: numpy.savez(path, a1=..., x1=...).",
        )
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize > size:
        raise ValueError(
            f"an array declares the shape {shape} of {dtype} but the file holds {size}"
            " bytes"
        )
