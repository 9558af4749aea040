"""The part of some records that a diagnosis may look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...records.dataset import Dataset, Segment
from ...records.zero_phase_filter import ZeroPhaseFilter
from ..residual import Filters
from .noise_floor import SitesAndThinning
from .settings import RESIDUAL

# Columns of the motion by group, for each record; by the numbers of the records, and
# by the sites of the chain and the thinning.
ColumnGroups = dict[str, list[np.ndarray]]
MotionColumns = dict[SitesAndThinning, dict[tuple[int, ...], ColumnGroups]]


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
    filters : sequence of ZeroPhaseFilter or None
        Of each record; the residual passes it.
    known_masses : mapping of int to float
        kg.
    columns : dict
        Columns of the motion, which do not depend on the model, for the next one.
    """

    records: Dataset
    pieces: Sequence[Segment]
    record: Sequence[int]
    filters: Filters
    known_masses: Mapping[int, float] = field(default_factory=dict)
    columns: MotionColumns = field(default_factory=dict)

    def cut(
        self, n_samples: int = RESIDUAL.n_samples
    ) -> tuple[Dataset, list[ZeroPhaseFilter | None], list[int]]:
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
