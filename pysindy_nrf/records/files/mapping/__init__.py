"""Mapping of the columns of a file to channels."""

from .expression import GRAMMAR, Expression, line_of, parse
from .mapping_file import MappingFile, read_mapping
from .proposal import Proposal, mapping_text, propose

__all__ = [
    "GRAMMAR",
    "Expression",
    "MappingFile",
    "Proposal",
    "line_of",
    "mapping_text",
    "parse",
    "propose",
    "read_mapping",
]
