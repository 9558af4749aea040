"""Small views for notebooks, with every name escaped."""

from __future__ import annotations

from html import escape

import pandas as pd

from ..chain.latex import pretty
from ..records.checks.channel_checks import measured
from ..records.record import Record
from .loop_content import errors
from .results import Loop
from .tables import Table, table, texts

# Rows of a table.
MAX_ROWS = 30
# Errors of a loop that are shown, percent.
_ERRORS = ("search", "validation", "held-out", "free run")


def record_html(record: Record) -> str:
    """A record: clock, forces, channels."""
    facts = measured(record)
    units = [pretty(str(unit)) for unit in facts.channels["unit"]]
    channels = facts.channels.drop(columns="noise").assign(unit=units)
    body = _html_table(table("", channels))
    return _box(f"Record: {facts.name}", f"{facts.facts}.", body)


def loop_html(report: Loop) -> str:
    """A report of the loop: steps, errors, reason to stop."""
    story = "<p>No effect was added.</p>"
    if report.steps:
        steps = [f"<li>{escape(step.sentence)}</li>" for step in report.steps]
        story = f"<ol>{''.join(steps)}</ol>"
    columns = [name for name in _ERRORS if name in report.table]
    numbers = _html_table(errors(report, columns))
    stopped = f"<p>Stopped: {escape(report.stopped_because)}.</p>"

    verdict = report.verdict
    words = f"{verdict.state.upper()}: {verdict.sentence}"
    return _box("Closed loop", words, f"{story}{numbers}{stopped}")


def _box(title: str, words: str, body: str) -> str:
    """A heading, a sentence, and what follows."""
    lines = [f"<p style='margin:.2em 0'><b>{escape(title)}</b></p>"]
    if words:
        lines.append(f"<p style='margin:.2em 0'>{escape(words)}</p>")
    return f"<div class='pysindy-nrf'>{''.join(lines)}{body}</div>"


def _html_table(shown: Table) -> str:
    """The first rows of a table."""
    rows = [texts(row) for row in shown.rows[:MAX_ROWS]]
    html = pd.DataFrame(rows, columns=shown.head).to_html(index=False, border=0)
    n_more = len(shown.rows) - MAX_ROWS
    return f"{html}<p>and {n_more} more rows</p>" if n_more > 0 else html
