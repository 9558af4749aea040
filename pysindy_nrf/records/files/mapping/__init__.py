"""Mapping of the columns of a file to channels."""

from .column_facts import ColumnFacts, column_facts
from .expression import GRAMMAR, Expression, line_of, parse
from .mapping_file import MappingFile, read_mapping
from .proposal import (
    Proposal,
    is_element_alone,
    is_over_frequency,
    lacks_clock,
    lacks_motion,
    mapping_text,
    propose,
)

__all__ = [
    "GRAMMAR",
    "ColumnFacts",
    "Expression",
    "MappingFile",
    "Proposal",
    "column_facts",
    "is_element_alone",
    "is_over_frequency",
    "lacks_clock",
    "lacks_motion",
    "line_of",
    "mapping_text",
    "parse",
    "propose",
    "read_mapping",
]
