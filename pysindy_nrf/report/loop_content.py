"""The page of a closed loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..chain.latex import pretty
from ..chain.model import parameters_of
from ..common.audit import settings_of
from ..diagnosis.effects import (
    as_sentence,
    described,
    law_at_site,
    not_told_apart,
    plain_name,
)
from ..diagnosis.evidence import Evidence
from ..diagnosis.wiring import OPEN
from ..drawing.figure import Figure, dof_words
from ..drawing.tables import Table, table
from ..laws.base import registry
from .content import (
    Chapter,
    Content,
    Tile,
    audit_part,
    frame_of,
    measured_part,
    model_part,
    names_of,
)
from .figures.evidence import (
    before_after_figure,
    dependence_figures,
    evidence_figures,
    missing_force_figures,
)
from .figures.intervals import intervals_figure
from .figures.motion import free_run_figures
from .model_content import DRAWN_FREE_RUNS
from .results import Loop, Step, confirmed, first_evidence
from .words import band_source, band_text, joined, listed, standing, summary_of

# Candidates of the last search that are listed.
LISTED_CANDIDATES = 10
_QUESTIONS = {
    "Is it noise?": "detection",
    "Where?": "localisation",
    "What kind?": "characterisation",
}


def loop_content(report: Loop, title: str | None = None) -> Content:
    """The page of a closed loop."""
    by_site: dict[str, str] = {}
    for step in confirmed(report):
        before = f"{by_site[step.site]}; " if step.site in by_site else ""
        by_site[step.site] = before + described(step)
    open_dofs = []
    for j in range(1, report.model.n_dof + 1):
        if report.final.get(f"held-out dof {j}", 0.0) > OPEN:
            open_dofs.append(j)
    settings = report.settings or settings_of(loop={"band": report.band})
    return Content(
        title=title or names_of(report.measured) or "Closing the loop",
        lead=lead(report),
        model=model_part(report.model, report.loops, report.bounds),
        audit=audit_part(report.model.info, settings),
        verdicts={"": report.verdict},
        care=list(report.verdict.reasons),
        frame=frame_of(
            report.model, report.bounds, by_site, open_dofs, report.measured
        ),
        picture=pictures(report),
        stopped=report.stopped_because,
        tiles=_tiles(report),
        measured=measured_part(
            report.measured, report.model, report.quality, report.band
        ),
        chapters=chapters(report),
        effects=effects(report),
        errors=[errors(report), *_figures_of_errors(report)],
        units=report.model.units,
    )


def _figures_of_errors(report: Loop) -> list[Figure]:
    """Free runs of the other DOFs, and the intervals."""
    figures = free_run_figures(report.free_runs)[1:DRAWN_FREE_RUNS]
    intervals = intervals_figure(parameters_of(report.model), report.bounds)
    return figures if intervals is None else [*figures, intervals]


def lead(report: Loop) -> str:
    """The complete story in a few sentences."""
    parts = [_what_was_found(report)]
    refused = [law_at_site(step) for step in report.steps if not step.confirmed]
    if refused:
        parts.append(
            f"NOT CONFIRMED on held-out data, and not in the model: {joined(refused)}."
        )
    unsure = [plain_name(step.law) for step in confirmed(report) if not step.sure]
    if unsure:
        parts.append(f"Not sure by name: {listed(unsure)}.")
    if any(step.judged_by == "another record" for step in report.steps):
        parts.append(
            "The held-out records judged one effect after another, so their errors are"
            " not those of untouched data: a third record shows them."
        )
    return " ".join(parts)


def _what_was_found(report: Loop) -> str:
    """The effects that are confirmed, and what they change."""
    before, after = report.table["held-out"].iloc[0], report.final["held-out"]
    lacking = [law_at_site(step) for step in confirmed(report)]
    if lacking:
        them = "it" if len(lacking) == 1 else "them"
        return (
            f"The declared model lacked {joined(lacking)}, confirmed on held-out data:"
            f" with {them} the balance error there falls from {before:.3g} to"
            f" {after:.3g} %."
        )
    text = (
        f"The declared model leaves {before:.3g} % of the balances unexplained on"
        " held-out data, and the loop added nothing to it."
    )
    if report.nothing_claimed and not report.steps:
        text += f" {as_sentence(report.stopped_because)}"
    return text


def _tiles(report: Loop) -> list[Tile]:
    """Effects, errors and band in numbers."""
    n_confirmed = len(confirmed(report))
    n_refused = len(report.steps) - n_confirmed
    note = f"{n_refused} more not confirmed" if n_refused else ""
    tiles = [Tile("Effects confirmed", str(n_confirmed), note)]

    first, last = report.table.iloc[0], report.final
    since = f"from {first['held-out']:.3g} %" if n_confirmed else "the baseline's"
    error = f"{last['held-out']:.3g} %"
    tiles.append(Tile("Held-out balance error", error, since))
    if np.isfinite(last["free run"]):
        since = f"from {first['free run']:.3g} %" if n_confirmed else ""
        error = f"{last['free run']:.3g} %"
        tiles.append(Tile("Held-out free-run error", error, since))

    source = band_source(report.band, report.settings)
    tiles.append(Tile("Band", band_text(report.band), source))
    return tiles


def band_and_source(report: Loop) -> str:
    """The band of a closed loop, and where it comes from."""
    band, source = band_text(report.band), band_source(report.band, report.settings)
    return f"{band}, {source}" if source else band


def pictures(report: Loop) -> list[Figure]:
    """What comes first: errors before and after, the missing force, the free run."""
    figures = [before_after_figure(report), *_missing_force(report)]
    return figures + free_run_figures(report.free_runs)[:1]


def _missing_force(report: Loop) -> list[Figure]:
    """The force that the first effect carries; its mean where nothing measures it."""
    drawn = _law_over_missing_force(report)
    first = first_evidence(report)
    if drawn or first is None or first.characterisation is None:
        return drawn
    # what it depends on stands in the chapter
    where, units = f" at {first.site}", report.model.units
    return dependence_figures(first.characterisation, where, units)[1:]


def _law_over_missing_force(report: Loop) -> list[Figure]:
    """What the declared laws lack where the first effect acts, and the law found."""
    effects_found = confirmed(report)
    if not effects_found:
        return []
    site = effects_found[0].site
    added = {step.law for step in effects_found if step.site == site}
    for loop in report.loops:
        if loop.site == site:
            force = report.model.restoring_forces[site]
            return missing_force_figures(force, loop, added)
    return []


# -- tables --------------------------------------------------------------------


def effects(report: Loop) -> Table | None:
    """Every effect with its error reduction, as accepted; None if there is none."""
    if not report.steps:
        return None
    rows = []
    for step in report.steps:
        reductions = [
            step.reduction,
            step.reduction_error,
            step.reduction_least,
            step.reduction_heldout,
        ]
        share = 100 * step.share
        rows.append([law_at_site(step), *reductions, share, standing(step)])
    head = [
        "effect",
        "error reduction (dB)",
        "std. error (dB)",
        "least (dB)",
        "held-out reduction (dB)",
        "share of force (%)",
        "held-out data",
    ]
    return Table("Effects in the order in which they were accepted", head, rows)


def errors(report: Loop, columns: Sequence[str] | None = None) -> Table:
    """Errors of the baseline and with each effect.

    Parameters
    ----------
    report : LoopReport
    columns : sequence of str, optional
        Columns of its table; all but the band if None.
    """
    shown = report.table.drop(columns="band", errors="ignore")
    if report.model.n_dof == 1:  # the error of the only balance is the pooled one
        shown = shown.drop(columns="held-out dof 1", errors="ignore")
    if columns is not None:
        shown = shown[list(columns)]

    head = {name: f"{dof_words(name)} (%)" for name in shown}
    shown = shown.set_axis(map(plain_name, shown.index))
    if report.steps:
        shown["held-out data"] = ["", *map(standing, report.steps)]
    return table("Errors, percent NRMSE", shown, head, index="model")


def _parameters(step: Step) -> Table:
    """Parameters of a step with their units, and intervals where they are known."""
    estimates = pd.DataFrame({"estimate": pd.Series(step.parameters, dtype=float)})
    ends = pd.DataFrame.from_dict(
        dict(step.intervals), orient="index", columns=["lower", "upper"]
    )
    numbers = estimates.join(ends).dropna(axis=1, how="all")
    rows = []
    for name, *values in numbers.itertuples(name=None):
        rows.append([name, *values, pretty(step.units.get(str(name), ""))])
    head = ["parameter", *numbers.columns, "unit"]
    return Table(f"Parameters of {law_at_site(step)}", head, rows)


# -- chapters ------------------------------------------------------------------


def chapters(report: Loop) -> list[Chapter]:
    """One chapter for each step, and the last on what is left."""
    n_steps = len(report.steps)
    evidence: list[Evidence | None] = list(report.evidence)
    evidence += [None] * (n_steps + 1 - len(evidence))
    # its mean is pictured first where the law is not drawn over it
    first = None if _law_over_missing_force(report) else first_evidence(report)

    made = []
    for number, (step, before) in enumerate(zip(report.steps, evidence), 1):
        figures = _evidence_figures(report, before, before is first)
        made.append(_chapter_of_step(number, step, before, figures))
    after = evidence[n_steps]
    figures = _evidence_figures(report, after, after is first)
    made.append(_last_chapter(report, after, figures))
    return made


def _chapter_of_step(
    number: int, step: Step, evidence: Evidence | None, figures: list[Figure]
) -> Chapter:
    """What one effect was inferred from, and by how much it lowers the error."""
    facts = [*_answers(evidence), ("Decision", as_sentence(step.evidence))]
    facts.append(("Held-out data", _on_heldout(step)))
    if np.isfinite(step.free_run_before) and np.isfinite(step.free_run_after):
        change = f"{step.free_run_before:.3g} → {step.free_run_after:.3g} %"
        facts.append(("Held-out free-run error", change))
    others = not_told_apart(step)
    if others and step.confirmed:
        facts.append(("What else it may be", " ".join(others)))

    tables = [_parameters(step)]
    if step.rivals:
        rows = []
        for law_name, site, reduction in step.rivals:
            rows.append([plain_name(law_name), site, float(reduction)])
        caption = f"The data cannot distinguish from {plain_name(step.law)}"
        tables.append(Table(caption, ["law", "site", "error reduction (dB)"], rows))

    name = law_at_site(step)
    if step.confirmed and not step.sure:
        name = f"closest law: {name}"
    law = registry().get(step.law)
    return Chapter(
        f"Step {number}: {name}",
        facts,
        tables,
        "" if law is None else summary_of(law),
        step.family,
        standing(step),
        figures,
    )


def _on_heldout(step: Step) -> str:
    """What held-out data say of an effect."""
    text = (
        f"{standing(step)}: balance error {step.error_before:.3g} →"
        f" {step.error_after:.3g} %, error reduction {step.reduction_heldout:.2g} dB"
    )
    if not step.confirmed:
        text += "; the model does not hold this effect"
    return text


def _last_chapter(
    report: Loop, evidence: Evidence | None, figures: list[Figure]
) -> Chapter:
    """What is left, and the candidates that were refused."""
    tables = []
    if len(report.candidates):
        best = report.candidates.head(LISTED_CANDIDATES)
        rows = []
        for law, *numbers in best.to_numpy().tolist():
            rows.append([plain_name(law), *numbers])
        caption = "The best candidates of the last search"
        tables.append(Table(caption, list(best.columns), rows))
    if len(report.lack_of_fit):
        rows = report.lack_of_fit.reset_index().to_numpy().tolist()
        head = ["site", "law", "error reduction (dB)", "standard error"]
        tables.append(
            Table("What general laws would still remove of the error", head, rows)
        )

    why = ("Why it stopped", as_sentence(report.stopped_because))
    facts = [*_answers(evidence), why]
    return Chapter("What is left", facts, tables, figures=figures)


def _answers(evidence: Evidence | None) -> list[tuple[str, str]]:
    """Answers to the three questions asked before any law is tried."""
    if evidence is None:
        return []
    answers = []
    for question, name in _QUESTIONS.items():
        answers.append((question, evidence.sentences[name]))
    return answers


def _evidence_figures(
    report: Loop, evidence: Evidence | None, drawn_first: bool
) -> list[Figure]:
    """Figures of one step; what the page draws first is not drawn again."""
    if evidence is None:
        return []
    return evidence_figures(evidence, report.model.units, means=not drawn_first)
