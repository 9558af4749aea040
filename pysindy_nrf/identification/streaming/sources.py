"""Samples that are read in chunks: NumPy, Parquet and HDF5 files, iterators."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...common.lazy import require
from ...exceptions import ChannelError, FileFormatError
from ...records.dataset import feature_names
from ...records.files.formats.hdf5 import data_sets, require_own
from ...records.files.table import check_file, reading_as, unreadable
from ...records.input_arrays import Input
from ...records.record import Record
from .chunks import Chunk, ColumnReader

# Bytes of a chunk as float64, and the samples that it has at least and at most.
CHUNK_BYTES = 2**25
SAMPLES_IN_CHUNK = 4096, 2**18
Columns = dict[str, np.ndarray]
# Files of any size are read, in chunks.
_ANY_SIZE = 2**62


class Source:
    """Chunks of samples in a fixed order.

    Attributes
    ----------
    n_samples : int or None
        In all, if known.
    again : bool
        Whether it can be read more than once.
    paths : sequence of Path
        Files that are read.
    """

    n_samples: int | None = None
    again: bool = True
    paths: Sequence[Path] = ()

    def identity(self) -> list[list[str | int]]:
        """Paths and sizes of the files, as JSON; :func:`content` compares the rest."""
        return [[str(path.resolve()), path.stat().st_size] for path in self.paths]

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, from the first one on."""
        raise NotImplementedError


class FileSource(Source):
    """A source whose samples are counted and whose chunks have one size."""

    n_samples: int
    chunk_samples: int


def _samples_in_chunk(n_dof: int) -> int:
    """Samples in a chunk of a chain, by memory."""
    bytes_in_sample = 4 * 8 * n_dof
    return int(np.clip(CHUNK_BYTES // bytes_in_sample, *SAMPLES_IN_CHUNK))


# -- arrays --------------------------------------------------------------------------


class ArraySource(FileSource):
    """Arrays, most often mapped ``.npy`` files."""

    def __init__(self, passed: Input) -> None:
        arrays = {"X": passed.X, **arrays_beside(passed)}
        files = [x for x in arrays.values() if isinstance(x, (str, os.PathLike))]
        self.paths = [Path(file) for file in files]
        self.arrays = {name: _mapped(value, name) for name, value in arrays.items()}
        X = self.arrays["X"]
        if getattr(X, "ndim", 0) != 2 or not X.shape[1] or X.shape[1] % 3:
            raise ChannelError(
                f"X has the shape {np.shape(X)}, (n_samples, 3 n_dof) is needed",
                f"Its columns are {', '.join(feature_names(2))} for two DOFs.",
            )
        self.n_samples = len(X)
        for name, values in self.arrays.items():
            if len(values) != self.n_samples:
                raise ChannelError(
                    f"{name} has {len(values)} samples, X has {self.n_samples}",
                    "Cut both to the same clock.",
                )
        self.chunk_samples = _samples_in_chunk(X.shape[1] // 3)

    def chunks(self) -> Iterator[Chunk]:
        """Slices of the arrays."""
        name = self.paths[0].stem if self.paths else "record"
        for first_row in range(0, self.n_samples, self.chunk_samples):
            rows = slice(first_row, first_row + self.chunk_samples)
            piece = {key: np.asarray(x[rows]) for key, x in self.arrays.items()}
            yield Chunk(input_of_arrays(piece), name, first_row == 0)


def _mapped(value: Any, name: str) -> Any:
    """An array as it is; a NumPy file by path is mapped, not read."""
    if not isinstance(value, (str, os.PathLike)):
        return value
    path = Path(value)
    check_file(path, _ANY_SIZE)
    if path.suffix.lower() != ".npy":
        raise FileFormatError(
            f"{name}={str(path)!r} is not a .npy file", "Save it with numpy.save."
        )
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise unreadable(path, "NumPy", error) from error


_COVARIATE = "covariate "


def arrays_beside(passed: Input) -> dict[str, Any]:
    """The arrays passed with X by one name each, covariates as ``covariate name``."""
    arrays = passed.beside()
    covariates = arrays.pop("covariates", {})
    for name, line in dict(covariates).items():
        arrays[_COVARIATE + name] = line
    return arrays


def input_of_arrays(arrays: Mapping[str, Any]) -> Input:
    """Arrays by name, with X, as input; the inverse of :func:`arrays_beside`."""
    plain = {}
    covariates = {}
    for name, array in arrays.items():
        if name.startswith(_COVARIATE):
            covariates[name.removeprefix(_COVARIATE)] = array
        else:
            plain[name] = array
    return Input(**plain, covariates=covariates)


# -- tables --------------------------------------------------------------------------


class TableSource(FileSource):
    """A file of columns by name: a1.., v1.., s1.., F1.., and t, ag, record."""

    kind: str

    def __init__(self, path: str | os.PathLike[str], reader: ColumnReader) -> None:
        self.path = Path(path)
        self.paths = [self.path]
        self.reader = reader
        check_file(self.path, _ANY_SIZE)
        with self._opened() as file:
            self.columns, self.n_samples = self._contents(file)
        n_dof = reader.n_dof(self.columns, self.path)
        self.chunk_samples = _samples_in_chunk(n_dof)

    def chunks(self) -> Iterator[Chunk]:
        """Rows in the order of the file."""
        wanted = self.reader.wanted(self.columns, self.path)
        with self._opened() as file:
            for i, values in enumerate(self._batches(file, wanted)):
                yield self.reader.chunk(values, self.path.stem, first=i == 0)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """The open file; what its library raises becomes an error with its name."""
        with reading_as(self.path, self.kind), self._open() as file:
            yield file

    def _open(self) -> Any:
        raise NotImplementedError

    def _contents(self, file: Any) -> tuple[list[str], int]:
        """Names of the columns, and the number of samples."""
        raise NotImplementedError

    def _batches(self, file: Any, wanted: list[str]) -> Iterator[Columns]:
        """Columns of consecutive rows."""
        raise NotImplementedError


class ParquetSource(TableSource):
    """A Parquet file, row group after row group."""

    kind = "Parquet"

    def _open(self) -> Any:
        parquet = require("pyarrow.parquet", "files", "Reading Parquet files")
        return parquet.ParquetFile(self.path)

    def _contents(self, file: Any) -> tuple[list[str], int]:
        return list(file.schema_arrow.names), file.metadata.num_rows

    def _batches(self, file: Any, wanted: list[str]) -> Iterator[Columns]:
        for batch in file.iter_batches(
            self.chunk_samples, columns=wanted, use_threads=False
        ):
            yield {
                name: batch.column(name).to_numpy(zero_copy_only=False)
                for name in wanted
            }


class HDF5Source(TableSource):
    """An HDF5 file of ``X`` and ``F``; of ``a, v, s, F``; or of one set a column."""

    kind = "HDF5"

    def _open(self) -> Any:
        return require("h5py", "files", "Reading HDF5 files").File(self.path, "r")

    def _contents(self, file: Any) -> tuple[list[str], int]:
        h5py = require("h5py", "files", "Reading HDF5 files")
        columns = []
        lengths = set()
        self._matrices: dict[str, list[str]] = {}
        for name, values in data_sets(h5py, file).items():
            if "/" in name:
                continue
            require_own(self.path, name, values)
            if values.ndim and len(values) > 1:
                lengths.add(len(values))
            if values.ndim == 1:
                columns.append(name)
            of_matrix = self._columns_of_matrix(name, values)
            if of_matrix:
                self._matrices[name] = of_matrix
                columns += of_matrix
        if len(lengths) != 1:
            raise ChannelError(
                f"The data sets of {self.path} have {sorted(lengths)} samples",
                "Give all of them one clock.",
            )
        return columns, lengths.pop()

    def _columns_of_matrix(self, name: str, values: np.ndarray) -> list[str]:
        """Names of the columns of a matrix that is known by its name; else none."""
        coordinates = self.reader.coordinates
        rate, drift = ("v", "s") if coordinates == "relative" else ("xdot", "x")
        if values.ndim != 2:
            return []
        width = values.shape[1]
        if name == "X" and width % 3 == 0:
            return feature_names(width // 3, coordinates)
        if name in ("a", rate, drift, "F"):
            return [f"{name}{j}" for j in range(1, width + 1)]
        return []

    def _batches(self, file: Any, wanted: list[str]) -> Iterator[Columns]:
        for first_row in range(0, self.n_samples, self.chunk_samples):
            rows = slice(first_row, first_row + self.chunk_samples)
            values: Columns = {}
            for name, columns in self._matrices.items():
                if set(wanted) & set(columns):
                    values.update(zip(columns, file[name][rows].T))
            for name in set(wanted) - set(values):
                values[name] = file[name][rows]
            yield values


# -- several sources -----------------------------------------------------------------


class ListSource(Source):
    """Several files in sequence, each with one record or more."""

    def __init__(self, parts: Sequence[Source]) -> None:
        self.files = [source for source in parts if isinstance(source, FileSource)]
        if len(self.files) < len(parts):
            raise ChannelError(
                "A list of sources holds something that is not a file",
                "Give a list of paths without lists in it, or one iterator that yields"
                " all the pieces.",
            )
        self.n_samples = sum(file.n_samples for file in self.files)
        self.paths = [path for file in self.files for path in file.paths]

    def chunks(self) -> Iterator[Chunk]:
        """Chunks of the files, each its own record."""
        for file in self.files:
            yield from file.chunks()


class IteratorSource(Source):
    """An iterator of tables, pairs (X, F) or records, which can be read once."""

    again = False

    def __init__(self, items: Iterable[object], reader: ColumnReader) -> None:
        self.items = items
        self.reader = reader

    def chunks(self) -> Iterator[Chunk]:
        """Chunks in the order of the iterator."""
        first = True
        for item in self.items:
            yield self.reader.item(item, first)
            first = isinstance(item, Record)


_TABLES: dict[str, type[TableSource]] = {
    ".parquet": ParquetSource,
    ".pq": ParquetSource,
    ".h5": HDF5Source,
    ".hdf5": HDF5Source,
}


def open_source(passed: Input, reader: ColumnReader) -> Source:
    """The source of the data that a user passes to ``fit``.

    Raises
    ------
    ChannelError
        If something was given in addition to data that hold their own.
    FileFormatError
        If a file cannot be read in chunks.
    """
    X = passed.X
    if isinstance(X, (str, os.PathLike)):
        return _open_file(passed, X, reader)
    if isinstance(X, (list, tuple)):
        return _open_list(passed, X, reader)
    refuse_beside(passed, "an iterator, whose items hold them")
    return IteratorSource(X, reader)


def _open_file(
    passed: Input, path: str | os.PathLike[str], reader: ColumnReader
) -> Source:
    suffix = Path(path).suffix.lower()
    if suffix == ".npy":
        return ArraySource(passed)
    if suffix not in _TABLES:
        raise FileFormatError(
            f"{path} has the type {suffix or '(none)'}, which cannot be read in chunks",
            f"Give .npy, {', '.join(_TABLES)}; read a single record with"
            " io.read_record, or a long text file as pandas.read_csv(path,"
            " chunksize=...).",
        )
    refuse_beside(passed, "a table, whose columns hold them")
    return _TABLES[suffix](path, reader)


def _open_list(passed: Input, paths: Sequence[object], reader: ColumnReader) -> Source:
    """Files in sequence, with as many files of forces, or none."""
    forces = passed.F
    if forces is None:
        forces = [None] * len(paths)
    if not isinstance(forces, (list, tuple)) or len(forces) != len(paths):
        raise ChannelError(
            f"{len(paths)} files of X need as many of F",
            "Give a list of paths of the same length.",
        )
    refuse_beside(passed, "a list of files", but="F")
    pairs = [Input(path, force) for path, force in zip(paths, forces)]
    return ListSource([open_source(pair, reader) for pair in pairs])


def refuse_beside(passed: Input, what: str, but: str = "") -> None:
    """Refuse everything except X, ``but`` one name."""
    for name in arrays_beside(passed):
        if name != but:
            raise ChannelError(
                f"{name} was given in addition to {what}", f"Leave {name} out."
            )
