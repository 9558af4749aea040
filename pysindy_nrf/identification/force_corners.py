"""Forces behind a high-pass filter, with accelerations that have passed one.

No second channel witnesses a force. Where accelerometers stand behind the first-order
filter of their amplifier, the load cell mostly does, too; the equations of motion then
close much better with the force before such a filter.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..diagnosis.residual import residual_of
from ..exceptions import NRFError, NRFWarning
from ..records.checks.corners import before_filter, with_force_before_filter
from ..records.dataset import Dataset, Segment
from ..records.quality import QualityNote
from .problem import Problem, least_squares

# Share of the squared residual that a force before its filter may leave at most: it
# must explain most of what the model misses.
LEFT_BY_A_CORNER = 0.5

# Corners by DOF, Hz.
Corners = Mapping[int, float]


def without_force_corners(problem: Problem, data: Dataset) -> Dataset:
    """The data with forces before high-pass filters, if accelerations have passed one.

    Notes on the corners join the quality of the data.
    """
    corners = force_corners(problem, data)
    return with_forces_before_filters(data, corners) if corners else data


def force_corners(problem: Problem, data: Dataset) -> Corners:
    """Corners of the forces with which the equations of motion close better.

    Parameters
    ----------
    problem : Problem
        Its laws; further ones make the question safer.
    data : Dataset
        Nothing is asked where no note names the corner of an acceleration.
    """
    of_accelerations = []
    for note in data.quality:
        if note.kind == "corner" and note.channel.startswith("a"):
            of_accelerations.append(note.size)
    if not of_accelerations:
        return {}

    step = float(np.median(of_accelerations))
    corners: dict[int, float] = {}
    with warnings.catch_warnings(action="ignore", category=NRFWarning):
        for dof in data.forced:
            corner = _corner(problem, _before_filters(data, corners), dof, step)
            if corner > 0:
                corners[dof] = corner
    return corners


def _corner(problem: Problem, data: Dataset, dof: int, step: float) -> float:
    """The corner of one force, Hz; zero if it has none.

    The squared residual of its equation of motion is a parabola of the corner.
    """
    try:
        squares = []
        for corner in (0.0, step, 2 * step):
            changed = _before_filters(data, {dof: corner} if corner else {})
            squares.append(_squares(problem, changed, dof))
    except NRFError:
        # nothing scales the chain, or a law cannot be told from another
        return 0.0

    bend = squares[0] - 2 * squares[1] + squares[2]
    slope = -0.5 * (3 * squares[0] - 4 * squares[1] + squares[2])
    if not bend > 0:
        return 0.0
    corner = -slope / bend * step
    least = squares[0] - 0.5 * slope**2 / bend
    return corner if least < LEFT_BY_A_CORNER * squares[0] else 0.0


def _squares(problem: Problem, data: Dataset, dof: int) -> float:
    """Squared residual of the equation of motion of a DOF, N^2."""
    model = least_squares(problem, data).model
    residual = residual_of(model, data, problem.filters(data))
    return float(sum(np.nansum(line**2) for line in residual.at_place(f"dof {dof}")))


# -- data with other forces ----------------------------------------------------------


def _before_filters(data: Dataset, corners: Corners) -> Dataset:
    """The data with some forces before their filters."""
    if not corners:
        return data
    segments = tuple(_unfiltered(segment, corners) for segment in data.segments)
    return replace(data, segments=segments)


def _unfiltered(segment: Segment, corners: Corners) -> Segment:
    force = np.array(segment.F, dtype=float)
    for dof, corner in corners.items():
        force[:, dof - 1] = before_filter(force[:, dof - 1], corner, segment.step)
    return replace(segment, F=force)


def with_forces_before_filters(data: Dataset, corners: Corners) -> Dataset:
    """The data and their records with some forces before their filters, and notes."""
    data = _before_filters(data, corners)
    records = list(data.records)
    notes = []
    for dof, corner in corners.items():
        records = [with_force_before_filter(r, dof, corner) for r in records]
        message = (
            f"F{dof} has passed a high-pass filter of first order with its corner at"
            f" {corner:.3g} Hz, as the equations of motion show. The force before it"
            " is used"
        )
        witness = "equations of motion"
        notes.append(QualityNote("corner", message, f"F{dof}", "", corner, witness))

    segments = []
    for segment in data.segments:
        of_record = tuple(replace(note, record=segment.name) for note in notes)
        segments.append(replace(segment, quality=segment.quality + of_record))

    changed = replace(data, segments=tuple(segments), records=tuple(records))
    again = data.fuse_apart
    if again is None:
        return changed
    return replace(changed, fuse_apart=lambda: _before_filters(again(), corners))
