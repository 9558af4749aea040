"""The page of records before anything is identified."""

from __future__ import annotations

from collections.abc import Sequence

from ..common.unit_system import unit_system
from ..records.checks.channel_checks import channel_notes, measured
from ..records.quality import QualityNote, messages
from ..records.record import Record
from .content import Content, audit_part, measured_part, names_of


def data_content(
    records: Sequence[Record],
    title: str | None = None,
    notes: Sequence[str] = (),
) -> Content:
    """Channels of records over time and by frequency, and what is doubtful of them.

    Parameters
    ----------
    records : sequence of Record
    title : str, optional
        Names of the records if None.
    notes : sequence of str
        What is to be taken care of, besides what the channels say.
    """
    doubts: list[QualityNote] = []
    summaries = []
    for record in records:
        doubts += channel_notes(record)
        summaries.append(measured(record))
    care = [*notes, *messages(tuple(doubts))]
    lead = "Nothing looks wrong." if not care else "Some channels are in doubt."
    return Content(
        title=title or names_of(summaries),
        lead=lead,
        audit=audit_part({}, {}),
        care=list(dict.fromkeys(care)),
        measured=measured_part(summaries, notes=doubts),
        units=unit_system(all(record.rotates for record in records)),
    )
