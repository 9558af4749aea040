"""A page of tables and figures that are no model: a comparison, a change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..diagnosis.verdict import Verdict
from ..drawing.figure import Figure, Table
from .content import Content, audit_part
from .figures.modes import MovingModes


@dataclass(frozen=True, eq=False)
class ResultsPage:
    """Tables and figures with a headline.

    Parameters
    ----------
    title, lead : str
        What was asked, and the answer in a sentence.
    parts : sequence of Figure, Table or MovingModes
    verdicts : mapping of str to Verdict
        By what they are on; a single one needs no name.
    care : sequence of str
        What is to be taken care of.
    info : mapping of str to object
        ``command`` and ``inputs`` of the run.
    """

    title: str
    lead: str
    parts: Sequence[Figure | Table | MovingModes]
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    care: Sequence[str] = ()
    info: Mapping[str, object] = field(default_factory=dict)


def results_content(page: ResultsPage, title: str | None = None) -> Content:
    """What such a page shows."""
    care = []
    for name, verdict in page.verdicts.items():
        of_which = f"{name}: " if name else ""
        care += [f"{of_which}{reason}" for reason in verdict.reasons]
    return Content(
        title=title or page.title,
        lead=page.lead,
        audit=audit_part(page.info, {}),
        verdicts=page.verdicts,
        care=[*care, *page.care],
        results=list(page.parts),
    )
