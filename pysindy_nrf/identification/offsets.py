"""Least squares with the unknown zeros of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..diagnosis.offsets import Offsets, offsets_of, with_offsets
from ..equations.errors import balance_errors
from ..exceptions import NRFError
from ..records.dataset import Dataset
from ..records.zero_phase_filter import edges_of
from .displacement_drifts import without_drifts
from .force_corners import without_force_corners
from .force_courses import with_force_courses
from .problem import Estimate, Problem, least_squares

# Samples of a record that are enough to see a constant.
MAX_SAMPLES = 10_000


def least_squares_beside_offsets(
    problem: Problem, data: Dataset
) -> tuple[Estimate, Dataset]:
    """A least-squares estimate, and the data with the offsets estimated with it.

    Where the equations of motion of a record contain constants, these are fitted,
    unless a law for them is declared or the band leaves them out. Notes on the
    constants join the quality of the data.
    """
    data = without_drifts(problem, without_force_corners(problem, data))
    estimate = least_squares(problem, data)
    driven = with_force_courses(estimate.problem, data)
    if driven is not data:
        data = driven
        estimate = least_squares(problem, data)
    if not data.records or not _shows_offsets(problem):
        return estimate, data
    if not offsets_of(estimate.model, _thinned(data, problem)):
        return estimate, data

    try:
        # a constant beside the other columns takes their means out
        centred = least_squares(problem, _centred(data))
        offsets = offsets_of(centred.model, data)
        with_constants = with_offsets(data, offsets)
        beside = least_squares(problem, with_constants)
    except NRFError:
        # the mean is all that scales the chain
        return estimate, data
    if _pooled_error(beside) >= _pooled_error(estimate):
        return estimate, data
    return beside, _with_notes(with_constants, offsets)


def _thinned(data: Dataset, problem: Problem) -> Dataset:
    """Samples that are enough to see a constant, unless laws need all of them."""
    if problem.layout.has_memory:
        return data
    segments = []
    for segment in data.segments:
        step = max(1, segment.n_valid // MAX_SAMPLES)
        segments.append(segment.every(step))
    return replace(data, segments=tuple(segments))


def _centred(data: Dataset) -> Dataset:
    """The data with unknown offsets in every equation of motion."""
    unknown = np.zeros(data.n_dof)
    segments = [replace(segment, offsets=unknown) for segment in data.segments]
    return replace(data, segments=tuple(segments), fuse_apart=None)


def _shows_offsets(problem: Problem) -> bool:
    """Whether constants reach the equations, and no declared law stands for them."""
    low = None if problem.band is None else edges_of(problem.band)[0]
    declared = any(law.variable == "1" for law in problem.every_law)
    return not low and not declared


def _pooled_error(estimate: Estimate) -> float:
    """What the equations of motion leave, percent."""
    errors = balance_errors(estimate.model, estimate.grams)
    return float(errors.loc["pooled", "error"])


def _with_notes(data: Dataset, offsets: Offsets) -> Dataset:
    notes = offsets.notes(data)
    segments = []
    for segment, of_record in zip(data.segments, notes):
        segments.append(replace(segment, quality=segment.quality + of_record))
    return replace(data, segments=tuple(segments))
