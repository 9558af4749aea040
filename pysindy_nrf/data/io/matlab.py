"""MATLAB files: v5 by SciPy, v7.3 (HDF5) by h5py."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

from ...exceptions import FileFormatError
from .flatten import flattened
from .hdf5 import SIGNATURE, read_hdf5
from .table import MAX_BYTES, Table, check_file, check_size, unreadable

_HEADER, _COMPRESSED = 128, 15
_PIECE = 1 << 20
_SECONDS, _BYTES_PER_SECOND = 60.0, 5e6  # the time that a file may take
_LOAD = """
import pickle, sys
from scipy.io import loadmat
try:
    held = loadmat(sys.argv[1], simplify_cells=True)
    pickle.dump({k: v for k, v in held.items() if k[:2] != "__"}, sys.stdout.buffer, protocol=5)
except Exception as error:
    sys.exit(f"{error or type(error).__name__}"[:500])
"""


def read_mat(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a MATLAB file."""
    check_file(path, max_bytes)
    with open(path, "rb") as file:
        head = file.read(520)
    if head[:8] == SIGNATURE or head[512:520] == SIGNATURE or b"MATLAB 7.3" in head[:128]:
        return read_hdf5(path, max_bytes, matlab=True)
    try:
        _check_unpacked(path, head, max_bytes)
        content = _loaded(path)
    except FileFormatError:
        raise
    except Exception as error:  # a damaged stream: zlib, struct, what the child says
        raise unreadable(path, "MATLAB", error) from error
    return Table(path, "MATLAB", flattened(content))


def _loaded(path: Path) -> dict[str, Any]:
    """The variables of a v4 or v5 file, read in a process of its own: a damaged byte can crash SciPy's reader."""
    limit = _SECONDS + path.stat().st_size / _BYTES_PER_SECOND
    command = [sys.executable, "-P", "-W", "ignore", "-c", _LOAD, str(path.absolute())]
    try:
        done = subprocess.run(command, capture_output=True, timeout=limit, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        raise ValueError(f"it was not read within {limit:.0f} s") from None
    if done.returncode:
        crash = "its variables are damaged (SciPy's reader ended its process)"
        raise ValueError(done.stderr.decode(errors="replace").strip() if done.returncode == 1 else crash)
    return pickle.loads(done.stdout)


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
