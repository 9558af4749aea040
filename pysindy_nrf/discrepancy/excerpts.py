"""Excerpts of long records: the strongest stretch of every fold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from ..chain.sites import Site
from ..diagnosis.period import mean_period
from ..records.dataset import BlockRows, Dataset
from .folds import FOLDS, Split
from .prepare import PreparedRecords
from .search_data import SearchData


@dataclass(frozen=True)
class ExcerptSettings:
    """How much of a long record a search reads."""

    # Samples on which a search decides. An error reduction is a ratio of powers: more
    # samples make it no larger.
    n_samples: int = 10_000
    # Periods in a window, as records of ten thousand samples have.
    periods_in_window: int = 2


EXCERPTS = ExcerptSettings()


def excerpts(
    records: PreparedRecords, data: SearchData
) -> tuple[PreparedRecords, SearchData]:
    """The records of a search; of long ones the strongest stretch of every fold.

    Each as its own record. Records that are not long come back as they are.
    """
    size = _stretch_length(data)
    if size is None or not records.records[0].has_clock:
        return records, data

    cut_records, fusion = [], []
    segments, blocks = [], []
    n_rows = 0
    for number, fold in enumerate(data.search):
        segment = data.data.segments[fold.segment]
        length = min(size, fold.rows.stop - fold.rows.start)
        start = segment.strongest(fold.rows, length)
        # laws with a memory forget in it where they started
        lead = min(start, next_fast_len(length + length // 10) - length)
        first = segment.valid.start + start - lead
        rows = slice(first, first + lead + length)

        cut_records.append(records.records[fold.segment].rows(rows))
        segments.append(segment.cut(rows, n_rows))
        blocks.append(BlockRows(number, slice(lead, lead + length)))
        fusion.append(records.fusion[fold.segment])
        n_rows += segments[-1].n_samples

    dataset = Dataset(segments, n_rows)
    prepared = PreparedRecords(cut_records, dataset, fusion, clean=records.clean)
    cut = SearchData(dataset, Split(blocks, []), data.known_masses, full=data)
    return prepared, cut


def _stretch_length(data: SearchData) -> int | None:
    """Samples of each stretch; None where that is more than half of the records."""
    first_storey = []
    for fold in data.search:
        motion = data.motion(Site(1), fold.segment)
        first_storey.append(motion.s[fold.rows])
    drift = np.concatenate(first_storey)
    if len(drift) <= EXCERPTS.n_samples:
        return None

    of_periods = EXCERPTS.periods_in_window * FOLDS.n_windows * mean_period([drift])
    size = int(max(EXCERPTS.n_samples, of_periods) / len(data.search))
    return None if 2 * size * len(data.search) > len(drift) else size
