"""Reading and writing of records, frequency responses, tables and forces."""

from .frequency_response import frf_to_features
from .frf_files import read_frf
from .reading import inspect_record, read_record
from .sep005 import from_sep005, to_sep005
from .summary import describe
from .tables import read_table
from .write import write_forces, write_record, write_table

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
