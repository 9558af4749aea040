"""The part of some records that a diagnosis may look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...records.dataset import Dataset, Segment
from .settings import RESIDUAL


@dataclass(frozen=True, eq=False)
class DiagnosedData:
    """Pieces of records in which a residual is looked at.

    Attributes
    ----------
    records : Dataset
        Laws with a memory follow their path along these.
    pieces : sequence of Segment
        Contiguous parts of the records.
    record : sequence of int
        Number of the record of each piece.
    filters : sequence
        Of each record; the residual passes it.
    known_masses : mapping of int to float
        kg.
    made : dict
        Columns that do not depend on the model, for the next one.
    """

    records: Dataset
    pieces: Sequence[Segment]
    record: Sequence[int]
    filters: Sequence[Any]
    known_masses: Mapping[int, float] = field(default_factory=dict)
    made: dict[Any, Any] = field(default_factory=dict)

    def cut(
        self, n_samples: int = RESIDUAL.n_samples
    ) -> tuple[Dataset, list[Any], list[int]]:
        """The pieces cut to so many samples in all, their filters and their records.

        Pieces much shorter than the longest of a record are left out.
        """
        total = sum(piece.n_valid for piece in self.pieces)
        share = min(1.0, n_samples / max(total, 1))
        longest: dict[int, int] = {}
        for number, piece in zip(self.record, self.pieces):
            longest[number] = max(longest.get(number, 0), piece.n_valid)

        pieces, numbers = [], []
        for number, piece in zip(self.record, self.pieces):
            if 4 * piece.n_valid >= longest[number]:
                start = piece.valid.start
                stop = start + int(np.ceil(share * piece.n_valid))
                pieces.append(replace(piece, valid=slice(start, stop)))
                numbers.append(number)
        filters = [self.filters[number] for number in numbers]
        return Dataset(pieces, self.records.n_samples), filters, numbers
