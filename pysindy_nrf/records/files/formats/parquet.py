"""Parquet files."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from ....common.lazy import require
from ..attributes import SCHEMA, Attributes
from ..table import (
    MAX_BYTES,
    Table,
    check_size,
    reading_as,
    two_columns_of_one_name,
)

if TYPE_CHECKING:
    from pyarrow import DataType
    from pyarrow.parquet import FileMetaData

ATTRIBUTES_KEY = SCHEMA.encode()  # of the metadata of a record written here


def read_parquet(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the columns of a Parquet file that hold numbers, times or texts.

    A time index becomes the column ``t``.
    """
    types = require("pyarrow.types", "files", "Reading Parquet files")
    parquet = require("pyarrow.parquet", "files", "Reading Parquet files")

    with reading_as(path, "Parquet"):
        file = parquet.ParquetFile(path)
        schema = file.schema_arrow
        _require_different_names(path, schema.names)

        texts = [field.name for field in schema if _is_text(types, field.type)]
        wanted = [field.name for field in schema if _is_channel(types, field.type)]
        check_size(path, _declared_size(file.metadata, len(wanted)), max_bytes)
        # dictionaries keep a repeated text from being unpacked once for each row
        arrow = parquet.read_table(path, columns=wanted, read_dictionary=texts)
        frame = arrow.to_pandas()

    attributes = _attributes(path, schema.metadata or {})
    return Table(path, "Parquet", _columns(frame), attributes=attributes)


def _require_different_names(path: Path, names: list[str]) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise two_columns_of_one_name(path, name)


def _attributes(path: Path, metadata: dict[bytes, bytes]) -> Attributes | None:
    """Attributes of a record that was written here."""
    text = metadata.get(ATTRIBUTES_KEY)
    return None if text is None else Attributes.from_json(text, path)


def _is_text(types: ModuleType, kind: DataType) -> bool:
    return types.is_string(kind) or types.is_large_string(kind)


def _is_channel(types: ModuleType, kind: DataType) -> bool:
    """Whether a column holds numbers, times or texts, and nothing nested."""
    is_plain = types.is_primitive(kind) or types.is_dictionary(kind)
    return is_plain or _is_text(types, kind)


def _declared_size(metadata: FileMetaData, n_columns: int) -> int:
    """Bytes that a file unpacks to, as its metadata declare and as doubles at least."""
    groups = range(metadata.num_row_groups)
    declared = sum(metadata.row_group(i).total_byte_size for i in groups)
    return max(declared, 8 * metadata.num_rows * n_columns)


def _columns(frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """Columns of a table by name, with its time index."""
    columns = {}
    index = frame.index
    is_stamped = isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))
    if is_stamped or index.name in ("t", "time"):
        columns["t"] = index.to_numpy()

    for name in frame.columns:
        column = frame[name]
        is_nullable = hasattr(column.dtype, "numpy_dtype")
        if is_nullable and column.dtype.kind in "biuf":
            column = column.astype(float)
        columns[str(name)] = column.to_numpy()
    return columns
