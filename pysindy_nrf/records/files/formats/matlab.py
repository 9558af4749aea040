"""MATLAB files: up to v7 by SciPy, v7.3 by h5py."""

import io
import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from ...clock import rate_of
from ..table import MAX_BYTES, Clock, Table, check_size, reading_as
from . import numeric_arrays
from .hdf5 import HDF5_SIGNATURE, read_hdf5, table_without_objects

Value = TypeVar("Value")
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
        arrays, stated = _load(path)
    table = table_without_objects(path, "MATLAB", arrays, stated["objects"])
    units = {name: unit for name, unit in stated["units"].items() if name in arrays}
    clocks = _clocks(arrays, stated["clocks"])
    rates = {clock.fs for clock in clocks.values()}
    fs = rates.pop() if len(rates) == 1 else None

    titles = _distinct_titles(arrays, stated["titles"])
    return replace(
        table,
        variables=_renamed(arrays, titles),
        units=_renamed(units, titles),
        clocks=_renamed(clocks, titles),
        fs=fs,
    )


def _distinct_titles(
    arrays: Mapping[str, np.ndarray], stated: Mapping[str, str]
) -> dict[str, str]:
    """Names that structures give to their samples, where these distinguish them."""
    titles = {name: title for name, title in stated.items() if name in arrays}
    names = [*titles.values(), *(name for name in arrays if name not in titles)]
    return titles if len(set(names)) == len(names) else {}


def _renamed(
    by_name: Mapping[str, Value], titles: Mapping[str, str]
) -> dict[str, Value]:
    return {titles.get(name, name): value for name, value in by_name.items()}


def _clocks(
    arrays: Mapping[str, np.ndarray], stated: Mapping[str, Sequence[float]]
) -> dict[str, Clock]:
    """Clocks of the arrays in structures that state them."""
    clocks = {}
    for name, values in arrays.items():
        inside = [prefix for prefix in stated if name.startswith(prefix)]
        if inside and values.ndim:
            rate, start = stated[max(inside, key=len)]
            clocks[name] = Clock(rate_of(1.0 / rate), start)
    return clocks


def _load(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays of a v4 to v7 file, its objects, and what its structures state.

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
    return dict(zip(content["names"], arrays)), content


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
