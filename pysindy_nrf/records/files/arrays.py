"""Files of binary arrays: NumPy, HDF5, MATLAB, Parquet.

Sizes that a file declares are checked before memory is taken. Pickled objects, which
could run code, are never loaded.
"""

import math
import pickle
import struct
import subprocess
import sys
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd

from ...common.lazy import require
from ...exceptions import FileFormatError
from .table import MAX_BYTES, SCHEMA, Attributes, Table, check_size, reading_as


def flattened(content: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    """Numeric arrays by name; fields of structures as ``struct.field``; single columns
    one-dimensional.
    """
    out: dict[str, np.ndarray] = {}
    for name, value in content.items():
        array = value if isinstance(value, Mapping) else np.asarray(value)
        if isinstance(array, np.ndarray) and array.dtype.names:
            array = {field: array[field] for field in array.dtype.names}
        if isinstance(array, Mapping):
            out |= flattened(array, f"{prefix}{name}.")
        elif array.dtype.kind in "biufcmM":
            if array.ndim == 2 and 1 in array.shape:
                array = array.ravel() if array.size > 1 else array.reshape(())
            out[f"{prefix}{name}"] = array
    return out


def read_npz(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a NumPy archive (.npz) or array (.npy)."""
    with reading_as(path, "NumPy"):
        if path.suffix.lower() == ".npz":
            with zipfile.ZipFile(path) as archive:
                members = [
                    item
                    for item in archive.infolist()
                    if item.filename.endswith(".npy")
                ]
                check_size(path, sum(item.file_size for item in members), max_bytes)
                for item in members:
                    with archive.open(item) as stream:
                        _check_header(path, stream, item.file_size)
            with np.load(path, allow_pickle=False) as loaded:
                variables = {
                    name: loaded[name]
                    for name in loaded.files
                    if f"{name}.npy" in loaded.zip.namelist()
                }
        else:
            with open(path, "rb") as stream:
                _check_header(path, stream, path.stat().st_size)
                stream.seek(0)
                variables = {path.stem: np.load(stream, allow_pickle=False)}
    return Table(path, "NumPy", flattened(variables))


def _check_header(path: Path, stream: IO[bytes], held: int) -> None:
    """Refuse an array whose header declares more bytes than the file holds; NumPy would
    allocate them first.
    """
    read: Any = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(stream)
    if version not in read:
        return  # NumPy itself refuses unknown versions
    shape, _, dtype = read[version](stream)
    if dtype.hasobject:
        cure = "Save plain arrays: numpy.savez(path, a1=..., x1=...)."
        raise FileFormatError(
            f"{path} holds pickled Python objects, which could run code and are never"
            " loaded",
            cure,
        )
    if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize > held:
        raise ValueError(
            f"an array declares the shape {shape} of {dtype} but the file holds {held}"
            " bytes"
        )


SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_hdf5(path: Path, max_bytes: int = MAX_BYTES, matlab: bool = False) -> Table:
    """Read the numeric data sets of an HDF5 file; the names of groups are joined by
    points.
    """
    h5py = require("h5py", "files", "Reading HDF5 and MATLAB v7.3 files")
    kind = "MATLAB v7.3" if matlab else "HDF5"
    variables: dict[str, np.ndarray] = {}
    total, objects = 0, []
    with reading_as(path, kind), h5py.File(path, "r") as file:
        for name, item in data_sets(h5py, file).items():
            if "MATLAB_object_decode" in item.attrs:
                objects.append(f"{name} ({bytes(item.attrs['MATLAB_class']).decode()})")
                continue
            text = matlab and item.attrs.get("MATLAB_class") in (b"char", "char")
            empty = item.shape is None or "MATLAB_empty" in item.attrs
            if text or empty or name.startswith("#") or item.dtype.kind not in "biufc":
                continue
            require_own(path, name, item)
            total += item.size * item.dtype.itemsize
            check_size(path, total, max_bytes)
            values = np.asarray(item[()])
            variables[name.replace("/", ".")] = values.T if matlab else values
    return _without_objects(path, kind, flattened(variables), objects)


def _without_objects(
    path: Path, kind: str, variables: dict[str, np.ndarray], objects: list[str]
) -> Table:
    """The table of a file without MATLAB's objects (timetables, durations), which are
    numbers to MATLAB alone.
    """
    if objects and not any(values.size > 1 for values in variables.values()):
        export = (
            "T = timetable2table(TT); t = seconds(T.Time); a1 = T.a1; save('test.mat',"
            " 't', 'a1', '-v7')"
        )
        raise FileFormatError(
            f"{path} holds {', '.join(objects)}, which MATLAB alone can read",
            f"In MATLAB: {export}",
        )
    return Table(
        path,
        kind,
        variables,
        notes=[f"not read, an object of MATLAB: {one}" for one in objects],
    )


def require_own(path: Any, name: str, item: Any) -> None:
    """Refuse a data set whose values lie in other files."""
    if item.external or item.is_virtual:
        cure = "Export the measured values themselves into one file."
        raise FileFormatError(
            f"{path}: the data set {name!r} lies in another file, which is not opened",
            cure,
        )


def data_sets(h5py: Any, file: Any) -> dict[str, Any]:
    """Data sets by name, each once, that the file itself holds; links into other files
    are not followed.
    """
    found: dict[str, Any] = {}
    file.visititems(
        lambda name, item: found.update(
            {name: item} if isinstance(item, h5py.Dataset) else {}
        )
    )
    return found


_HEADER, _COMPRESSED = 128, 15
_PIECE = 1 << 20
_SECONDS, _BYTES_PER_SECOND = 60.0, 5e6  # time limit of a file
_LOAD = """
import pickle, sys
from scipy.io import loadmat
from scipy.io.matlab import MatlabOpaque
try:
    held = {k: v for k, v in loadmat(sys.argv[1], simplify_cells=True).items() if k[:2] != "__"}
    objects = [v[0] for v in held.values() if isinstance(v, MatlabOpaque)]
    objects = [f"{one['s0'].decode()} ({one['s2'].decode()})" for one in objects]
    numbers = {k: v for k, v in held.items() if not isinstance(v, MatlabOpaque)}
    pickle.dump((numbers, objects), sys.stdout.buffer, protocol=5)
except Exception as error:
    sys.exit(f"{error or type(error).__name__}"[:500])
"""


def read_mat(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read a MATLAB file: up to v7 by SciPy, v7.3 by h5py."""
    with open(path, "rb") as file:
        head = file.read(520)
    if (
        head[:8] == SIGNATURE
        or head[512:520] == SIGNATURE
        or b"MATLAB 7.3" in head[:128]
    ):
        return read_hdf5(path, max_bytes, matlab=True)
    with reading_as(path, "MATLAB"):
        _check_unpacked(path, head, max_bytes)
        numbers, objects = _loaded(path)
    return _without_objects(path, "MATLAB", flattened(numbers), objects)


def _loaded(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Variables and objects of a v4 or v5 file, read in a process of its own: damaged
    bytes can crash SciPy.
    """
    limit = _SECONDS + path.stat().st_size / _BYTES_PER_SECOND
    command = [sys.executable, "-P", "-W", "ignore", "-c", _LOAD, str(path.absolute())]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=limit, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it was not read within {limit:.0f} s") from None
    if done.returncode:
        crash = "its variables are damaged (SciPy's reader ended its process)"
        raise ValueError(
            done.stderr.decode(errors="replace").strip()
            if done.returncode == 1
            else crash
        )
    return pickle.loads(done.stdout)  # noqa: S301 - what this very process sends back


def _check_unpacked(path: Path, head: bytes, max_bytes: int) -> None:
    """Refuse compressed variables that unpack to more than the limit; they are unpacked
    in pieces that are dropped.
    """
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


ATTRIBUTES_KEY = SCHEMA.encode()


def read_parquet(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the columns of a Parquet file that hold numbers, times or texts; a time
    index becomes the column ``t``.
    """
    types = require("pyarrow.types", "files", "Reading Parquet files")
    parquet = require("pyarrow.parquet", "files", "Reading Parquet files")
    with reading_as(path, "Parquet"):
        file = parquet.ParquetFile(path)
        schema, about = file.schema_arrow, file.metadata
        twice = [name for name, count in Counter(schema.names).items() if count > 1]
        if twice:
            raise FileFormatError(
                f"{path} has two columns named {twice[0]!r}", "Rename one."
            )
        texts = [
            f.name
            for f in schema
            if types.is_string(f.type) or types.is_large_string(f.type)
        ]
        kept = texts + [
            f.name
            for f in schema
            if types.is_primitive(f.type) or types.is_dictionary(f.type)
        ]
        declared = sum(
            about.row_group(i).total_byte_size for i in range(about.num_row_groups)
        )
        check_size(path, max(declared, 8 * about.num_rows * len(kept)), max_bytes)
        # dictionaries keep a repeated text from being unpacked once for each row
        held = parquet.read_table(
            path, columns=[n for n in schema.names if n in kept], read_dictionary=texts
        )
        attributes = (schema.metadata or {}).get(ATTRIBUTES_KEY)
        frame = held.to_pandas()
    variables = {}
    if frame.index.name in ("t", "time") or isinstance(
        frame.index, (pd.DatetimeIndex, pd.TimedeltaIndex)
    ):
        variables["t"] = frame.index.to_numpy()
    for name in frame.columns:
        column = frame[name]
        if hasattr(column.dtype, "numpy_dtype") and column.dtype.kind in "biuf":
            column = column.astype(float)  # nullable numbers
        variables[str(name)] = column.to_numpy()
    own = None if attributes is None else Attributes.from_json(attributes, path)
    return Table(path, "Parquet", variables, attributes=own)


def read_tdms(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the channels of a TDMS file of LabVIEW, their units and their sampling
    rate.
    """
    nptdms = require("nptdms", "files", "Reading TDMS files")
    check_size(path, path.stat().st_size, max_bytes)
    with reading_as(path, "TDMS"):
        channels = [
            channel
            for group in nptdms.TdmsFile.read(path).groups()
            for channel in group.channels()
        ]
        several = len({channel.group_name for channel in channels}) > 1
        variables, units, steps = {}, {}, set()
        for channel in channels:
            name = (
                f"{channel.group_name}.{channel.name}" if several else str(channel.name)
            )
            variables[name] = np.asarray(channel[:])
            units[name] = str(
                channel.properties.get(
                    "unit_string", channel.properties.get("NI_UnitDescription", "")
                )
            )
            steps.add(float(channel.properties.get("wf_increment", 0.0)))
    fs = 1.0 / steps.pop() if len(steps) == 1 and 0.0 not in steps else None
    return Table(
        path,
        "TDMS",
        variables,
        {name: unit for name, unit in units.items() if unit},
        fs=fs,
    )
