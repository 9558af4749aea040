"""What is wrong with the channels of a record; a summary of it for pages."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import pandas as pd

from ...common.warn import warn_user
from ...exceptions import DataQualityWarning
from ..files.summary import channel_table
from ..quality import QualityNote, messages
from ..record import Record
from .channel_faults import fault_notes
from .contradictions import contradiction_notes, slow_clock_note, unit_notes
from .motion_checks import motion_doubts, motion_notes

__all__ = [
    "Measured",
    "channel_notes",
    "check_channels",
    "data_warnings",
    "measured",
    "motion_doubts",
    "motion_notes",
]


def channel_notes(record: Record) -> tuple[QualityNote, ...]:
    """Notes on units, clocks, signs, delays and channels of a record that are probably
    wrong.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records.checks.channel_checks import channel_notes
    >>> rec = datasets.load_demo()
    >>> notes = channel_notes(rec.replace(displacement=-rec.displacement))
    >>> [(note.kind, note.channel, note.witness) for note in notes]
    [('sign', 'x1', 'a1'), ('sign', 'x2', 'a2'), ('sign', 'x3', 'a3')]
    """
    notes = unit_notes(record) + contradiction_notes(record)
    if not notes:
        slow_clock = slow_clock_note(record)
        notes = () if slow_clock is None else (slow_clock,)
    return notes + fault_notes(record)


def data_warnings(record: Record) -> list[str]:
    """The sentences of :func:`channel_notes`."""
    return messages(channel_notes(record))


def doubts_by_channel(
    record: Record, notes: Iterable[QualityNote] | None = None
) -> dict[str, list[str]]:
    """What is doubtful of each channel.

    Parameters
    ----------
    record : Record
    notes : iterable of QualityNote, optional
        Those of :func:`channel_notes` if None. Notes of other records are left out.

    Returns
    -------
    dict of str to list of str
        Sentences by channel.
    """
    doubts: dict[str, list[str]] = {}
    for note in channel_notes(record) if notes is None else notes:
        is_of_record = note.record in ("", record.name)
        if note.is_fault and note.channel and is_of_record:
            sentences = doubts.setdefault(note.channel, [])
            if note.message not in sentences:
                sentences.append(note.message)
    return doubts


def check_channels(record: Record, warn: bool = False) -> pd.DataFrame:
    """Table of what is wrong with each measured channel of a record by itself.

    Parameters
    ----------
    record : Record
    warn : bool
        Issue a DataQualityWarning if something is.

    Returns
    -------
    DataFrame
        ``channel``, ``problem`` (the kind of :class:`~pysindy_nrf.records.quality.
        QualityNote`), ``share`` of the samples and ``message``.
    """
    notes = fault_notes(record)
    rows = [(note.channel, note.kind, note.size, note.message) for note in notes]
    table = pd.DataFrame(rows, columns=["channel", "problem", "share", "message"])
    if warn and notes:
        warn_user(
            f"Record {record.name!r}: {' '.join(table['message'])}",
            DataQualityWarning,
        )
    return table


@dataclass(frozen=True)
class Measured:
    """One record in words and numbers.

    Attributes
    ----------
    name : str
    n_dof, n_samples : int
    fs : float
        Hz.
    channels : DataFrame
        ``channel``, ``what``, ``unit``, ``rms``, ``peak`` and ``noise`` of each.
    forced, unknown : tuple of int
        DOFs with a known force, and with an unknown one.
    base_moves : bool
    role : str
        What the record is used for.
    record : Record, optional
        Its channels, to be drawn.
    """

    name: str
    n_dof: int
    n_samples: int
    fs: float
    channels: pd.DataFrame
    forced: tuple[int, ...] = ()
    unknown: tuple[int, ...] = ()
    base_moves: bool = False
    role: str = ""
    record: Record | None = field(default=None, repr=False, compare=False)

    @property
    def facts(self) -> str:
        """Size, clock, forces and base of the record in one line."""
        plural = "s" if self.n_dof > 1 else ""
        facts = [
            f"{self.n_dof} DOF{plural}, {self.n_samples} samples at {self.fs:g} Hz,"
            f" {self.n_samples / self.fs:.4g} s"
        ]
        if self.forced:
            facts.append(f"forced: DOF {', '.join(map(str, self.forced))}")
        else:
            facts.append("no force measured")
        if self.unknown:
            facts.append(f"force unknown on DOF {', '.join(map(str, self.unknown))}")
        facts.append("the base moves" if self.base_moves else "the base is at rest")
        if self.role:
            facts.append(self.role)
        return "; ".join(facts)

    @property
    def sentence(self) -> str:
        """The record in one line, its name first."""
        return f"{self.name}: {self.facts}"


def measured(
    record: Record, noise: Mapping[str, float] | None = None, role: str = ""
) -> Measured:
    """Summary of a record.

    Parameters
    ----------
    record : Record
    noise : mapping of str to float, optional
        Estimated noise level by channel, SI rms.
    role : str
        What the record is used for.
    """
    levels = noise or {}
    channels = channel_table(record)
    channels["noise"] = [levels.get(name, float("nan")) for name in channels["channel"]]
    return Measured(
        record.name,
        record.n_dof,
        record.n_samples,
        record.fs,
        channels,
        record.forced,
        record.unknown,
        record.base_moves,
        role,
        record,
    )
