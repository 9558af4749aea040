"""Data that do not fit in memory: files, iterators, and fits that can be resumed."""

from .chunks import Chunk, ColumnReader
from .fit import fit_pieces, identified, with_records
from .running_sums import RunningSums, StreamSettings
from .sources import Source, open_source

__all__ = [
    "Chunk",
    "ColumnReader",
    "RunningSums",
    "Source",
    "StreamSettings",
    "fit_pieces",
    "identified",
    "open_source",
    "with_records",
]
