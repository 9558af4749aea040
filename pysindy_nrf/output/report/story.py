"""The loop's story: one chapter for each step, and one for what is left."""

from __future__ import annotations

from typing import Any

import numpy as np

from .content import Chapter
from .equations import pretty_unit
from .figures_evidence import of_evidence
from .tables import Table, rows_table


def lead(report: Any) -> str:
    """The whole story in two sentences."""
    table = report.table["held-out"]
    if not report.steps:
        return (
            f"The declared model leaves {table.iloc[0]:.3g} % of the balances unexplained on held-out data, and the "
            "loop added nothing to it."
        )
    found = [f"{words(s.law)} at {s.site}" for s in report.steps]
    listed = found[0] if len(found) == 1 else f"{', '.join(found[:-1])} and {found[-1]}"
    unsure = [words(s.law) for s in report.steps if not s.sure]
    doubt = f" Not sure by name: {', '.join(unsure)}." if unsure else ""
    return (
        f"The declared model lacked {listed}. With {'it' if len(found) == 1 else 'them'} the balance error on held-out "
        f"data falls from {table.iloc[0]:.3g} to {table.iloc[-1]:.3g} %.{doubt}"
    )


def chapters(report: Any) -> list[Chapter]:
    """One chapter for each step, and the last on what is left."""
    evidence = list(report.evidence) + [None] * (len(report.steps) + 1 - len(report.evidence))
    out = [_step(k, step, evidence[k - 1], report) for k, step in enumerate(report.steps, 1)]
    return [*out, _end(evidence[len(report.steps)], report)]


def cautions(report: Any) -> list[str]:
    """What makes the result doubtful."""
    out = []
    for step in report.steps:
        if not step.sure:
            out.append(
                f"{words(step.law)} at {step.site} is only the closest law: {100 * step.remainder:.0f} % of the effect "
                "stays unexplained."
            )
        if step.alternatives:
            others = ", ".join(map(words, step.alternatives))
            out.append(f"At {step.site} the data cannot tell {words(step.family)} from {others}.")
        if "disagrees" in step.localisation:
            out.append(f"Localisation and the loop disagree about {words(step.law)} at {step.site}; see its step.")
        if step.free_run_after > 1.1 * step.free_run_before:
            out.append(
                f"With {words(step.law)} at {step.site} the held-out free run is worse than before "
                f"({step.free_run_before:.3g} to {step.free_run_after:.3g} %), though the balances close better."
            )
    negative = [f"m{j}" for j, m in enumerate(report.model.masses, 1) if m <= 0]
    if negative:
        out.append(f"{', '.join(negative)} came out not positive: the data do not determine this balance.")
    rooms = {room: why for e in report.evidence for room, why in e.not_possible.items() if "noise" not in why}
    out += [f"{room[0].upper()}{room[1:]} was not possible because {why.rstrip('.')}." for room, why in rooms.items()]
    if any(e.floor is None for e in report.evidence):
        out.append("What noise alone would leave is not known here; noise is taken to be white within the band.")
    return list(dict.fromkeys(out))


def _step(number: int, step: Any, evidence: Any, report: Any) -> Chapter:
    facts = _rooms(evidence)
    chance = f" On surrogates with noise alone the same law gains at most {100 * step.null_gain:.0f} %."
    facts.append(("Decision", _sentence(step.evidence) + (chance if np.isfinite(step.null_gain) else "")))
    after = [("Held-out balance error", f"{step.error_before:.3g} → {step.error_after:.3g} %")]
    if np.isfinite(step.free_run_before) and np.isfinite(step.free_run_after):
        after.append(("Held-out free-run error", f"{step.free_run_before:.3g} → {step.free_run_after:.3g} %"))
    after.append(("In one line", step.sentence))
    tables = [_parameters(step, report.model)]
    if step.tied or step.runners_up:
        tables.append(_others(step))
    name = f"{words(step.law)} at {step.site}" if step.sure else f"closest law: {words(step.law)} at {step.site}"
    figures = [] if evidence is None else of_evidence(evidence)
    about = _about(step)
    return Chapter(f"Step {number}: {name}", about, facts + after, figures, tables, step.family)


def _end(evidence: Any, report: Any) -> Chapter:
    facts = [*_rooms(evidence), ("Why it stopped", _sentence(report.stopped_because))]
    tables = []
    if len(report.candidates):
        rows = report.candidates.head(10).to_numpy().tolist()
        rows = [[words(law), family, site, float(error)] for law, family, site, error in rows]
        head = ["law", "family", "site", "validation error (%)"]
        tables.append(rows_table("The best candidates of the last search", head, rows))
    figures = [] if evidence is None else of_evidence(evidence)
    return Chapter("What is left", "", facts, figures, tables)


def _rooms(evidence: Any) -> list[tuple[str, str]]:
    if evidence is None:
        return []
    return [
        ("Is it noise?", evidence.detection_sentence),
        ("Where?", evidence.localisation_sentence),
        ("What kind?", evidence.characterisation_sentence),
    ]


def _parameters(step: Any, model: Any) -> Table:
    from ...discrepancy.markdown import parameter_table
    from ...laws.base import registry

    units: dict[str, str] = {}
    held = [law for laws in model.laws.values() for law in laws if law.name == step.law]
    law = next((law for law in held if dict(law.parameters) == step.parameters), registry().get(step.law))
    if law is not None:
        units = {p.name: p.unit for p in law.shapes}
        if not isinstance(law, type):
            units |= {t.symbol: t.unit for t in law.terms()}
    frame = parameter_table(step).dropna(axis=1, how="all")
    rows = [
        [name, *map(float, values), pretty_unit(units.get(str(name), ""))]
        for name, *values in frame.itertuples(name=None)
    ]
    return rows_table(f"Parameters of {words(step.law)} at {step.site}", ["parameter", *frame.columns, "unit"], rows)


def _others(step: Any) -> Table:
    rows = [[words(law), site, float(error), "within 10 %: tied"] for law, site, error in step.tied]
    tied = {(law, site) for law, site, _ in step.tied}
    rows += [[words(law), site, float(error), ""] for law, site, error in step.runners_up if (law, site) not in tied]
    head = ["law", "site", "validation error (%)", "remark"]
    return rows_table(f"Other laws that were tried beside {words(step.law)}", head, rows)


def _about(step: Any) -> str:
    """The first line of the law's own documentation."""
    from ...laws.base import registry

    law = registry().get(step.law)
    lines = [line.strip() for line in (getattr(law, "__doc__", None) or "").strip().splitlines()]
    return lines[0].replace("``", "") if lines else ""


def _sentence(text: str) -> str:
    text = text.strip().rstrip(".")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def words(name: Any) -> str:
    """A name without underscores."""
    return str(name).replace("_", " ")
