"""Reading and writing of records, frequency responses, tables and forces."""

from .files import read_table
from .frf import FrequencyResponse, frequency_response, frf_to_features, read_frf
from .mapping import MappingFile, read_mapping
from .reading import Reading, inspect_record, read_excitation, read_record
from .sep005 import from_sep005, to_sep005
from .summary import describe, summary
from .table import Table
from .write import write_forces, write_record, write_table

__all__ = [
    "FrequencyResponse",
    "MappingFile",
    "Reading",
    "Table",
    "describe",
    "frequency_response",
    "frf_to_features",
    "from_sep005",
    "inspect_record",
    "read_excitation",
    "read_frf",
    "read_mapping",
    "read_record",
    "read_table",
    "summary",
    "to_sep005",
    "write_forces",
    "write_record",
    "write_table",
]
