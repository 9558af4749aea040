"""Small HTML of records, models and reports for notebooks; needs no extra, and escapes every name."""

from __future__ import annotations

from html import escape
from typing import Any

from ..displays._figure import Table, table
from .equations import as_text, law_equation, pretty_unit, shape_values
from .write import cell

_MOST = 30


def record_html(record: Any) -> str:
    """A record: clock, forces, channels."""
    from ...signals.measured import measured

    m = measured(record)
    shown = m.channels.drop(columns="noise").assign(unit=[pretty_unit(str(u)) for u in m.channels["unit"]])
    return _box(f"Record: {m.name}", f"{m.facts}.", _table(table("", shown)))


def model_html(model: Any) -> str:
    """A chain model: masses, equations."""
    masses = ", ".join(f"m{j} = {as_text(m)} kg" for j, m in enumerate(model.masses[:_MOST], 1))
    lines = []
    for force in list(model.restoring_forces.values())[:_MOST]:
        if force.laws:
            shapes = ", ".join(shape_values(force))
            lines.append(" ".join(law_equation(force)) + (f" with {shapes}" if shapes else ""))
    body = "".join(f"<p style='margin:.2em 0'>{line}</p>" for line in lines)
    return _box(f"Chain of {model.n_dof} DOF{'s' if model.n_dof > 1 else ''}", masses, body)


def loop_html(report: Any) -> str:
    """A report of the loop: steps, errors, reason to stop."""
    steps = "".join(f"<li>{escape(step.sentence)}</li>" for step in report.steps)
    story = f"<ol>{steps}</ol>" if steps else "<p>No effect was added.</p>"
    columns = [c for c in ("search", "validation", "held-out", "free run") if c in report.table]
    errors = _table(table("", report.table[columns], {c: f"{c} (%)" for c in columns}, "model"))
    return _box("Closed loop", "", f"{story}{errors}<p>Stopped: {escape(report.stopped_because)}.</p>")


def _box(title: str, words: str, body: str) -> str:
    said = f"<p style='margin:.2em 0'>{escape(words)}</p>" if words else ""
    return f"<div class='pysindy-nrf'><p style='margin:.2em 0'><b>{escape(title)}</b></p>{said}{body}</div>"


def _table(t: Table) -> str:
    head = "".join(f"<th scope='col'>{escape(name)}</th>" for name in t.head)
    rows = "".join(f"<tr>{''.join(_cell(x) for x in row)}</tr>" for row in t.rows[:_MOST])
    more = f"<p>and {len(t.rows) - _MOST} more rows</p>" if len(t.rows) > _MOST else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{more}"


def _cell(value: Any) -> str:
    c = cell(value)
    return f"<td style='text-align:{'right' if c.number else 'left'}'>{escape(c.text)}</td>"
