"""Words of the loop's report, for the page, for Markdown and for the console: one chapter for each step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
import pandas as pd

from ...discrepancy.verdicts import Agreement
from ...discrepancy.words import obstacle
from ..displays._figure import Figure, Table
from ..displays.evidence import evidence_figures
from .equations import pretty_unit


@dataclass
class Chapter:
    """One step of the loop's story, or what is left at its end."""

    title: str
    lead: str
    facts: list[tuple[str, str]]
    tables: list[Table]
    badge: str = ""
    evidence: Any = None

    @property
    def figures(self) -> list[Figure]:
        """Figures of the evidence."""
        return [] if self.evidence is None else evidence_figures(self.evidence)


def names(name: Any) -> str:
    """A name without underscores."""
    return str(name).replace("_", " ")


def listed(parts: Iterable[Any]) -> str:
    """Words with commas between them."""
    return ", ".join(map(str, parts))


def sentence(text: str) -> str:
    """Words with a capital and a full stop."""
    text = text.strip().rstrip(".")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def band_text(band: Any) -> str:
    """A band in words."""
    low, high = band if band is not None else (None, None)
    if not low and high is None:
        return "all frequencies"
    return f"above {low:g} Hz" if high is None else f"{low or 0:g} to {high:g} Hz"


def lead(report: Any) -> str:
    """The whole story in two sentences."""
    errors = report.table["held-out"]
    if not report.steps:
        return (
            f"The declared model leaves {errors.iloc[0]:.3g} % of the balances unexplained on held-out data, and the "
            "loop added nothing to it."
        )
    found = [f"{names(s.law)} at {s.site}" for s in report.steps]
    told = found[0] if len(found) == 1 else f"{listed(found[:-1])} and {found[-1]}"
    unsure = [names(s.law) for s in report.steps if not s.sure]
    doubt = f" Not sure by name: {listed(unsure)}." if unsure else ""
    return (
        f"The declared model lacked {told}. With {'it' if len(found) == 1 else 'them'} the balance error on held-out "
        f"data falls from {errors.iloc[0]:.3g} to {errors.iloc[-1]:.3g} %.{doubt}"
    )


def chapters(report: Any) -> list[Chapter]:
    """One chapter for each step, and the last on what is left."""
    evidence = list(report.evidence) + [None] * (len(report.steps) + 1 - len(report.evidence))
    out = [_step(k, step, evidence[k - 1], report) for k, step in enumerate(report.steps, 1)]
    return [*out, _end(evidence[len(report.steps)], report)]


def cautions(report: Any) -> list[str]:
    """What makes the result doubtful."""
    out = []
    for step, evidence in zip_longest(report.steps, report.evidence[: len(report.steps)]):
        law = f"{names(step.law)} at {step.site}"
        if not step.sure:
            out.append(f"{law} is only the closest law: {100 * step.remainder:.0f} % of the effect stays unexplained.")
        if step.alternatives:
            others = listed(map(names, step.alternatives))
            out.append(f"At {step.site} the data cannot tell {names(step.family)} from {others}.")
        if evidence is not None and evidence.agreement == Agreement.DISAGREES:
            out.append(f"Localisation and the loop disagree about {law}; see its step.")
        if step.free_run_after > 1.1 * step.free_run_before:
            out.append(
                f"With {law} the held-out free run is worse than before ({step.free_run_before:.3g} to "
                f"{step.free_run_after:.3g} %), though the balances close better."
            )
    out += not_positive(report.model.masses, "not positive")
    closed = {name: why for e in report.evidence for name, why in e.not_possible.items() if not why.expected}
    out += [sentence(f"{name} was not possible because {obstacle(why)}") for name, why in closed.items()]
    if any(e.floor is None for e in report.evidence):
        out.append("What noise alone would leave is not known here; noise is taken to be white within the band.")
    return list(dict.fromkeys(out))


def not_positive(masses: Any, what: str) -> list[str]:
    """A sentence on masses that no structure has."""
    bad = [f"m{j}" for j, m in enumerate(masses, 1) if m <= 0]
    return [f"{listed(bad)} came out {what}: the data do not determine this balance."] if bad else []


def _step(number: int, step: Any, evidence: Any, report: Any) -> Chapter:
    """What was seen, decided and gained with one effect."""
    decision = sentence(step.evidence)
    if np.isfinite(step.null_gain):
        decision += f" On surrogates with noise alone the same law gains at most {100 * step.null_gain:.0f} %."
    facts = [*_seen(evidence), ("Decision", decision)]
    facts.append(("Held-out balance error", f"{step.error_before:.3g} → {step.error_after:.3g} %"))
    if np.isfinite(step.free_run_before) and np.isfinite(step.free_run_after):
        facts.append(("Held-out free-run error", f"{step.free_run_before:.3g} → {step.free_run_after:.3g} %"))
    facts.append(("In one line", step.sentence))
    tables = [_parameters(step, report.model)]
    if step.tied or step.runners_up:
        tables.append(_others(step))
    where = f"{names(step.law)} at {step.site}"
    title = f"Step {number}: {where}" if step.sure else f"Step {number}: closest law: {where}"
    return Chapter(title, _about(step), facts, tables, step.family, evidence)


def _end(evidence: Any, report: Any) -> Chapter:
    """What is left, and the candidates that were refused."""
    tables = []
    if len(report.candidates):
        rows = [[names(law), *rest] for law, *rest in report.candidates.head(10).to_numpy().tolist()]
        head = ["law", "family", "site", "validation error (%)"]
        tables.append(Table("The best candidates of the last search", head, rows))
    facts = [*_seen(evidence), ("Why it stopped", sentence(report.stopped_because))]
    return Chapter("What is left", "", facts, tables, evidence=evidence)


def _seen(evidence: Any) -> list[tuple[str, str]]:
    """Answers to the three questions asked before any law is tried."""
    if evidence is None:
        return []
    return [
        ("Is it noise?", evidence.detection_sentence),
        ("Where?", evidence.localisation_sentence),
        ("What kind?", evidence.characterisation_sentence),
    ]


def _parameters(step: Any, model: Any) -> Table:
    """Parameters of a step with their units, and intervals where they are known."""
    from ...laws.base import registry

    units: dict[str, str] = {}
    held = [law for laws in model.laws.values() for law in laws if law.name == step.law]
    law = next((law for law in held if dict(law.parameters) == step.parameters), registry().get(step.law))
    if law is not None:
        units = {p.name: p.unit for p in law.shapes}
        if not isinstance(law, type):
            units |= {t.symbol: t.unit for t in law.terms()}
    ends = pd.DataFrame.from_dict(step.intervals or {}, orient="index", columns=["lower", "upper"])
    frame = pd.DataFrame({"estimate": pd.Series(step.parameters, dtype=float)}).join(ends).dropna(axis=1, how="all")
    rows = [[name, *values, pretty_unit(units.get(str(name), ""))] for name, *values in frame.itertuples(name=None)]
    return Table(f"Parameters of {names(step.law)} at {step.site}", ["parameter", *frame.columns, "unit"], rows)


def _others(step: Any) -> Table:
    """Laws that came close."""
    tied = {(law, site) for law, site, _ in step.tied}
    rows = [[names(law), site, float(error), "within 10 %: tied"] for law, site, error in step.tied]
    rows += [[names(law), site, float(error), ""] for law, site, error in step.runners_up if (law, site) not in tied]
    head = ["law", "site", "validation error (%)", "remark"]
    return Table(f"Other laws that were tried beside {names(step.law)}", head, rows)


def _about(step: Any) -> str:
    """The first line of the law's own documentation."""
    from ...laws.base import registry

    law = registry().get(step.law)
    lines = [line.strip() for line in (getattr(law, "__doc__", None) or "").strip().splitlines()]
    return lines[0].replace("``", "") if lines else ""
