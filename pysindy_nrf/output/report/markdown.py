"""The loop's report as Markdown: the same words and tables as on its page."""

from __future__ import annotations

from typing import Any

from ..displays._figure import Table, table
from .story import cautions, chapters
from .write import cell


def markdown(report: Any) -> str:
    """The report as Markdown; names from files are escaped."""
    out = ["# Closing the loop", ""]
    out += [f"{i}. {_safe(step.sentence)}" for i, step in enumerate(report.steps, 1)] or ["No effect was added."]
    out += ["", f"Stopped: {_safe(report.stopped_because)}.", ""]
    out += ["Errors in percent NRMSE; balance errors (one step) except the free run.", ""]
    out += [*_table(table("", report.table, index="model")), ""]
    care = cautions(report)
    out += ["## Take care", "", *(f"- {_safe(text)}" for text in care), ""] if care else []
    for chapter in chapters(report):
        facts = [f"- {_safe(name)}{'' if name.endswith('?') else ':'} {_safe(text)}" for name, text in chapter.facts]
        out += [f"## {_safe(chapter.title)}", "", *facts, ""]
        for numbers in chapter.tables:
            out += [f"{_safe(numbers.caption)}:", "", *_table(numbers), ""]
    if report.measured:
        out += ["## What was measured", "", *(f"- {_safe(m.sentence)}" for m in report.measured), ""]
    out += ["## Model", "", "```", str(report.model).replace("```", "'''"), "```", ""]
    if report.settings:
        out += ["## Settings", ""]
        for group, values in report.settings.items():
            out.append(f"- {_safe(group)}: " + ", ".join(f"{_safe(k)} = {_safe(v)}" for k, v in values.items()))
        out.append("")
    return "\n".join(out)


def _table(t: Table) -> list[str]:
    """Lines of a table."""
    rows = [t.head, *([cell(x).text for x in row] for row in t.rows)]
    lines = ["| " + " | ".join(map(_safe, row)) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(t.head), *lines[1:]]


def _safe(text: Any) -> str:
    """Text that no Markdown renderer takes for markup or for the end of a cell."""
    return str(text).replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("\n", " ")
