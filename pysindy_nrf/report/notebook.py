"""A small view of a closed loop for notebooks, with every name escaped."""

from __future__ import annotations

from html import escape

import pandas as pd

from ..drawing.tables import Table
from .loop_content import errors
from .results import Loop
from .tables import texts

# Rows of a table.
MAX_ROWS = 30
# Errors of a loop that are shown, percent.
_ERRORS = ("search", "validation", "held-out", "free run")


def loop_html(report: Loop) -> str:
    """A report of the loop: verdict, steps, errors, reason to stop."""
    verdict = report.verdict
    words = f"{verdict.state.upper()}: {verdict.sentence}"
    story = "<p>No effect was added.</p>"
    if report.steps:
        steps = [f"<li>{escape(step.sentence)}</li>" for step in report.steps]
        story = f"<ol>{''.join(steps)}</ol>"

    columns = [name for name in _ERRORS if name in report.table]
    parts = [
        "<p style='margin:.2em 0'><b>Closed loop</b></p>",
        f"<p style='margin:.2em 0'>{escape(words)}</p>",
        story,
        _html_table(errors(report, columns)),
        f"<p>Stopped: {escape(report.stopped_because)}.</p>",
    ]
    return f"<div class='pysindy-nrf'>{''.join(parts)}</div>"


def _html_table(shown: Table) -> str:
    """The first rows of a table."""
    rows = [texts(row) for row in shown.rows[:MAX_ROWS]]
    html = pd.DataFrame(rows, columns=shown.head).to_html(index=False, border=0)
    n_more = len(shown.rows) - MAX_ROWS
    return f"{html}<p>and {n_more} more rows</p>" if n_more > 0 else html
