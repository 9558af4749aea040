"""Parquet files, in and out."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...common.atomic import atomic_write
from ...common.extras import require
from ...exceptions import ChannelError, FileFormatError
from .attributes import SCHEMA, Attributes
from .table import MAX_BYTES, Table, check_file, check_size, unreadable

_KEY = SCHEMA.encode()


def read_parquet(path: Path, max_bytes: int = MAX_BYTES) -> Table:
    """Read the columns of a Parquet file that hold numbers, times or texts; a time index becomes the column ``t``."""
    check_file(path, max_bytes)
    pyarrow = require("pyarrow", "files", "Reading Parquet files")
    types = require("pyarrow.types", "files", "Reading Parquet files")
    parquet = require("pyarrow.parquet", "files", "Reading Parquet files")
    try:
        file = parquet.ParquetFile(path)
        schema, about = file.schema_arrow, file.metadata
        twice = [name for name, count in Counter(schema.names).items() if count > 1]
        if twice:
            raise FileFormatError(f"{path} has two columns named {twice[0]!r}", "Rename one.")
        texts = [f.name for f in schema if types.is_string(f.type) or types.is_large_string(f.type)]
        kept = texts + [f.name for f in schema if types.is_primitive(f.type) or types.is_dictionary(f.type)]
        declared = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
        check_size(path, max(declared, 8 * about.num_rows * len(kept)), max_bytes)
        # dictionaries keep a text that repeats from being unpacked once for each row
        held = parquet.read_table(path, columns=[n for n in schema.names if n in kept], read_dictionary=texts)
        attributes = (schema.metadata or {}).get(_KEY)
        frame = held.to_pandas()
    except FileFormatError:
        raise
    except (pyarrow.ArrowException, OSError, ValueError, TypeError, KeyError) as error:
        raise unreadable(path, "Parquet", error) from error
    variables = {}
    if frame.index.name in ("t", "time") or isinstance(frame.index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        variables["t"] = frame.index.to_numpy()
    for name in frame.columns:
        column = frame[name]
        if hasattr(column.dtype, "numpy_dtype") and column.dtype.kind in "biuf":
            column = column.astype(float)  # nullable numbers
        variables[str(name)] = column.to_numpy()
    own = None if attributes is None else Attributes.from_json(attributes, path)
    return Table(path, "Parquet", variables, attributes=own)


def write_parquet(path: Path, columns: dict[str, np.ndarray], attributes: Attributes | None = None) -> None:
    """Write columns to a Parquet file."""
    pyarrow: Any = require("pyarrow", "files", "Writing Parquet files")
    parquet: Any = require("pyarrow.parquet", "files", "Writing Parquet files")
    try:
        # from_pandas=False: NaN stays NaN, it is no missing value
        table = pyarrow.table({name: pyarrow.array(line, from_pandas=False) for name, line in columns.items()})
    except (pyarrow.ArrowException, UnicodeError) as error:
        raise ChannelError(f"{path}: a column cannot be written: {error}", "Rename it.") from error
    if attributes is not None:
        table = table.replace_schema_metadata({_KEY: attributes.to_json().encode()})
    with atomic_write(path, "wb") as file:
        parquet.write_table(table, file)
