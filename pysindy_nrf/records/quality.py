"""What is known of the quality of a record: typed notes, the ground of verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "assumed",  # a unit or a rate that nothing in the file states
    "clipped",  # repeats its extremes; share of the samples
    "clock",  # the unit of the time; true time over time read
    "corner",  # of a first-order high-pass filter that it has passed, Hz
    "computed",  # obeys a rule of integration, which is no fault
    "copied",  # the same as another channel
    "dead",  # does not move; share of the samples
    "delay",  # lags behind another channel, s
    "drift",  # wanders slowly
    "dropouts",  # drops to zero; share of the samples
    "filled",  # a number stands for "not measured"; share of the samples
    "frame",  # relative to the base and not absolute, or the reverse
    "gain",  # ratio to what another channel says
    "gain_drift",  # relative change of that ratio over the record
    "hold",  # the course of the forces between the samples, which is no fault
    "hum",  # of the mains; share of the rms
    "incoherent",  # follows no other channel; the largest coherence
    "interpolated",  # made up between samples of a slower clock; share of the samples
    "noise",  # rms of its noise, in the channel's SI unit
    "offset",  # its zero, in the channel's SI unit; of an equation of motion, N
    "overlap",  # time that all channels cover, s
    "quantised",  # moves in coarse steps
    "resampled",  # brought to a slower clock; ratio of the rates
    "rotation",  # all channels are rotations: N m, rad, rad/s
    "shifted",  # started after the channel that is the witness, s; moved to its clock
    "sign",  # points the other way; -1
    "spikes",  # samples that stand out; share of the samples
    "swapped",  # looks like a channel of another place
    "unit",  # ratio that a known unit would explain, or a peak too large for the unit
    "other",
]
# Kinds that are to be known, and are no fault.
_ONLY_KNOWN = (
    "assumed",
    "computed",
    "hold",
    "offset",
    "overlap",
    "resampled",
    "rotation",
    "shifted",
)


@dataclass(frozen=True)
class QualityNote:
    """One thing that is known of the quality of a channel, a clock or a unit.

    Parameters
    ----------
    kind : str
        What is wrong or known.
    message : str
        The same in a sentence, for the user. Notes on several faults of one channel may
        share theirs.
    channel : str
        Such as ``"a2"``, or ``"dof 2"`` for an equation of motion; empty for the record
        as a whole.
    record : str
        Name of the record.
    size : float
        How much, as the kind says: a ratio, s, a share, or the channel's SI unit.
    witness : str
        What it was measured against, such as ``"x2"``; empty if nothing.

    Examples
    --------
    >>> from pysindy_nrf.records import QualityNote
    >>> note = QualityNote("delay", "v1 is 4 ms late.", "v1", size=0.004)
    >>> note.is_fault, note.channel, note.size
    (True, 'v1', 0.004)
    """

    kind: Kind
    message: str
    channel: str = ""
    record: str = ""
    size: float = float("nan")
    witness: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether it asks for a correction."""
        return self.kind not in _ONLY_KNOWN


def rotation_note(record: str) -> QualityNote:
    """The note that the channels of a record are rotations."""
    message = "its motion is a rotation: N m, rad, kg m^2"
    return QualityNote("rotation", message, "", record)


def are_rotations(notes: tuple[QualityNote, ...]) -> bool:
    """Whether notes say that the channels are rotations."""
    return any(note.kind == "rotation" for note in notes)


def messages(notes: tuple[QualityNote, ...]) -> list[str]:
    """The sentences of some notes, each once."""
    return list(dict.fromkeys(note.message for note in notes))
