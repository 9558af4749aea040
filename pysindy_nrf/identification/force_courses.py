"""The course of forces between their samples, where a record does not say it."""

from dataclasses import replace

import numpy as np

from ..equations.balances import rows_of, whole_block
from ..equations.triangular import scaled_cholesky
from ..records.dataset import Dataset, Segment
from ..records.hold import BAND_LIMITED, HOLD_IN_WORDS, HOLDS, band_limited
from ..records.quality import QualityNote
from ..records.zero_phase_filter import ZeroPhaseFilter
from .problem import Problem

# A force that comes late by a sample or more is not held.
LATE = "late"
COURSES = (*HOLDS, LATE)
# Samples of each record on which courses are compared, those of most energy.
MAX_SAMPLES = 1024
# The energy is read at every eighth sample: what a blow leaves lasts longer.
THINNING = 8
# Records of a series are driven by one apparatus.
MAX_RECORDS = 4
# Share of the squared residual with band-limited forces that another course must stay
# below. Of 59 chains with forces up to a fifth of the sampling rate that are really
# band-limited, no other course leaves less than 0.94 of it. Straight ones leave 0.004
# without noise and make no difference at 1 %; held ones leave 0.01 at 0.1 % of noise
# and 0.2 to 1 at 1 %. A fusion that rounds off a blow leaves 0.7, and a law that
# relaxes and is missing makes half a sample of delay leave 0.65.
CLEARLY_LESS = {"linear": 0.3, "zero": 0.5}
# Share of the squared forces that another course may leave: a law that is missing
# leaves 0.07 to 0.1 of the forces in chains of the battery, where half a sample of
# delay stands in for it.
MOST_LEFT = 0.05**2
# Shares of the squared forces below it are round-off of sums of products.
ROUND_OFF = 1e-12


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
        thinned = segment.every(THINNING)
        first = thinned.strongest(slice(0, thinned.n_valid), size // THINNING)
        start = segment.valid.start + min(first * THINNING, segment.n_valid - size)
        excerpts.append(segment.cut(slice(start, start + size), 0))

    shares = _unexplained_shares(problem, replace(data, segments=excerpts))
    best = min(shares, key=shares.__getitem__)
    limit = CLEARLY_LESS.get(best, 0.0) * shares[BAND_LIMITED]
    closes = shares[best] < min(limit, MOST_LEFT)
    return best if closes else BAND_LIMITED


def _unexplained_shares(problem: Problem, data: Dataset) -> dict[str, float]:
    """Share of the squared forces that each course leaves, by least squares.

    Each equation of motion with a force is solved by itself, with its own mass: the
    courses differ in its right-hand side alone.
    """
    layout = problem.layout
    products: dict[int, np.ndarray] = {}
    for segment, band_pass in zip(data.segments, problem.filters(data)):
        block = whole_block(segment, layout, band_pass)
        forces = _forces_of_courses(segment, band_pass)
        for j in set(segment.forced) - set(segment.unknown):
            rows = rows_of(layout, layout.group((j,)), block, {})
            columns = np.concatenate([rows[:-1], forces[:, :, j - 1]])
            products[j] = products.get(j, 0.0) + columns @ columns.T

    if not products:
        return dict.fromkeys(COURSES, 1.0)

    n_courses = len(COURSES)
    unexplained = np.zeros(n_courses)
    total = np.zeros(n_courses)
    for gram in products.values():
        last = scaled_cholesky(gram)[:, -n_courses:]
        unexplained += np.sum(last[-n_courses:] ** 2, axis=0)
        total += np.sum(last**2, axis=0)
    shares = np.maximum(unexplained / total, ROUND_OFF)
    return dict(zip(COURSES, shares.tolist()))


def _forces_of_courses(
    segment: Segment, band_pass: ZeroPhaseFilter | None
) -> np.ndarray:
    """Valid forces of each course, (n_courses, n_samples, n_dof)."""
    force = segment.F[segment.valid]
    forces = [band_limited(force, hold) for hold in HOLDS]
    forces.append(np.vstack([force[:1], force[:-1]]))
    if band_pass is not None:
        forces = [band_pass.apply(course) for course in forces]
    return np.array(forces)


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
