"""What is known of the quality of a record: typed notes, from which verdicts are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "clipped",  # repeats its largest value
    "dead",  # does not move
    "delay",  # lags behind another channel, s
    "drift",  # wanders slowly
    "gain",  # ratio to what another channel says
    "noise",  # rms of its noise, in the channel's SI unit
    "offset",  # its zero, in the channel's SI unit
    "sign",  # points the other way
    "spikes",  # number of samples that stand out
    "swapped",  # looks like another channel
    "unit",  # ratio that a known unit would explain
    "other",
]


@dataclass(frozen=True)
class QualityNote:
    """One thing that is known of the quality of a channel, a clock or a unit.

    Parameters
    ----------
    kind : str
        What is wrong or known.
    message : str
        The same in a sentence, for the user.
    channel : str
        Such as ``"a2"``; empty for the record as a whole.
    record : str
        Name of the record.
    size : float
        How much, as the kind says: a ratio, s, a number, or the channel's SI unit.
    witness : str
        What it was measured against, such as ``"x2"``; empty if nothing.
    """

    kind: Kind
    message: str
    channel: str = ""
    record: str = ""
    size: float = float("nan")
    witness: str = ""
