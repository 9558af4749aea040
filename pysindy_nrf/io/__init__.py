"""Files in: records and frequency responses, with what was understood said in words."""

from .frf import FrequencyResponse, frequency_response, frf_to_features, read_frf
from .records import Reading, inspect_record, read_record
from .summary import describe, summary
from .table import Table
from .tables import read_table

__all__ = [
    "FrequencyResponse",
    "Reading",
    "Table",
    "describe",
    "frequency_response",
    "frf_to_features",
    "inspect_record",
    "read_frf",
    "read_record",
    "read_table",
    "summary",
]
