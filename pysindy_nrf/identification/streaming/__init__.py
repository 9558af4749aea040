"""Data that do not fit in memory: files by path, iterators of tables, and answers that
can be resumed.
"""

from .fit import fit_streamed, is_streamed, partial_fit
from .sources import Chunk, Source, open_source

__all__ = [
    "Chunk",
    "Source",
    "fit_streamed",
    "is_streamed",
    "open_source",
    "partial_fit",
]
