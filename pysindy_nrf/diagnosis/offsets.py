"""Wrong zeros of sensors: constants that the equations of motion lack.

Every displacement, force and DC accelerometer has an unknown zero, which leaves a
constant in the equations it stands in. So does a dead load. The constants are nuisance:
they are taken out of the data, and reported as the quality of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..chain.model import ChainModel
from ..records.dataset import Dataset, Segment
from ..records.quality import QualityNote
from .period import mean_period
from .residual import residual_of

# Windows of a record from whose scatter the error of a constant is taken, fewer of
# which are too few, and samples of a window at least.
N_WINDOWS = 20
LEAST_WINDOWS = 4
LEAST_SAMPLES = 16
# Standard errors by which a constant differs from zero: one in 16,000 does by chance.
STANDARD_ERRORS = 4.0
# Constant over the rms of inertia and force of its equation, below which it changes
# nothing: masses and stiffnesses move by its square.
LEAST_SHARE = 1e-3
# Ratio of the means in weak and in strong periods of the motion, within which a
# constant is the same at every amplitude; twice their error apart they differ. Of a law
# that is missing, such as a one-sided contact, it grows with the amplitude. So many
# periods are looked at, at most.
SAME_AT_EVERY_AMPLITUDE = 0.5
MAX_PERIODS = 1000


@dataclass(frozen=True, eq=False)
class Offsets:
    """Constants of the equations of motion of some records.

    Attributes
    ----------
    forces : ndarray of shape (n_records, n_dof)
        What the measured forces are too large by, N; zero where none is sure.
    shares : ndarray of shape (n_records, n_dof)
        The same over the rms of the inertia of each equation, or of its force.
    """

    forces: np.ndarray
    shares: np.ndarray

    def __bool__(self) -> bool:
        return bool(self.forces.any())

    def notes(self, data: Dataset) -> list[tuple[QualityNote, ...]]:
        """Notes on each record.

        Parameters
        ----------
        data : Dataset
        """
        every = []
        for segment, forces, shares in zip(data.segments, self.forces, self.shares):
            notes = []
            for j in np.flatnonzero(forces).tolist():
                dof = j + 1
                size = f"{forces[j]:.3g} {segment.units.force}"
                message = (
                    f"the equation of motion of DOF {dof} holds a constant of"
                    f" {size} ({100 * shares[j]:.2g} % of its inertia):"
                    " a wrong zero of a displacement or force there, or a dead load."
                    " It is taken out"
                )
                where = (f"dof {dof}", segment.name)
                notes.append(QualityNote("offset", message, *where, forces[j]))
            every.append(tuple(notes))
        return every


def offsets_of(
    model: ChainModel, data: Dataset, pieces: Sequence[tuple[int, Segment]] = ()
) -> Offsets:
    """The constants that a model leaves in the equations of motion.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
    pieces : sequence of (int, Segment), optional
        Parts of the records that are looked at, with the numbers of their records; all
        of each record if none are given.
    """
    chosen = list(pieces) or list(enumerate(data.segments))
    parts = Dataset([piece for _, piece in chosen], data.n_samples)
    residuals = residual_of(model, parts).balance

    shape = (len(data.segments), model.n_dof)
    forces, shares = np.zeros(shape), np.zeros(shape)
    for number in dict.fromkeys(number for number, _ in chosen):
        pieces_of_record = []
        for (record, piece), residual in zip(chosen, residuals):
            if record == number:
                pieces_of_record.append(_Piece(model, piece, residual))
        forces[number], shares[number] = _sure_constants(pieces_of_record)
    return Offsets(forces, shares)


class _Piece:
    """The residual of one piece of a record beside its inertia and forces."""

    def __init__(
        self, model: ChainModel, segment: Segment, residual: np.ndarray
    ) -> None:
        rows = segment.valid
        inertia = segment.a[rows].astype(float) * model.masses
        force = np.nan_to_num(segment.F[rows].astype(float))
        self.residual = residual
        self.squares = inertia**2 + force**2
        self.period = mean_period([*segment.s[rows].astype(float).T])

    def windows(self, n_windows: int) -> list[np.ndarray]:
        """Mean of the residual, and rms of inertia and force, in equal windows.

        Each of shape (2, n_dof).
        """
        size = len(self.residual) // max(n_windows, 1)
        if size < LEAST_SAMPLES:
            n_windows = len(self.residual) // LEAST_SAMPLES
        windows = []
        for rows in np.array_split(np.arange(len(self.residual)), max(n_windows, 1)):
            mean = self.residual[rows].mean(axis=0)
            rms = np.sqrt(self.squares[rows].mean(axis=0))
            windows.append(np.array([mean, rms]))
        return windows

    @property
    def n_periods(self) -> int:
        """Periods of the motion, as many as windows are made of."""
        return min(int(len(self.residual) / self.period), MAX_PERIODS)


def _sure_constants(pieces: Sequence[_Piece]) -> tuple[np.ndarray, np.ndarray]:
    """Constants of one record, N, and their shares; zero where none is sure."""
    n_rows = sum(len(piece.residual) for piece in pieces)
    long_windows, periods = [], []
    for piece in pieces:
        share = len(piece.residual) / n_rows
        long_windows += piece.windows(max(1, round(N_WINDOWS * share)))
        periods += piece.windows(piece.n_periods)

    means, sizes = np.array(long_windows).swapaxes(0, 1)
    if len(means) < LEAST_WINDOWS:
        return np.zeros(means.shape[1]), np.zeros(means.shape[1])
    constant = means.mean(axis=0)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    reference = np.sqrt(np.mean(sizes**2, axis=0))
    share = np.zeros_like(constant)
    np.divide(np.abs(constant), reference, out=share, where=reference > 0)

    sure = (np.abs(constant) > STANDARD_ERRORS * error) & (share > LEAST_SHARE)
    by_period = np.array(periods)
    for j in np.flatnonzero(sure):
        sure[j] = _is_the_same_at_every_amplitude(by_period[..., j])
    return np.where(sure, constant, 0.0), np.where(sure, share, 0.0)


def _is_the_same_at_every_amplitude(windows: np.ndarray) -> bool:
    """Whether the mean of a residual is alike in weak and in strong windows.

    ``windows`` holds mean and size of each, (n_windows, 2).
    """
    means = windows[np.argsort(windows[:, 1]), 0]
    weak, strong = np.array_split(means, 2)
    least, largest = sorted([abs(weak.mean()), abs(strong.mean())])
    alike = (
        weak.mean() * strong.mean() > 0 and least > SAME_AT_EVERY_AMPLITUDE * largest
    )
    if alike or len(weak) < LEAST_WINDOWS:
        return True
    error = np.hypot(weak.std() / len(weak) ** 0.5, strong.std() / len(strong) ** 0.5)
    return bool(abs(strong.mean() - weak.mean()) < 2.0 * error)


# -- the same data with them ---------------------------------------------------


def with_offsets(data: Dataset, offsets: Offsets) -> Dataset:
    """The data with known offsets of the equations of motion; zeros are left out.

    Parameters
    ----------
    data : Dataset
    offsets : Offsets
        Of the same records.
    """
    segments = []
    for segment, constants in zip(data.segments, offsets.forces):
        known = constants if constants.any() else None
        segments.append(replace(segment, offsets=known))

    fuse_apart = data.fuse_apart
    if fuse_apart is None:
        return replace(data, segments=tuple(segments))
    return replace(
        data,
        segments=tuple(segments),
        fuse_apart=lambda: with_offsets(fuse_apart(), offsets),
    )
