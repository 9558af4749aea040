"""Errors of wiring: whether other mappings of the channels close the balances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..chain.model import ChainModel
from ..diagnosis.wiring import mapping_that_closes
from ..records.dataset import Dataset
from ..records.input_arrays import from_arrays
from ..records.record import Record
from .problem import Estimate, Problem, flexible_laws, least_squares

# Peak of a Gaussian drift over its rms.
_PEAK_OVER_RMS = 3


def wiring_error(problem: Problem, model: ChainModel, records: Sequence[Record]) -> str:
    """The error of wiring without which the balances close, in words.

    It is found with laws that follow nearly any force: a chain that is wired wrongly
    does not close with any law, and a law that is missing is no error of wiring.

    Parameters
    ----------
    problem : Problem
    model : ChainModel
        Its visited regions give the size of the drifts.
    records : sequence of Record

    Returns
    -------
    str
        Empty if no mapping closes the balances.
    """
    rms_drifts = {}
    for site, region in model.visited.items():
        peak = max(abs(region.low[1]), abs(region.high[1]))
        rms_drifts[site] = peak / _PEAK_OVER_RMS
    flexible = problem.with_laws(flexible_laws(problem, rms_drifts))
    flexible = replace(flexible, optimizer=None, constraints={})
    n_dof = problem.chain.n_dof
    has_memory = flexible.layout.has_memory

    def from_fused(subset: list[Record]) -> Estimate:
        data = from_arrays(
            subset,
            n_dof=n_dof,
            has_memory=has_memory,
            check=False,
            needs_clock=flexible.needs_clock,
        )
        return least_squares(flexible, data)

    def from_channels(subset: list[Record]) -> Estimate:
        rated = list(map(_with_rates, subset))
        return least_squares(flexible, from_arrays(rated, smooth=False, check=False))

    # a mass that is known to be zero is none that a structure has
    weighed = [j for j, mass in problem.known_masses.items() if mass > 0]
    return mapping_that_closes(list(records), from_fused, from_channels, weighed)


def _with_rates(record: Record) -> Record:
    """The record with differences of displacements as rates, if it has no others."""
    if record.velocity is not None or record.displacement is None:
        return record
    rates = np.gradient(record.displacement, 1.0 / record.fs, axis=0)
    return record.replace(velocity=rates)


def records_of(data: Dataset) -> list[Record]:
    """The records of a data set, or records with the motions that were passed."""
    if data.records:
        return list(data.records)

    records = []
    for segment in data.segments:
        rows = segment.valid
        records.append(
            Record(
                force=segment.F[rows],
                acceleration=segment.a[rows],
                velocity=np.cumsum(segment.v[rows], axis=1),
                displacement=np.cumsum(segment.s[rows], axis=1),
                fs=1.0 / (segment.dt or 1.0),
                name=segment.name,
                base_acceleration=None if segment.ag is None else segment.ag[rows],
            )
        )
    return records
