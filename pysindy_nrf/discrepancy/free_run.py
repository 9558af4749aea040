"""Free-run error of a model over held-out pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from ..equations.errors import free_run_by_either
from ..exceptions import DivergenceError, NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from .excerpts import EXCERPTS


@dataclass(frozen=True)
class FreeRunSettings:
    """How far a model runs alone."""

    # Periods in a window of a free run: long enough to accumulate a wrong frequency,
    # short of the loss of phase.
    periods: int = 10
    # Samples of a window at least.
    least_samples: int = 8
    # Samples from the start of a record that the final model runs, in multiples of the
    # samples of a search: unstable models crawl.
    searches_from_start: int = 3


FREE_RUN = FreeRunSettings()


def free_run_error(
    model: ChainModel, data: Dataset, blocks: Sequence[BlockRows]
) -> float:
    """Free-run error of the displacements over windows of some blocks, percent NRMSE.

    NaN where the model cannot run, infinite where its run diverges.
    """
    if (model.masses <= 0).any():
        return float("nan")

    n_rows = sum(b.rows.stop - b.rows.start for b in blocks)
    every = -(-n_rows // EXCERPTS.n_samples)
    missed, moved = np.zeros(model.n_dof), np.zeros(model.n_dof)
    for block in blocks:
        segment = data.segments[block.segment]
        if segment.dt is None or np.isnan(segment.F[segment.valid.start]).any():
            return float("nan")
        for rows in _windows(segment, block, every):
            try:
                run, *_ = free_run_by_either(model, segment, rows, segment.dt)
            except DivergenceError:
                return float("inf")
            except NRFError:
                return float("nan")
            x = np.cumsum(segment.s[rows], axis=1)
            missed += ((run.displacement - x) ** 2).sum(axis=0)
            moved += ((x - x.mean(axis=0)) ** 2).sum(axis=0)

    if not (moved > 0).all():
        return float("nan")
    return float(100.0 * np.sqrt(np.mean(missed / moved)))


def _windows(segment: Segment, block: BlockRows, every: int) -> list[slice]:
    """Rows of the windows of a block, every so many of them."""
    drift = segment.s[segment.valid][block.rows, 0].astype(float)
    # of the first drift, two in a period
    crossings = max(1, int(np.diff(drift > drift.mean()).sum()))
    size = int(FREE_RUN.periods * 2 * len(drift) / crossings)
    size = max(FREE_RUN.least_samples, min(len(drift), size))

    first = segment.valid.start
    last = block.rows.stop - size
    starts = range(block.rows.start, last + 1, every * size)
    return [slice(first + start, first + start + size) for start in starts]
