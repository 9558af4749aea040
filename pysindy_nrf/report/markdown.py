"""The report of a closed loop as Markdown, with the words and tables of its page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ..drawing.tables import Table
from .content import Chapter
from .loop_content import band_and_source, chapters, effects, errors, lead
from .results import Loop
from .tables import texts


def markdown(report: Loop) -> str:
    """The report as Markdown; names from files are escaped."""
    lines = ["# Closing the loop", ""]
    verdict = report.verdict
    lines += [f"**{verdict.state.upper()}: {_safe(verdict.sentence)}**", ""]
    lines += _items(verdict.reasons)
    lines += _items(f"Assumed: {text}" for text in verdict.assumptions)
    lines += [_safe(lead(report)), ""]
    lines += _steps(report)
    lines += [f"Stopped: {_safe(report.stopped_because)}.", ""]

    reductions = effects(report)
    if reductions is not None:
        lines += _with_caption(reductions)
    where = band_and_source(report)
    lines += [
        f"Errors in percent NRMSE ({where}); balance errors (one step) except the free"
        " run.",
        "",
    ]
    lines += [*_table(errors(report)), ""]

    for chapter in chapters(report):
        lines += _chapter(chapter)
    if report.measured:
        sentences = [record.sentence for record in report.measured]
        lines += ["## What was measured", "", *_items(sentences)]
    # no line of the model ends the block early
    model = str(report.model).replace("```", "'''")
    lines += ["## Model", "", "```", model, "```", ""]
    if report.settings:
        lines += _settings(report.settings)
    return "\n".join(lines)


def _steps(report: Loop) -> list[str]:
    if not report.steps:
        return ["No effect was added.", ""]
    steps = []
    for number, step in enumerate(report.steps, 1):
        steps.append(f"{number}. {_safe(step.sentence)}")
    return [*steps, ""]


def _chapter(chapter: Chapter) -> list[str]:
    lines = [f"## {_safe(chapter.title)}", ""]
    for name, text in chapter.facts:
        colon = "" if name.endswith("?") else ":"
        lines.append(f"- {_safe(name)}{colon} {_safe(text)}")
    lines.append("")
    for numbers in chapter.tables:
        lines += _with_caption(numbers)
    return lines


def _settings(groups: Mapping[str, Mapping[str, object]]) -> list[str]:
    lines = ["## Settings", ""]
    for group, values in groups.items():
        pairs = [f"{_safe(name)} = {_safe(value)}" for name, value in values.items()]
        lines.append(f"- {_safe(group)}: {', '.join(pairs)}")
    return [*lines, ""]


def _with_caption(shown: Table) -> list[str]:
    return [f"{_safe(shown.caption)}:", "", *_table(shown), ""]


def _table(shown: Table) -> list[str]:
    """Lines of a table."""
    lines = [_row(shown.head), "|" + "---|" * len(shown.head)]
    for row in shown.rows:
        lines.append(_row(texts(row)))
    return lines


def _row(values: Iterable[str]) -> str:
    return f"| {' | '.join(map(_safe, values))} |"


def _items(sentences: Iterable[str]) -> list[str]:
    return [*(f"- {_safe(text)}" for text in sentences), ""]


def _safe(text: object) -> str:
    """Text that no Markdown renderer takes for markup or for the end of a cell."""
    safe = str(text).replace("&", "&amp;").replace("<", "&lt;")
    return safe.replace("|", "\\|").replace("\n", " ")
