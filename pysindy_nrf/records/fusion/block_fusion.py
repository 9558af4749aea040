"""Motions of all degrees of freedom, of long records block by block.

Each DOF is fused by itself; then its neighbours improve it, or its knots are halved.
All in units of samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from .dof_fusion import Channels, DofKnowledge, FusedMotion, fuse_dof, refine
from .joint_fusion import fuse_jointly, groups_of_neighbours
from .splines import BasisLadder, ladder_of

# Samples that are fused at a time, and over which neighbouring blocks are cross-faded.
BLOCK = 32768
OVERLAP = 4096
# Samples of the piece of a long record from which its noise levels (to 1.6 %) and knots
# are found.
SEARCH = 2048
# Pieces of that length that a record must have to be called long.
MIN_SEARCH_PIECES = 8


@dataclass(frozen=True)
class ChannelSet:
    """Measured channels of all degrees of freedom on one clock.

    Attributes
    ----------
    channels : sequence of Channels
        Of each DOF, in any unit.
    units : sequence of three floats
        Factors that bring displacement, velocity and acceleration to units of samples.
        They are applied block by block: long channels are not copied in full.
    """

    channels: Sequence[Channels]
    units: Sequence[float] = (1.0, 1.0, 1.0)

    @property
    def n_samples(self) -> int:
        """Samples of every channel."""
        return len(_last_measured(self.channels[0])[1])

    def block(self, start: int, size: int) -> list[Channels]:
        """Some consecutive samples of every DOF, in units of samples."""
        return [self._scaled(channels, start, size) for channels in self.channels]

    def most_active(self, size: int) -> list[Channels]:
        """The piece of each DOF with the largest third derivative: it needs the finest
        knots.
        """
        pieces = []
        for channels in self.channels:
            order, values = _last_measured(channels)
            n_pieces = -(-len(values) // size)
            starts = np.linspace(0, len(values) - size, n_pieces).astype(int)
            third = np.diff(values, 3 - order)
            roughness = [np.sum(third[t : t + size - 3] ** 2) for t in starts]
            most_active = np.argmax(roughness)
            pieces.append(self._scaled(channels, starts[most_active], size))
        return pieces

    def _scaled(self, channels: Channels, start: int, size: int) -> Channels:
        return [
            None if values is None else values[start : start + size] * unit
            for values, unit in zip(channels, self.units)
        ]


@dataclass(frozen=True)
class FusedMotions:
    """Motions of all degrees of freedom of one record.

    Attributes
    ----------
    motions : list of FusedMotion
    dof_by_dof : tuple of list of FusedMotion
        What each DOF by itself gave, step by step; empty unless it was to be kept.
    """

    motions: list[FusedMotion]
    dof_by_dof: tuple[list[FusedMotion], ...] = ()


# the banded matrices are narrow: threads slow each other down
@threadpool_limits.wrap(limits=1)
def fuse_motions(
    channels: ChannelSet,
    known: Sequence[DofKnowledge],
    joint: bool = True,
    keep: bool = False,
    dof_by_dof: Sequence[list[FusedMotion]] = (),
) -> FusedMotions:
    """Fuse the channels of all degrees of freedom.

    Parameters
    ----------
    channels : ChannelSet
    known : sequence of DofKnowledge
        Of each DOF.
    joint : bool
        Whether the DOFs improve each other, which leaves their noise dependent on the
        motion; else knots are halved where acceleration is measured.
    keep : bool
        Return ``dof_by_dof``, for another fusion of the same record with the other
        value of ``joint``. Long records then keep the knots of each DOF.
    dof_by_dof : sequence of list of FusedMotion
        Of an earlier fusion of this record: these DOFs are not fused again.
    """
    first_step = _DofByDof(dof_by_dof, keep)
    second_step = fuse_jointly if joint else refine
    n_samples = channels.n_samples
    # without displacement the lowest frequency needs a longer piece
    complete = all(dof[0] is not None for dof in channels.channels)
    search_size = SEARCH if complete else BLOCK
    if n_samples <= max(MIN_SEARCH_PIECES * SEARCH, 3 * (search_size // 2)):
        ladder = ladder_of(n_samples)
        block = channels.block(0, n_samples)
        single = first_step.fuse(block, ladder, known)
        return FusedMotions(second_step(block, single, ladder), first_step.by_step)

    searched = first_step.fuse(
        channels.most_active(search_size), ladder_of(search_size), known
    )
    known = _knowledge_of(searched, common_knots=joint and not keep)
    total = _CrossFade(n_samples, len(searched))
    ladder = ladder_of(total.block_size)
    for start in total.starts:
        block = channels.block(start, total.block_size)
        single = first_step.fuse(block, ladder, known)
        total.add(start, second_step(block, single, ladder))
    return FusedMotions(total.motions(searched), first_step.by_step)


class _DofByDof:
    """The first step: each DOF by itself, or what an earlier fusion made of it."""

    def __init__(self, earlier: Sequence[list[FusedMotion]], keep: bool) -> None:
        self._earlier = iter(earlier)
        self._keep = keep
        self.by_step: tuple[list[FusedMotion], ...] = ()

    def fuse(
        self,
        channels_of_dofs: Sequence[Channels],
        ladder: BasisLadder,
        known: Sequence[DofKnowledge],
    ) -> list[FusedMotion]:
        motions = next(self._earlier, None)
        if motions is None:
            motions = []
            spacing = 1.0
            for channels, knowledge in zip(channels_of_dofs, known, strict=True):
                motion = fuse_dof(channels, ladder, knowledge, spacing)
                motions.append(motion)
                # neighbours need similar knots
                spacing = motion.spacing
        if self._keep:
            self.by_step = (*self.by_step, motions)
        return motions


class _CrossFade:
    """Motions of a long record, added up from blocks that fade into each other."""

    def __init__(self, n_samples: int, n_dof: int) -> None:
        n_blocks = 1
        self.block_size = n_samples
        if n_samples > 3 * BLOCK // 2:
            n_blocks = -(-(n_samples - OVERLAP) // (BLOCK - OVERLAP))
            self.block_size = BLOCK
        last = n_samples - self.block_size
        self.starts = np.linspace(0, last, n_blocks).astype(int)

        middle = self.block_size / 2
        from_middle = np.abs(np.arange(self.block_size) + 0.5 - middle)
        self._weight = np.minimum(middle - from_middle, OVERLAP)
        self._total_weight = np.zeros(n_samples)
        self._values = [np.zeros((3, n_samples)) for _ in range(n_dof)]
        self._spacing = np.zeros(n_dof)

    def add(self, start: int, motions: Sequence[FusedMotion]) -> None:
        rows = slice(start, start + self.block_size)
        self._total_weight[rows] += self._weight
        for j, motion in enumerate(motions):
            motion.add(self._weight, self._values[j][:, rows])
            self._spacing[j] = max(self._spacing[j], motion.spacing)

    def motions(self, searched: Sequence[FusedMotion]) -> list[FusedMotion]:
        """The motions, with the noise levels that were found before."""
        for values in self._values:
            # three blocks may overlap
            values /= self._total_weight
        return [
            FusedMotion(motion.noise, spacing, motion.high_pass, None, values)
            for motion, spacing, values in zip(searched, self._spacing, self._values)
        ]


def _knowledge_of(
    searched: Sequence[FusedMotion], common_knots: bool
) -> list[DofKnowledge]:
    """What a piece of a record says of all of it."""
    known = []
    for motion in searched:
        # channels without noise are looked at block by block
        spacing = None if motion.clean else motion.spacing
        known.append(DofKnowledge(motion.noise, motion.high_pass, spacing))

    if common_knots:
        # the finest knots of a group are those of all its members
        able = [
            j
            for j, motion in enumerate(searched)
            if not motion.clean and motion.high_pass == 0.0
        ]
        for group in groups_of_neighbours(able):
            finest = min(searched[j].spacing for j in group)
            for j in group:
                known[j] = replace(known[j], spacing=finest)
    return known


def _last_measured(channels: Channels) -> tuple[int, np.ndarray]:
    """Order and values of the highest derivative that is measured."""
    return [(k, values) for k, values in enumerate(channels) if values is not None][-1]
