"""Sources of samples, read in chunks: NumPy files, Parquet, HDF5, lists of them,
iterators of tables and records.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...common.lazy import require
from ...exceptions import ChannelError, FileFormatError
from ...records.channels import by_record
from ...records.dataset import feature_names
from ...records.files.formats.hdf5 import data_sets, require_own
from ...records.files.table import check_file, reading_as, unreadable
from ...records.fusion.kinematics import base_acceleration_if_any
from ...records.input_arrays import table_time
from ...records.record import Record, seconds_of

CHUNK_BYTES = 2**25  # of a chunk as float64


@dataclass
class Chunk:
    """Some consecutive samples of a source."""

    X: Any  # (n_samples, 3 n_dof); as for ``NRFRegressor.fit``
    F: Any = None  # (n_samples, n_dof); N
    record: str = "record"  # name of the record, if there are no record ids
    # true if a record starts with it; otherwise it continues the chunk before it
    first: bool = True
    ids: np.ndarray | None = None  # (n_samples,); record ids
    time: np.ndarray | None = None  # (n_samples,); s
    base_acceleration: np.ndarray | None = None  # (n_samples,); m/s^2
    covariates: dict[str, np.ndarray] = field(default_factory=dict)  # (n_samples,)
    coordinates: str | None = None  # of X; those of the estimator if None

    @property
    def n_samples(self) -> int:
        """Rows."""
        return len(self.X)

    def records(self) -> list[Chunk]:
        """The samples of each record, split by record ids."""
        if self.ids is None:
            return [self]
        pieces = by_record(self.ids, self.n_samples)
        return [
            Chunk(
                cut(self.X, rows),
                cut(self.F, rows),
                name,
                self.first or i > 0,
                None,
                cut(self.time, rows),
                cut(self.base_acceleration, rows),
                {k: c[rows] for k, c in self.covariates.items()},
                self.coordinates,
            )
            for i, (name, rows) in enumerate(pieces)
        ]


def cut(value: Any, rows: slice) -> Any:
    """Rows of an array or a table; None for None."""
    return (
        value.iloc[rows]
        if hasattr(value, "iloc")
        else None
        if value is None
        else value[rows]
    )


# 8-byte values in one sum of a hash: an odd number, or a change of sign of all of them
# would be lost
_ADDED = 255


def content(chunks: Iterable[Chunk], before: int = 0) -> int:
    """Hash of the samples of chunks that follow others; of 8-byte values by wrapping
    sums, in a fifth of the time.
    """
    for chunk in chunks:
        for name, values in {**vars(chunk), **chunk.covariates}.items():
            array = np.asarray(values)
            before = zlib.crc32(f"{name} {array.dtype} {array.shape}".encode(), before)
            flat = (array.astype(str) if array.dtype.hasobject else array).ravel(
                order="K"
            )
            if flat.itemsize == 8:
                flat = np.add.reduceat(
                    flat.view(np.uint64), np.arange(0, flat.size, _ADDED)
                )
            before = zlib.crc32(flat.view(np.uint8).data, before)
    return before


def chunk_of(
    item: Any,
    covariates: Sequence[str] = (),
    coordinates: str = "relative",
    first: bool = True,
) -> Chunk:
    """One item of an iterator as a chunk."""
    if isinstance(item, Chunk):
        return item
    if isinstance(item, Record):
        x, force = item.to_features()
        ag = base_acceleration_if_any(item, x.attrs.get("band"))
        return Chunk(
            x.to_numpy(),
            force.to_numpy(),
            item.name,
            True,
            None,
            np.asarray(item.time),
            ag,
            dict(item.covariates),
            "relative",
        )
    if hasattr(item, "columns"):
        names = [str(c) for c in item.columns]
        n = n_dof_of(names, "The table")
        wanted = wanted_columns(names, n, covariates, coordinates, "The table")
        values = {c: item[c].to_numpy() for c in wanted}
        if (time := table_time(item)) is not None:
            values["t"] = time
        return chunk_of_columns(values, n, covariates, "record", first, coordinates)
    if isinstance(item, tuple) and len(item) == 2:
        return Chunk(item[0], item[1], first=first, time=table_time(item[0]))
    if isinstance(item, np.ndarray):
        return Chunk(item, first=first)
    raise ChannelError(
        f"The iterator gave {type(item).__name__}",
        "It must give DataFrames, pairs (X, F) or Records.",
    )


def n_dof_of(columns: Sequence[str], where: Any) -> int:
    """DOFs of named columns: those of a1, a2, ..."""
    n = sum(1 for c in columns if c[:1] == "a" and c[1:].isdigit() and c != "a0")
    if not n:
        raise ChannelError(
            f"{where} has no columns a1, a2, ...",
            f"Name them {', '.join(feature_names(2))}, F1, F2.",
        )
    return n


def wanted_columns(
    columns: Sequence[str],
    n_dof: int,
    covariates: Sequence[str],
    coordinates: str,
    where: Any,
) -> list[str]:
    """The columns to read; an error names those that are missing."""
    needed = [*feature_names(n_dof, coordinates), *covariates]
    missing = [c for c in needed if c not in columns]
    forces = [f"F{j}" for j in range(1, n_dof + 1)]
    some = [c for c in forces if c in columns]
    if missing or (some and len(some) < n_dof):
        lost = (missing or [c for c in forces if c not in columns])[:6]
        cure = "A force known to be zero is a column of zeros, an unknown one of NaN."
        raise ChannelError(
            f"{where} lacks the column{'s' if len(lost) > 1 else ''} {', '.join(lost)}",
            cure,
        )
    base = ("xdot0", "x0") if coordinates == "absolute" else ()
    return [
        *needed,
        *some,
        *(c for c in (*base, "t", "time", "ag", "record") if c in columns),
    ]


def chunk_of_columns(
    values: Mapping[str, Any],
    n_dof: int,
    covariates: Sequence[str],
    record: str,
    first: bool,
    coordinates: str,
) -> Chunk:
    """Named columns as a chunk."""
    import pandas as pd

    names = feature_names(n_dof, coordinates)
    if "xdot0" in values and "x0" in values and coordinates == "absolute":
        X: Any = pd.DataFrame(
            {c: values[c] for c in (*names, "xdot0", "x0")}, copy=False
        )
    else:
        X = _stacked([values[c] for c in names])
    forces = [f"F{j}" for j in range(1, n_dof + 1)]
    F = _stacked([values[c] for c in forces]) if forces[0] in values else None
    time = values.get("t", values.get("time"))
    return Chunk(
        X,
        F,
        record,
        first,
        values.get("record"),
        time,
        values.get("ag"),
        {c: values[c] for c in covariates},
    )


def _stacked(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Columns side by side, in single precision if all of them are."""
    kind = np.float32 if np.result_type(*columns) == np.float32 else np.float64
    return np.stack(columns, dtype=kind, casting="unsafe").T


def chunk_of_arrays(rows: Mapping[str, Any], record: str, first: bool) -> Chunk:
    """Arrays X, F, record, time, base_acceleration and ``covariate ...`` as a chunk."""
    extra = {
        k.removeprefix("covariate "): v
        for k, v in rows.items()
        if k.startswith("covariate ")
    }
    return Chunk(
        rows["X"],
        rows.get("F"),
        record,
        first,
        rows.get("record"),
        rows.get("time"),
        rows.get("base_acceleration"),
        extra,
    )


def beside(**given: Any) -> dict[str, Any]:
    """The arrays that a user gave beside X, covariates by name."""
    covariates = given.pop("covariates", None)
    given |= {
        f"covariate {k}": c
        for k, c in ({} if covariates is None else dict(covariates)).items()
    }
    return {k: v for k, v in given.items() if v is not None}


def seconds_since(time: Any, origin: Any) -> np.ndarray:
    """Times as seconds since an origin of the same kind; numbers are seconds
    already.
    """
    array = np.asarray(time)
    if array.dtype.kind in "mM":
        return (array - origin) / np.timedelta64(1, "ns") * 1e-9
    return seconds_of(array, "time")


class Source:
    """Chunks of samples in a fixed order."""

    n_samples: int | None = None  # in all, if known
    again: bool = True  # true if it can be read more than once
    paths: Sequence[Path] = ()  # files that are read

    def identity(self) -> list[Any]:
        """Paths and sizes of the files, as JSON; what they hold is compared by
        :func:`content`.
        """
        return [[str(p.resolve()), p.stat().st_size] for p in self.paths]

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, from the first one on."""
        raise NotImplementedError


def samples_in_chunk(n_dof: int, wanted: int | None) -> int:
    """Samples in a chunk of a chain: as wanted, else by memory."""
    return wanted or int(np.clip(CHUNK_BYTES // (32 * n_dof), 4096, 2**18))


def load_rows(value: Any, what: str) -> Any:
    """An array as it is; a NumPy file by path is mapped, not read."""
    if not isinstance(value, (str, os.PathLike)):
        return value
    path = Path(value)
    check_file(path, 2**62)
    if path.suffix.lower() != ".npy":
        raise FileFormatError(
            f"{what}={str(path)!r} is not a .npy file", "Save it with numpy.save."
        )
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise unreadable(path, "NumPy", error) from error


class FileSource(Source):
    """A source whose samples are counted and whose chunks have one size."""

    n_samples: int
    rows: int  # in a chunk; the last one may be shorter


class ArraySource(FileSource):
    """Arrays, most often mapped ``.npy`` files."""

    def __init__(self, X: Any, chunk_samples: int | None = None, **given: Any) -> None:
        given = {"X": X, **beside(**given)}
        self.paths = [
            Path(v) for v in given.values() if isinstance(v, (str, os.PathLike))
        ]
        self.arrays = {k: load_rows(v, k) for k, v in given.items()}
        x = self.arrays["X"]
        if getattr(x, "ndim", 0) != 2 or not x.shape[1] or x.shape[1] % 3:
            cure = f"Its columns are {', '.join(feature_names(2))} for two DOFs."
            raise ChannelError(
                f"X has the shape {np.shape(x)}, (n_samples, 3 n_dof) is needed", cure
            )
        self.n_samples = len(x)
        for name, values in self.arrays.items():
            if len(values) != self.n_samples:
                cure = "Cut both to the same clock."
                raise ChannelError(
                    f"{name} has {len(values)} samples, X has {self.n_samples}", cure
                )
        self.rows = samples_in_chunk(x.shape[1] // 3, chunk_samples)

    def chunks(self) -> Iterator[Chunk]:
        """Slices of the arrays."""
        name = self.paths[0].stem if self.paths else "record"
        for low in range(0, self.n_samples, self.rows):
            rows = {
                k: np.asarray(v[low : low + self.rows]) for k, v in self.arrays.items()
            }
            yield chunk_of_arrays(rows, name, low == 0)


class TableSource(FileSource):
    """Columns by name: a1.., v1.., s1.., F1.., and t, ag, record or covariates if
    present.
    """

    def __init__(
        self,
        path: Any,
        covariates: Sequence[str] = (),
        coordinates: str = "relative",
        chunk_samples: int | None = None,
    ) -> None:
        self.path = Path(path)
        self.paths = [self.path]
        check_file(self.path, 2**62)
        self.covariates, self.coordinates = tuple(covariates), coordinates
        self.columns = self._open()
        self.n_dof = n_dof_of(self.columns, self.path)
        self.rows = samples_in_chunk(self.n_dof, chunk_samples)

    def _open(self) -> list[str]:
        raise NotImplementedError

    def wanted(self) -> list[str]:
        """Columns to read."""
        return wanted_columns(
            self.columns, self.n_dof, self.covariates, self.coordinates, self.path
        )

    def chunk(self, values: Mapping[str, Any], first: bool) -> Chunk:
        """Named columns as a chunk."""
        return chunk_of_columns(
            values, self.n_dof, self.covariates, self.path.stem, first, self.coordinates
        )


class ParquetSource(TableSource):
    """A Parquet file, row group after row group."""

    def _open(self) -> list[str]:
        self._parquet = require("pyarrow.parquet", "files", "Reading Parquet files")
        with (
            reading_as(self.path, "Parquet"),
            self._parquet.ParquetFile(self.path) as file,
        ):
            self.n_samples = file.metadata.num_rows
            return list(file.schema_arrow.names)

    def chunks(self) -> Iterator[Chunk]:
        """Batches of rows, across the file's own groups of rows."""
        wanted = self.wanted()
        with (
            reading_as(self.path, "Parquet"),
            self._parquet.ParquetFile(self.path) as file,
        ):
            for i, batch in enumerate(
                file.iter_batches(self.rows, columns=wanted, use_threads=False)
            ):
                values = {
                    name: batch.column(name).to_numpy(zero_copy_only=False)
                    for name in wanted
                }
                yield self.chunk(values, i == 0)


class HDF5Source(TableSource):
    """Data sets of an HDF5 file: ``X`` and ``F``; ``a``, ``v``, ``s``, ``F``; or one
    for each column.
    """

    def _open(self) -> list[str]:
        self._h5py = require("h5py", "files", "Reading HDF5 files")
        with reading_as(self.path, "HDF5"), self._h5py.File(self.path, "r") as file:
            sets = {
                k: v for k, v in data_sets(self._h5py, file).items() if "/" not in k
            }
            for name, held in sets.items():
                require_own(self.path, name, held)
            lengths = {len(v) for v in sets.values() if v.ndim and len(v) > 1}
            if len(lengths) != 1:
                cure = "Give all of them one clock."
                raise ChannelError(
                    f"The data sets of {self.path} have {sorted(lengths)} samples", cure
                )
            self.n_samples = lengths.pop()
            rate, drift = (
                ("v", "s") if self.coordinates == "relative" else ("xdot", "x")
            )
            self._spread: dict[str, list[str]] = {}
            for name, width in (
                (k, v.shape[1]) for k, v in sets.items() if v.ndim == 2
            ):
                if name == "X" and width % 3 == 0:
                    self._spread[name] = feature_names(width // 3, self.coordinates)
                elif name in ("a", rate, drift, "F"):
                    self._spread[name] = [f"{name}{j}" for j in range(1, width + 1)]
            single = [k for k, v in sets.items() if v.ndim == 1]
            return [c for columns in self._spread.values() for c in columns] + single

    def chunks(self) -> Iterator[Chunk]:
        """Slices of the data sets."""
        wanted = set(self.wanted())
        with reading_as(self.path, "HDF5"), self._h5py.File(self.path, "r") as file:
            for low in range(0, self.n_samples, self.rows):
                rows = slice(low, low + self.rows)
                values: dict[str, Any] = {}
                for name, columns in self._spread.items():
                    if wanted & set(columns):
                        values |= dict(zip(columns, file[name][rows].T))
                for name in wanted - set(values):
                    values[name] = file[name][rows]
                yield self.chunk(values, low == 0)


class ListSource(Source):
    """Several files in sequence, each with one record or more."""

    def __init__(self, parts: Sequence[Source]) -> None:
        self.parts = [p for p in parts if isinstance(p, FileSource)]
        if len(self.parts) < len(parts):
            cure = (
                "Give a list of paths without lists in it, or one iterator that yields"
                " all the pieces."
            )
            raise ChannelError(
                "A list of sources holds something that is not a file", cure
            )
        self.n_samples, self.paths = (
            sum(p.n_samples for p in self.parts),
            [q for p in self.parts for q in p.paths],
        )

    def chunks(self) -> Iterator[Chunk]:
        """Chunks of the parts, each part its own record."""
        for part in self.parts:
            yield from part.chunks()


class IteratorSource(Source):
    """An iterator of tables, pairs (X, F) or records, which can be read once."""

    again = False

    def __init__(
        self,
        items: Iterable[Any],
        covariates: Sequence[str] = (),
        coordinates: str = "relative",
    ) -> None:
        self.items, self.covariates, self.coordinates = (
            items,
            tuple(covariates),
            coordinates,
        )

    def chunks(self) -> Iterator[Chunk]:
        """Chunks in the order of the iterator."""
        first = True
        for item in self.items:
            yield chunk_of(item, self.covariates, self.coordinates, first)
            first = isinstance(item, Record)


_READERS = {
    ".parquet": ParquetSource,
    ".pq": ParquetSource,
    ".h5": HDF5Source,
    ".hdf5": HDF5Source,
}


def open_source(
    X: Any,
    F: Any = None,
    *,
    coordinates: str = "relative",
    laws_read: Sequence[str] = (),
    chunk_samples: int | None = None,
    **more: Any,
) -> Source:
    """The source of the data that a user passes to ``fit``."""
    if isinstance(X, (str, os.PathLike)):
        suffix = Path(X).suffix.lower()
        if suffix == ".npy":
            return ArraySource(X, chunk_samples, F=F, **more)
        if suffix not in _READERS:
            raise FileFormatError(
                f"{X} has the type {suffix or '(none)'}, which cannot be read in"
                " chunks",
                f"Give .npy, {', '.join(_READERS)}; read a single record with"
                " io.read_record, or a long text file as pandas.read_csv(path,"
                " chunksize=...).",
            )
        refuse(beside(F=F, **more), "a table, whose columns hold them")
        return _READERS[suffix](X, tuple(laws_read), coordinates, chunk_samples)
    if isinstance(X, (list, tuple)):
        forces = F if isinstance(F, (list, tuple)) else [None] * len(X)
        if F is not None and (
            not isinstance(F, (list, tuple)) or len(forces) != len(X)
        ):
            raise ChannelError(
                f"{len(X)} files of X need as many of F",
                "Give a list of paths of the same length.",
            )
        refuse(beside(**more), "a list of files")
        options: Any = dict(
            coordinates=coordinates, laws_read=laws_read, chunk_samples=chunk_samples
        )
        return ListSource([open_source(x, f, **options) for x, f in zip(X, forces)])
    refuse(beside(F=F, **more), "an iterator, whose items hold them")
    return IteratorSource(X, tuple(laws_read), coordinates)


def refuse(given: Mapping[str, Any], what: str) -> None:
    """Raise a ChannelError if anything was given beside X."""
    if given:
        name = next(iter(given))
        raise ChannelError(f"{name} was given beside {what}", f"Leave {name} out.")
