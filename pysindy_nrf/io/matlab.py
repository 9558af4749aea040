"""MATLAB files: v5 by SciPy, v7.3 (HDF5) by h5py."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from ..exceptions import FileFormatError
from .flatten import flattened
from .hdf5 import SIGNATURE, read_hdf5
from .matlab_elements import check_elements
from .table import MAX_BYTES, Table, check_file, check_size, unreadable

_HEADER, _COMPRESSED = 128, 15
_PIECE = 1 << 20


def read_mat(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a MATLAB file.

    Parameters
    ----------
    path : Path
    max_bytes : int
        Also the limit of what compressed variables unpack to.

    Returns
    -------
    Table

    Raises
    ------
    FileFormatError
    """
    check_file(path, max_bytes)
    with open(path, "rb") as file:
        head = file.read(520)
    if head[:8] == SIGNATURE or head[512:520] == SIGNATURE or b"MATLAB 7.3" in head[:128]:
        return read_hdf5(path, max_bytes, matlab=True)
    from scipy.io import loadmat

    try:
        _check_unpacked(path, head, max_bytes)
        check_elements(path)
        content = loadmat(path, simplify_cells=True)
    except FileFormatError:
        raise
    except Exception as error:  # a damaged stream raises zlib, struct, MatRead and many other errors
        raise unreadable(path, "MATLAB", error) from error
    return Table(path, "MATLAB", flattened({k: v for k, v in content.items() if not k.startswith("__")}))


def _check_unpacked(path: Path, head: bytes, max_bytes: int) -> None:
    """Refuse compressed variables that unpack to more than the limit, before any is unpacked to memory."""
    if head[126:128] not in (b"IM", b"MI"):
        return  # v4, not compressed
    order = "<" if head[126:128] == b"IM" else ">"
    total = 0
    with open(path, "rb") as file:
        file.seek(_HEADER)
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(order + "II", tag)
            if kind != _COMPRESSED:
                file.seek(size, 1)
                continue
            unpack = zlib.decompressobj()
            while size > 0 and (piece := file.read(min(_PIECE, size))):
                size -= len(piece)
                while piece:
                    total += len(unpack.decompress(piece, _PIECE))
                    check_size(path, total, max_bytes)
                    piece = unpack.unconsumed_tail
