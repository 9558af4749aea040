"""The loop's report as Markdown."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd


def markdown(report: Any) -> str:
    """The report as Markdown; names from files are escaped."""
    out = ["# Closing the loop", ""]
    out += [f"{i}. {_safe(step.sentence)}" for i, step in enumerate(report.steps, 1)] or ["No effect was added."]
    out += ["", f"Stopped: {_safe(report.stopped_because)}.", ""]
    out += ["Errors in percent NRMSE; balance errors (one step) except the free run.", "", *table(report.table), ""]
    for number, step in enumerate(report.steps, 1):
        out += _step(number, step)
    if report.evidence:
        last = report.evidence[-1]
        out += ["## What is left", ""]
        out += [f"- {_safe(s)}" for s in (last.detection_sentence, last.localisation_sentence)]
        out += [f"- {_safe(last.characterisation_sentence)}", ""]
    if report.measured:
        out += ["## What was measured", ""]
        out += [f"- {_safe(m.sentence)}" for m in report.measured] + [""]
    out += ["## Model", "", "```", str(report.model).replace("```", "'''"), "```", ""]
    if report.settings:
        out += ["## Settings", ""]
        for group, values in report.settings.items():
            out += [f"- {_safe(group)}: " + ", ".join(f"{_safe(k)} = {_safe(v)}" for k, v in values.items())]
        out += [""]
    return "\n".join(out)


def _step(number: int, step: Any) -> list[str]:
    out = [f"## Step {number}: {_safe(step.law)} at {_safe(step.site)}", ""]
    said = (step.detection, step.localisation, step.characterisation)
    out += [f"- {_safe(sentence)}" for sentence in said if sentence]
    out += [f"- Accepted because {_safe(step.evidence)}.", ""]
    out += [*table(parameter_table(step)), ""]
    if step.runners_up or step.tied:
        rows = [(*row, "tied") for row in step.tied]
        rows += [(*row, "") for row in step.runners_up if row not in step.tied]
        frame = pd.DataFrame(rows, columns=["law", "site", "validation error (%)", ""])
        out += ["Alternatives:", "", *table(frame.set_index("law")), ""]
    return out


def parameter_table(step: Any) -> pd.DataFrame:
    """Parameters of a step with their intervals where they are known."""
    frame = pd.DataFrame({"estimate": pd.Series(step.parameters, dtype=float)})
    frame.index.name = "parameter"
    return frame.join(pd.DataFrame.from_dict(step.intervals or {}, orient="index", columns=["lower", "upper"]))


def table(frame: pd.DataFrame) -> list[str]:
    """A table of numbers and names as Markdown lines, the index first."""
    head = [_safe(frame.index.name or ""), *map(_safe, frame.columns)]
    out = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, row in frame.iterrows():
        out.append("| " + " | ".join([_safe(name), *(_safe(_cell(x)) for x in row)]) + " |")
    return out


def _cell(x: Any) -> str:
    if isinstance(x, (float, np.floating)):
        return "" if np.isnan(x) else f"{x:.4g}"
    return str(x)


def _safe(text: Any) -> str:
    """Text that no Markdown renderer takes for markup or for the end of a cell."""
    return str(text).replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("\n", " ")
