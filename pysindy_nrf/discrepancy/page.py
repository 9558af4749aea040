"""A plain self-contained page of the loop's report."""

from __future__ import annotations

from html import escape
from typing import Any

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse}td,th{padding:.3rem .7rem;border-bottom:1px solid #bbb;text-align:right}"
    "td:first-child,th:first-child{text-align:left}pre{overflow:auto}"
)


def page(report: Any) -> str:
    """The report as HTML; every name from a file is escaped.

    Parameters
    ----------
    report : LoopReport

    Returns
    -------
    str
    """
    steps = "".join(f"<li>{escape(step.sentence)}</li>" for step in report.steps) or "<li>No effect was added.</li>"
    head = "".join(f"<th scope='col'>{escape(str(c))}</th>" for c in ["model", *report.table.columns])
    rows = "".join(
        f"<tr><th scope='row'>{escape(str(name))}</th>"
        + "".join(f"<td>{escape(f'{x:.3g}' if isinstance(x, float) else str(x))}</td>" for x in row)
        + "</tr>"
        for name, row in report.table.iterrows()
    )
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>Closing the loop</title>"
        f"<style>{_STYLE}</style></head><body><h1>Closing the loop</h1><ol>{steps}</ol>"
        f"<p>Stopped: {escape(report.stopped_because)}.</p><h2>Errors</h2>"
        "<p>Percent NRMSE; balance errors (one step) except the free run.</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        f"<h2>Model</h2><pre>{escape(str(report.model))}</pre></body></html>\n"
    )
