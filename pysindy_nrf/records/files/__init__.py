"""Reading and writing of records, frequency responses, tables and forces."""

from .frequency_response import frf_to_features, read_frf
from .mapping import MappingFile, mapping_text, propose, read_mapping
from .reading import Reading, inspect_record, read_excitation, read_record
from .sep005 import from_sep005, to_sep005
from .summary import contents, describe, summary
from .table import Table
from .tables import read_table
from .units import si_factor
from .write import write_forces, write_record, write_table

__all__ = [
    "MappingFile",
    "Reading",
    "Table",
    "contents",
    "describe",
    "frf_to_features",
    "from_sep005",
    "inspect_record",
    "mapping_text",
    "propose",
    "read_excitation",
    "read_frf",
    "read_mapping",
    "read_record",
    "read_table",
    "si_factor",
    "summary",
    "to_sep005",
    "write_forces",
    "write_record",
    "write_table",
]
