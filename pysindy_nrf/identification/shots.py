"""Shots: stretches of records of which a free run is compared with the channels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..chain.model import ChainModel
from ..records.dataset import Dataset, Segment
from .free_runs import OF_FIT, Motion, first_state, motion_of, with_motion
from .run_in import run_in_of
from .spectra import relative_velocities

# Largest number of samples of a shot: an error of the initial state fades within it,
# and its spectra fit into memory.
MAX_SAMPLES_PER_SHOT = 32768


@dataclass(frozen=True)
class Shot:
    """A record, or a part of one: what drives it, its first state, what was measured.

    Attributes
    ----------
    segment : Segment
        Forces and base motion in its valid rows.
    number : int
        Of the record.
    start : ndarray of shape (2, n_dof)
        First displacements (m) and velocities (m/s), relative to the base.
    channels : tuple of str
        ``a1``: absolute acceleration; ``v1``, ``x1``: relative to the base.
    measured : ndarray of shape (n_samples, n_channels)
    weights : ndarray of shape (n_samples, 1)
        Of the rows; a fit does not read those of weight zero.
    """

    segment: Segment
    number: int
    start: np.ndarray
    channels: tuple[str, ...]
    measured: np.ndarray
    weights: np.ndarray

    @property
    def n_samples(self) -> int:
        """Valid rows."""
        return self.segment.n_valid

    @property
    def hold(self) -> str:
        """Course of the forces between the samples."""
        return self.segment.course

    def with_hold(self, hold: str) -> Shot:
        """The shot with a course of the forces, unless the record says its own."""
        if self.segment.hold is not None:
            return self
        return replace(self, segment=replace(self.segment, hold=hold))

    def motion(
        self,
        model: ChainModel,
        start: np.ndarray | None = None,
        forces: Segment | None = None,
    ) -> Motion:
        """Free run: ``a`` (absolute), ``v`` and ``x`` (relative), (n_samples, n_dof).

        Parameters
        ----------
        model : ChainModel
        start : ndarray of shape (2, n_dof), optional
            Initial state, in place of the shot's own.
        forces : Segment, optional
            The record with other forces.
        """
        segment = self.segment if forces is None else forces
        state = self.start if start is None else start

        return motion_of(model, segment, state, OF_FIT)

    def channels_of(self, motion: Mapping[str, np.ndarray]) -> np.ndarray:
        """What the sensors read of a motion, shape of ``measured``."""
        columns = []
        for channel in self.channels:
            dof = int(channel[1:])
            columns.append(motion[channel[0]][:, dof - 1])
        return np.column_stack(columns)

    def simulated_channels(
        self,
        model: ChainModel,
        start: np.ndarray | None = None,
        forces: Segment | None = None,
    ) -> np.ndarray:
        """What the sensors would read of a free run; arguments as for ``motion``."""
        return self.channels_of(self.motion(model, start, forces))

    def run(self, model: ChainModel) -> Segment:
        """Free run as a segment."""
        return with_motion(self.segment, self.motion(model))


def shots_of(data: Dataset, model: ChainModel) -> list[Shot]:
    """Records whose forces are all known; long ones are cut.

    Parameters
    ----------
    data : Dataset
    model : ChainModel
        Its laws with memory pass through the measured motion before each shot. Where
        they begin in motion, the first shot begins when they have forgotten that.
    """
    shots = []
    for number, segment in enumerate(data.segments):
        if np.isnan(segment.F[segment.valid.start]).any():
            continue

        channels = tuple(f"v{j}" for j in range(1, segment.n_dof + 1))
        record = segment.beginning_later(run_in_of(model, segment))
        for rows in _parts(record.valid, MAX_SAMPLES_PER_SHOT):
            passed = rows.start - segment.first_row
            stretch = replace(record, valid=rows, before=passed)
            shot = Shot(
                segment=stretch,
                number=number,
                start=first_state(segment, rows.start),
                channels=channels,
                measured=relative_velocities(stretch),
                weights=np.ones((stretch.n_valid, 1)),
            )
            shots.append(shot)
    return shots


def _parts(rows: slice, longest: int) -> Iterator[slice]:
    """Rows cut into equal parts, as few as do not exceed a length."""
    n_rows = rows.stop - rows.start
    n_parts = -(-n_rows // longest)
    edges = np.linspace(0, n_rows, n_parts + 1).astype(int).tolist()
    for low, high in pairwise(edges):
        yield slice(rows.start + low, rows.start + high)


def halves_of(shots: Sequence[Shot]) -> tuple[list[slice], list[slice]]:
    """Rows of every shot in the first and in the second half of its record."""
    length: dict[int, int] = {}
    for shot in shots:
        length[shot.number] = length.get(shot.number, 0) + shot.n_samples

    first_half = []
    second_half = []
    passed = dict.fromkeys(length, 0)
    for shot in shots:
        middle = length[shot.number] // 2 - passed[shot.number]
        middle = min(max(middle, 0), shot.n_samples)
        first_half.append(slice(0, middle))
        second_half.append(slice(middle, shot.n_samples))
        passed[shot.number] += shot.n_samples
    return first_half, second_half
