"""MATLAB files: up to v7 by SciPy, v7.3 by h5py."""

import io
import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from ..table import MAX_BYTES, Table, check_size, reading_as
from . import numeric_arrays
from .hdf5 import HDF5_SIGNATURE, read_hdf5, table_without_objects

MAX_SECONDS = 60.0  # for reading a small file
MIN_BYTES_PER_SECOND = 5e6  # by which a large file may take longer


def read_mat(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the numeric variables of a MATLAB file; fields are ``struct.field``."""
    with open(path, "rb") as file:
        head = file.read(520)

    # v7.3 begins with a block of text before the HDF5 signature, or without it
    signatures = (head[:8], head[512:520])
    if HDF5_SIGNATURE in signatures or b"MATLAB 7.3" in head[:128]:
        return read_hdf5(path, max_bytes, matlab=True)

    with reading_as(path, "MATLAB"):
        _check_unpacked_size(path, head, max_bytes)
        arrays, objects = _load(path)
    return table_without_objects(path, "MATLAB", arrays, objects)


def _load(path: Path) -> tuple[dict[str, np.ndarray], list[str]]:
    """Arrays and objects of a v4 to v7 file.

    They are read in a process of its own, since damaged bytes can crash SciPy's reader.
    """
    script = str(numeric_arrays.__file__)
    limit = MAX_SECONDS + path.stat().st_size / MIN_BYTES_PER_SECOND
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-W", "ignore", script, str(path.absolute())],
            capture_output=True,
            timeout=limit,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it was not read within {limit:.0f} s") from None

    if process.returncode == 1:
        raise ValueError(process.stderr.decode(errors="replace").strip())
    if process.returncode:
        raise ValueError("its variables are damaged (SciPy's reader ended its process)")

    with np.load(io.BytesIO(process.stdout), allow_pickle=False) as archive:
        index, *arrays = (archive[name] for name in archive.files)
    content = json.loads(str(index))
    return dict(zip(content["names"], arrays)), content["objects"]


_HEADER_BYTES = 128
_COMPRESSED = 15  # type of a data element
_PIECE_BYTES = 1 << 20


def _check_unpacked_size(path: Path, head: bytes, max_bytes: int) -> None:
    """Refuse compressed variables that unpack to more than the limit."""
    byte_order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    if byte_order is None:
        return  # v4, not compressed

    total = 0
    with open(path, "rb") as file:
        file.seek(_HEADER_BYTES)
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{byte_order}II", tag)
            if kind != _COMPRESSED:
                file.seek(size, io.SEEK_CUR)
                continue
            for unpacked in _unpacked_sizes(file, size):
                total += unpacked
                check_size(path, total, max_bytes)


def _unpacked_sizes(file: IO[bytes], size: int) -> Iterator[int]:
    """Sizes of the unpacked pieces of a compressed variable, which are dropped."""
    unpack = zlib.decompressobj()
    while size > 0 and (packed := file.read(min(_PIECE_BYTES, size))):
        size -= len(packed)
        while packed:
            yield len(unpack.decompress(packed, _PIECE_BYTES))
            packed = unpack.unconsumed_tail
