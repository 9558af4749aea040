"""Consecutive samples of a source, and the items of iterators as such."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ...exceptions import ChannelError
from ...records.channels import by_record
from ...records.dataset import feature_names, numbered
from ...records.fusion.kinematics import fuse_record
from ...records.input_arrays import Input
from ...records.named_columns import number_of_dofs, table_time
from ...records.record import Record, seconds_of

# 8-byte values in one sum of a hash: an odd number, or a change of sign of all of them
# would be lost.
_VALUES_IN_SUM = 255
# Columns of a table beside those of the DOFs.
_BESIDE_MOTION = ("t", "time", "ag", "record")
_BASE = ("xdot0", "x0")


@dataclass(frozen=True)
class Chunk:
    """Consecutive samples of a source.

    Parameters
    ----------
    samples : Input
        As for ``NRFRegressor.fit``.
    name : str
        Of the record, if there are no record ids.
    first : bool
        Whether a record starts with it; it continues the chunk before it otherwise.
    coordinates : str, optional
        Of X; those of the estimator if None.
    """

    samples: Input
    name: str = "record"
    first: bool = True
    coordinates: str | None = None

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return len(self.samples.X)

    def records(self) -> list[Chunk]:
        """The samples of each record, split by record ids."""
        if self.samples.record is None:
            return [self]
        without_ids = replace(self.samples, record=None)
        parts: list[Chunk] = []
        for name, rows in by_record(self.samples.record, self.n_samples):
            first = self.first or bool(parts)
            samples = _rows_of(without_ids, rows)
            parts.append(Chunk(samples, name, first, self.coordinates))
        return parts


def _rows_of(samples: Input, rows: slice) -> Input:
    """Some rows of everything."""
    beside = samples.beside()
    covariates = beside.pop("covariates", {})
    cut = {name: _cut(value, rows) for name, value in beside.items()}
    lines = {name: _cut(line, rows) for name, line in dict(covariates).items()}
    return Input(_cut(samples.X, rows), **cut, covariates=lines)


def _cut(value: Any, rows: slice) -> Any:
    return value.iloc[rows] if hasattr(value, "iloc") else value[rows]


def content(chunks: Iterable[Chunk], before: int = 0) -> int:
    """Hash of the samples of chunks that follow others.

    8-byte values are summed with wrap-around first, which takes a fifth of the time.
    """
    for chunk in chunks:
        for name, array in _named_arrays(chunk):
            before = zlib.crc32(f"{name} {array.dtype} {array.shape}".encode(), before)
            plain = array.astype(str) if array.dtype.hasobject else array
            flat = plain.ravel(order="K")
            if flat.itemsize == 8:
                starts = np.arange(0, flat.size, _VALUES_IN_SUM)
                flat = np.add.reduceat(flat.view(np.uint64), starts)
            before = zlib.crc32(flat.view(np.uint8).data, before)
    return before


def _named_arrays(chunk: Chunk) -> Iterator[tuple[str, np.ndarray]]:
    """Everything in a chunk, as arrays."""
    values = vars(chunk.samples) | vars(chunk)
    del values["samples"]
    covariates = values.pop("covariates") or {}
    for name, value in values.items():
        yield name, np.asarray(value)
    for name, line in dict(covariates).items():
        yield f"covariate {name}", np.asarray(line)


# -- items of iterators --------------------------------------------------------------


@dataclass(frozen=True)
class ColumnReader:
    """Reads named columns: a1.., v1.., s1.., F1.., t, ag, record, and covariates.

    Parameters
    ----------
    covariates : tuple of str
        Covariates that laws read.
    coordinates : {"relative", "absolute"}
    """

    covariates: tuple[str, ...] = ()
    coordinates: str = "relative"

    def n_dof(self, columns: Iterable[str], where: object) -> int:
        """DOFs of named columns: those of a1, a2, ..."""
        n = number_of_dofs(columns)
        if not n:
            raise ChannelError(
                f"{where} has no columns a1, a2, ...",
                f"Name them {', '.join(feature_names(2))}, F1, F2.",
            )
        return n

    def wanted(self, columns: Sequence[str], where: object) -> list[str]:
        """The columns to read; an error names those that are missing."""
        n_dof = self.n_dof(columns, where)
        needed = feature_names(n_dof, self.coordinates) + list(self.covariates)
        forces = numbered("F", n_dof)
        if not set(columns).isdisjoint(forces):
            needed += forces
        missing = [name for name in needed if name not in columns]
        if missing:
            plural = "s" if len(missing) > 1 else ""
            raise ChannelError(
                f"{where} lacks the column{plural} {', '.join(missing[:6])}",
                "A force known to be zero is a column of zeros, an unknown one of NaN.",
            )
        beside = list(_BESIDE_MOTION)
        if self.coordinates == "absolute":
            beside += _BASE
        return needed + [name for name in beside if name in columns]

    def chunk(self, values: Mapping[str, np.ndarray], name: str, first: bool) -> Chunk:
        """Named columns as a chunk."""
        n_dof = self.n_dof(values, name)
        motions = feature_names(n_dof, self.coordinates)
        if self.coordinates == "absolute" and set(_BASE) <= set(values):
            motions += _BASE
            X: pd.DataFrame | np.ndarray = pd.DataFrame(
                _some_of(values, motions), copy=False
            )
        else:
            X = _side_by_side(values, motions)

        F = None
        if "F1" in values:
            F = _side_by_side(values, numbered("F", n_dof))
        samples = Input(
            X,
            F,
            record=values.get("record"),
            time=values.get("t", values.get("time")),
            base_acceleration=values.get("ag"),
            covariates=_some_of(values, self.covariates),
        )
        return Chunk(samples, name, first)

    def item(self, item: object, first: bool = True) -> Chunk:
        """One item of an iterator as a chunk.

        Raises
        ------
        ChannelError
            If it is no table, pair (X, F), array or Record.
        """
        if isinstance(item, Chunk):
            return item
        if isinstance(item, Record):
            return record_chunk(item)
        if hasattr(item, "columns"):
            columns = [str(column) for column in item.columns]
            wanted = self.wanted(columns, "The table")
            table = cast(pd.DataFrame, item)
            values = {column: table[column].to_numpy() for column in wanted}
            time = table_time(table)
            if time is not None:
                values["t"] = time
            return self.chunk(values, "record", first)
        if isinstance(item, tuple) and len(item) == 2:
            X, F = item
            return Chunk(Input(X, F, time=table_time(X)), first=first)
        if isinstance(item, np.ndarray):
            return Chunk(Input(item), first=first)
        raise ChannelError(
            f"The iterator gave {type(item).__name__}",
            "It must give DataFrames, pairs (X, F) or Records.",
        )


def record_chunk(record: Record) -> Chunk:
    """A record, fused, as one chunk."""
    fused = fuse_record(record)
    samples = Input(
        fused.motion,
        fused.force,
        time=np.asarray(fused.time),
        base_acceleration=fused.ag,
        covariates=dict(record.covariates),
    )
    return Chunk(samples, record.name, coordinates="relative")


def _some_of(
    values: Mapping[str, np.ndarray], names: Iterable[str]
) -> dict[str, np.ndarray]:
    return {name: values[name] for name in names}


def _side_by_side(values: Mapping[str, np.ndarray], names: Iterable[str]) -> np.ndarray:
    """Columns as a matrix, in single precision if all of them are."""
    columns = [values[name] for name in names]
    single = np.result_type(*columns) == np.float32
    dtype = np.float32 if single else np.float64
    return np.stack(columns, dtype=dtype, casting="unsafe").T


def seconds_since(time: ArrayLike, origin: np.generic | float) -> np.ndarray:
    """Times as seconds since an origin of the same kind; numbers are seconds."""
    array: np.ndarray = np.asarray(time)
    if array.dtype.kind in "mM":
        elapsed: np.ndarray = array - np.asarray(origin)
        return elapsed / np.timedelta64(1, "ns") * 1e-9
    return seconds_of(array, "time")
