"""Files of every type, good ones and damaged ones; gone with the process."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from scipy.io import savemat

from .material import good


@cache
def temporary_folder() -> tempfile.TemporaryDirectory:
    """The folder of all these files; it lives as long as the process."""
    return tempfile.TemporaryDirectory(prefix="bad files ")


def folder() -> Path:
    return Path(temporary_folder().name)


def made(name: str, write: Callable[[Path], Any]) -> Path:
    """A file that a library writes, in a folder of its own."""
    path = Path(tempfile.mkdtemp(dir=folder())) / name
    write(path)
    return path


def written(name: str, content: str | bytes) -> Path:
    """A file of that content."""
    raw = content if isinstance(content, bytes) else content.encode()
    return made(name, lambda path: path.write_bytes(raw))


def frame() -> pd.DataFrame:
    """A good table with a time."""
    return good().to_frame().reset_index()


def csv(table: pd.DataFrame | None = None, name: str = "test.csv") -> Path:
    """A table as delimited text, the good one by default."""
    table = frame() if table is None else table
    return written(name, table.to_csv(index=False))


def first_channel() -> dict[str, np.ndarray]:
    """Variables of a good file."""
    return {"a1": good().acceleration[:, 0], "t": good().time}


def mat(**variables: Any) -> Path:
    """A MATLAB file of some variables, one channel by default."""
    return made("test.mat", lambda path: savemat(path, variables or first_channel()))


def hdf5(**variables: Any) -> Path:
    """An HDF5 file of some variables, one channel by default."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, value in (variables or first_channel()).items():
                file[name] = value

    return made("test.h5", write)


def npz() -> Path:
    return made("test.npz", lambda path: np.savez(path, **first_channel()))


def parquet() -> Path:
    return made("test.parquet", frame().to_parquet)


def npy_of_shape(length: int) -> Path:
    """A NumPy file whose header claims another length than it holds."""
    header = {"descr": "<f8", "fortran_order": False, "shape": (length,)}

    def write(path: Path) -> None:
        with path.open("wb") as file:
            np.lib.format.write_array_header_1_0(file, header)
            file.write(bytes(80))

    return made("a1.npy", write)


def pickled() -> Path:
    """A NumPy file of Python objects."""
    objects = np.array([{}, None], dtype=object)
    return made("a1.npy", lambda path: np.save(path, objects))


def zipped(name: str, content: bytes) -> Path:
    """An archive of one member, called NPZ."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(name, content)

    return made("test.npz", write)


def renamed(path: Path, name: str) -> Path:
    """A file under another name."""
    return path.rename(path.parent / name)


def cut(path: Path, share: float) -> Path:
    """The first part of a file."""
    raw = path.read_bytes()
    return written(path.name, raw[: int(len(raw) * share)])


def flipped(path: Path, position: float, n_bytes: int = 64) -> Path:
    """A file with some bytes overwritten, from a share of its length on."""
    raw = bytearray(path.read_bytes())
    start = int(len(raw) * position)
    chunk = slice(start, start + n_bytes)
    raw[chunk] = bytes(255 - byte for byte in raw[chunk])
    return written(path.name, bytes(raw))
