"""Reading and writing of files, under the name that users write."""

from .records.files import (
    describe,
    frf_to_features,
    from_sep005,
    inspect_record,
    read_frf,
    read_record,
    read_table,
    to_sep005,
    write_forces,
    write_record,
    write_table,
)

__all__ = [
    "describe",
    "frf_to_features",
    "from_sep005",
    "inspect_record",
    "read_frf",
    "read_record",
    "read_table",
    "to_sep005",
    "write_forces",
    "write_record",
    "write_table",
]
