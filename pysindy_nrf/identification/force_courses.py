"""The course of forces between their samples, where a record does not say it."""

import warnings
from dataclasses import replace

import numpy as np

from ..equations.errors import balance_errors
from ..exceptions import NRFError, NRFWarning
from ..records.dataset import Dataset, Segment
from ..records.hold import BAND_LIMITED, HOLD_IN_WORDS, HOLDS
from ..records.quality import QualityNote
from .problem import Problem, least_squares

# Samples of each record on which courses are compared, those of most energy.
MAX_SAMPLES = 4096
# Records of a series are driven by one apparatus.
MAX_RECORDS = 4
# Share of the squared residual with band-limited forces that another course must stay
# below. Of chains with displacements alone and forces up to a tenth and a fifth of the
# sampling rate, straight forces leave 0.05 of it without noise, and make no difference
# at 1 %, where a fusion that rounds off a blow leaves 0.7. Held ones leave 0.2 to 0.3
# at 1 % of noise; measured records 0.99 and more. A law that relaxes and is missing
# makes half a sample of delay leave 0.65.
CLEARLY_LESS = {"linear": 0.3, "zero": 0.5}
# Percent of the forces that another course may leave: a law that is missing leaves 7 to
# 10 in chains of the battery, where half a sample of delay stands in for it.
MOST_LEFT = 5.0


def with_force_courses(problem: Problem, data: Dataset) -> Dataset:
    """Data whose forces are band-limited ones, as the equations of motion ask for.

    Records that say the course of their forces keep it. The forces of the others are
    taken as band-limited, unless the equations close clearly better where they are
    straight, or constant between samples: then those that act alike take their place.
    """
    unknown = [segment for segment in data.segments if segment.hold is None]
    if not unknown or not data.forced:
        return data
    hold = _course_that_closes(problem, data, unknown)
    if hold == BAND_LIMITED:
        return data

    noted = [_with_note(segment, hold) for segment in data.segments]
    records = []
    for record in data.records:
        records.append(record.replace(hold=record.hold or hold))
    return _taken_as(hold, replace(data, segments=noted, records=tuple(records)))


def _course_that_closes(problem: Problem, data: Dataset, unknown: list[Segment]) -> str:
    """The course of the forces with which least squares leaves clearly least."""
    excerpts = []
    for segment in unknown[:MAX_RECORDS]:
        size = min(MAX_SAMPLES, segment.n_valid)
        first = segment.strongest(slice(0, segment.n_valid), size)
        start = segment.valid.start + first
        excerpts.append(segment.cut(slice(start, start + size), 0))

    plain = replace(problem, optimizer=None)
    remaining: dict[str, float] = {}
    for hold in HOLDS:
        driven = [excerpt.with_band_limited_forces(hold) for excerpt in excerpts]
        remaining[hold] = _residual(plain, replace(data, segments=driven))
    # a force that comes late by a sample or more is not held
    late = [replace(s, F=np.vstack([s.F[:1], s.F[:-1]])) for s in excerpts]
    remaining["late"] = _residual(plain, replace(data, segments=late))

    best = min(remaining, key=remaining.__getitem__)
    limit = CLEARLY_LESS.get(best, 0.0) * remaining[BAND_LIMITED]
    closes = remaining[best] < min(limit, MOST_LEFT**2)
    return best if closes else BAND_LIMITED


def _residual(problem: Problem, data: Dataset) -> float:
    """Squared pooled error of the balances by least squares; infinite if none."""
    try:
        with warnings.catch_warnings(action="ignore", category=NRFWarning):
            estimate = least_squares(problem, data)
            errors = balance_errors(estimate.model, estimate.grams)
    except NRFError:
        return np.inf
    return float(errors.loc["pooled", "error"]) ** 2


def _taken_as(hold: str, data: Dataset) -> Dataset:
    """Data whose forces take another course, as the band-limited ones alike."""
    segments = []
    for segment in data.segments:
        if segment.hold is None:
            segment = segment.with_band_limited_forces(hold)
        segments.append(segment)

    again = data.fuse_apart
    if again is None:
        return replace(data, segments=tuple(segments))
    return replace(
        data, segments=tuple(segments), fuse_apart=lambda: _taken_as(hold, again())
    )


def _with_note(segment: Segment, hold: str) -> Segment:
    if segment.hold is not None:
        return segment
    message = (
        f"The equations of motion close where the force is {HOLD_IN_WORDS[hold]}; it is"
        f" taken so. Record(hold={hold!r}) says it."
    )
    note = QualityNote("hold", message, record=segment.name)
    return replace(segment, quality=(*segment.quality, note))
