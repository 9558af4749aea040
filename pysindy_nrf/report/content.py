"""Content of the page and of Markdown, gathered from a report of the loop, a regressor
or a model, and its words.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from ..chain.latex import (
    Estimate,
    as_text,
    balance_equations,
    law_equation,
    pretty,
    shape_values,
)
from ..chain.model import ChainModel
from ..common.audit import settings_of, versions
from ..diagnosis.verdict import (
    OPEN,
    Bounds,
    Verdict,
    effect_words,
    nonlinear_parts,
    shares_of,
    verdict_on,
)
from ..discrepancy.prepare import prepare
from ..discrepancy.residual import SiteLoop, loops_of, residual_of
from ..exceptions import NRFError
from ..laws.base import registry
from ..records.checks.channel_checks import Measured, measured
from ..records.record import Record
from ..records.zero_phase_filter import filters_of
from .figures.evidence import (
    before_after_figure,
    dependence_figures,
    evidence_figures,
    residual_figure,
)
from .figures.figure import Figure, Table, dof_words, table
from .figures.forces import force_figure, loop_figures
from .figures.matplotlib_renderer import Drawing
from .figures.motion import free_run_figure, modes_figure


@dataclass
class SiteSection:
    """One site of the model: equation, shape parameters, figures."""

    site: str
    equation: list[str]
    shapes: list[str]
    figures: list[Figure]


@dataclass
class Content:
    """Everything the template shows."""

    balances: list[list[str]]
    sites: list[SiteSection]
    tables: list[Table]
    figures: list[Figure]
    audit: list[Table]
    equation_text: list[str]
    title: str = ""
    lead: str = ""
    verdict: Verdict | None = None
    care: list[str] = field(default_factory=list)
    frame: Frame | None = None
    picture: list[Figure] = field(default_factory=list)
    stopped: str = ""
    tiles: list[tuple[str, str, str]] = field(default_factory=list)
    measured: list[tuple[Measured, Table]] = field(default_factory=list)
    chapters: list[Chapter] = field(default_factory=list)
    effects: Table | None = None
    errors: list[Figure | Table] = field(default_factory=list)


@dataclass
class Frame:
    """The structure as it is drawn: floors and storeys from the ground up, in words and
    by state, other sites below.
    """

    floors: list[
        tuple[str, bool, bool]
    ]  # mass in words, whether it is forced, whether its balance is open
    storeys: list[
        tuple[str, str]
    ]  # stiffness in words; "", "linear", "nonlinear" or "guilty"
    others: list[str]
    shaken: bool = False


def _frame(
    model: ChainModel,
    bounds: Bounds,
    guilty: Mapping[str, str],
    opened: Sequence[int],
    seen: Sequence[Measured],
) -> Frame:
    """Drawing of a model; ``guilty`` are the sites of what was found, with its
    words.
    """
    forced = {j for m in seen for j in m.forced}
    forces, storeys = model.restoring_forces, []
    for j in range(1, model.n_dof + 1):
        force = forces[j] if f"storey {j}" in map(str, forces) else None
        if force is None or not force.laws:
            storeys.append(("", ""))
            continue
        k, ends = (
            float(force.linear_part()["k"]) / 1e3,
            bounds.get(f"storey {j}: s", (np.nan, np.nan)),
        )
        words = (
            f"k{j} = {as_text(Estimate(k, ends[0] / 1e3, ends[1] / 1e3))} kN/m"
            if k
            else f"storey {j}"
        )
        storeys.append((words, "guilty" if f"storey {j}" in guilty else "linear"))
    floors = [
        (
            f"m{j} = {as_text(Estimate(m, *bounds.get(f'm{j}', ())))} kg",
            j in forced,
            j in opened,
        )
        for j, m in enumerate(model.masses, 1)
    ]
    return Frame(
        floors, storeys, list(guilty.values()), any(m.base_moves for m in seen)
    )


def of_loop(report: Any, title: str | None = None) -> Content:
    """Page of a closed loop."""
    content = _model_part(report.model, report.loops, report.bounds)
    content.verdict = report.verdict
    content.title = (
        title or listed(m.name for m in report.measured[:3]) or "Closing the loop"
    )
    content.lead, content.stopped, content.care = (
        lead(report),
        report.stopped_because,
        list(report.verdict.reasons),
    )
    last, held = report.final, confirmed(report)
    since = [
        f"from {x:.3g} %" if held else ""
        for x in report.table.iloc[0][["held-out", "free run"]]
    ]
    doubtful = len(report.steps) - len(held)
    content.tiles = [
        (
            "Effects confirmed",
            str(len(held)),
            f"{doubtful} more not confirmed" if doubtful else "",
        ),
        (
            "Held-out balance error",
            f"{last['held-out']:.3g} %",
            since[0] or "the baseline's",
        ),
    ]
    if np.isfinite(last["free run"]):
        content.tiles.append(
            ("Held-out free-run error", f"{last['free run']:.3g} %", since[1])
        )
    content.tiles.append(("Band", band_text(report.band), band_source(report)))
    content.measured = [(m, _channels(m)) for m in report.measured]
    content.chapters = chapters(report)
    content.effects = effects(report)
    opened = [
        j
        for j in range(1, report.model.n_dof + 1)
        if last.get(f"held-out dof {j}", 0.0) > OPEN
    ]
    content.frame = _frame(
        report.model,
        report.bounds,
        {s.site: _effect(s) for s in held},
        opened,
        report.measured,
    )
    content.picture = pictures(report)
    content.errors = [errors(report)]
    content.audit.insert(
        1, _settings(report.settings or settings_of(loop={"band": report.band}))
    )
    return content


def pictures(report: Any) -> list[Figure]:
    """What comes first of a closed loop: before and after, the missing force, the free
    run.
    """
    out = [before_after_figure(report)]
    first = _first(report)
    if first is not None and first.characterisation is not None:
        out += dependence_figures(first.characterisation, f" at {first.site}")[1:]
    return out + free_run_figure(report.free_runs)


def _first(report: Any) -> Any:
    """The evidence of the first confirmed effect, whose missing force is drawn first;
    None without one.
    """
    return next((e for e, s in zip(report.evidence, report.steps) if s.confirmed), None)


def _effect(step: Any) -> str:
    """An effect with its size and interval, in words."""
    units = {name: unit for name, unit in step.units.items() if name not in step.shape}
    return effect_words(step.law, step.site, step.parameters, step.intervals, units)


def loop_verdict(report: Any) -> Verdict:
    """The verdict on a report of the loop."""
    last = report.final
    balances = {
        j: float(last.get(f"held-out dof {j}", np.nan))
        for j in range(1, report.model.n_dof + 1)
    }
    stopped = (
        sentence(report.stopped_because)
        if "Nothing is claimed" in report.stopped_because
        else ""
    )
    found = [_effect(step) for step in confirmed(report)]
    known = [
        j for j, m in enumerate(report.model.masses, 1) if f"m{j}" not in report.bounds
    ]
    return verdict_on(
        report.model,
        balances,
        found,
        report.free_runs,
        report.bounds,
        known_masses=known,
        doubts=cautions(report),
        faults=report.faults,
        stopped=stopped,
        follows=float(last["free run"]),
        wiring=lambda: report.wiring,
    )


def of_model(
    subject: Any,
    records: Any = None,
    title: str | None = None,
    notes: Sequence[str] = (),
    band: Any = None,
) -> Content:
    """Page of an identification: of a model, or of a fitted regressor (over its own
    data without records).
    """
    model: ChainModel = getattr(subject, "model_", subject)
    known = model.info.get("band")
    band = band if band is not None else None if known is None else tuple(known)
    notes = list(notes)
    data, filters = _data(subject, records, band)
    loops, sizes = [], pd.DataFrame()
    if data is not None:
        loops = loops_of(model, data, filters)
        try:
            sizes = residual_of(model, data, filters).sizes
        except NRFError as error:
            notes.append(str(error))
    bounds = subject.bounds()[0] if hasattr(subject, "bounds") else {}
    content = _model_part(model, loops, bounds)
    content.picture = [] if (figure := residual_figure(sizes)) is None else [figure]
    given = [records] if isinstance(records, Record) else list(records or ())
    seen, opened = (
        [
            measured(record, seg.noise)
            for record, seg in zip(given, data.segments if given else ())
        ],
        [],
    )
    if hasattr(subject, "errors_"):
        content.verdict = subject.verdict()
        balances = subject.errors_
        opened = [
            int(k[4:])
            for k, e in balances["error"].items()
            if k != "pooled" and e > OPEN
        ]
        pooled = f"{balances.loc['pooled', 'error']:.3g} %"
        content.tiles.append(("Balance error, pooled", pooled, "on the fitted data"))
        heads = {
            "error": "error (%)",
            "residual": "residual rms (N)",
            "reference": "reference rms (N)",
            "of": "of",
        }
        balances = balances.set_axis([dof_words(i) for i in balances.index])
        content.errors.append(
            table(
                "Balance errors on the fitted data, percent NRMSE",
                balances,
                heads,
                "balance",
            )
        )
    if data is not None:
        content.picture += free_run_figure(
            subject.free_runs() if hasattr(subject, "free_runs") else None
        )
    guilty = (
        {} if data is None else nonlinear_parts(model, shares_of(model, data), bounds)
    )
    content.frame = _frame(model, bounds, guilty, opened, seen)
    gap: Any = getattr(subject, "third_law_gap_", ())
    if len(gap):
        caption = "Newton's third law: how far the two estimates of one storey differ"
        rows = [[str(site), x] for site, x in gap.items()]
        content.errors.append(
            Table(caption, ["storey", "difference (% of its rms)"], rows)
        )
    missing: Any = getattr(subject, "missing_terms_", ())
    if len(missing):
        shown = missing.assign(biased=np.where(missing["biased"], "yes", "no"))
        content.errors.append(
            table(
                "What terms beyond the laws would explain",
                shown,
                _MISSING,
                "step of the solve",
            )
        )
    content.tiles += [
        ("Total mass", f"{float(model.masses.sum()):.4g} kg", ""),
        ("Band", band_text(band), ""),
    ]
    content.title = title or listed(m.name for m in seen[:3]) or "Chain model"
    forces = sum(bool(held) for held in model.laws.values())
    content.lead = (
        f"{model.n_dof} mass{'es' * (model.n_dof > 1)} and {forces} restoring"
        f" force{'s' * (forces != 1)}."
    )
    content.measured = [(m, _channels(m)) for m in seen]
    content.care = list(
        dict.fromkeys([*(content.verdict.reasons if content.verdict else ()), *notes])
    )
    groups = {
        "model": (
            {k: v for k, v in model.info.items() if k not in ("command", "inputs")}
            | {"band": band}
        )
    }
    if hasattr(subject, "get_params"):
        groups = {"regressor": subject.get_params(deep=False), **groups}
    content.audit.insert(1, _settings(settings_of(**groups)))
    return content


def drawing(regressor: Any) -> Drawing:
    """The force of every site of a fitted regressor over its drift, and its free
    run.
    """
    data = regressor.fit_data("Fit again to draw the model over its data.")
    loops = loops_of(regressor.model_, data, regressor.problem_.filters(data))
    return Drawing(
        [
            *loop_figures(regressor.model_, loops),
            *free_run_figure(regressor.free_runs()),
        ]
    )


# columns of ``missing_terms_`` of a regressor, in words
_MISSING = {
    "residual": "residual (% of its force)",
    "gain": "held-out part of it that further terms remove (%)",
    "missing": "size of these terms (% of its force)",
    "shift": "mass moves with them by (%)",
    "lasting": "part of it that a constant or a straight line in time removes (%)",
    "biased": "a law is missing",
}


def _model_part(
    model: ChainModel, loops: Sequence[SiteLoop], bounds: Bounds
) -> Content:
    """Equations, sites, masses, coefficients, modes."""
    by_site = {loop.site: loop for loop in loops}
    sections = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        loop = by_site.get(str(site))
        surface = force_figure(model, site, loop)
        shown = [
            *([] if surface is None else [surface]),
            *loop_figures(model, [] if loop is None else [loop]),
        ]
        sections.append(
            SiteSection(
                str(site), law_equation(force, bounds), shape_values(force), shown
            )
        )
    rows = [
        [f"m{j}", *_with_ends(m, bounds.get(f"m{j}"))]
        for j, m in enumerate(model.masses, 1)
    ]
    masses = _bounded(
        "Masses", ["mass", "estimate (kg)", "lower (kg)", "upper (kg)"], rows, 2
    )
    tables, figures = [masses, _coefficients(model, bounds)], []
    if (model.masses > 0).all():
        try:
            modes = model.modes()
        except (NRFError, np.linalg.LinAlgError):
            modes = pd.DataFrame()
        if len(modes):
            heads = {"frequency": "frequency (Hz)", "damping": "damping ratio"}
            heads |= {c: dof_words(c) for c in modes.columns if c.startswith("dof")}
            tables.append(table("Modes of the linear part", modes, heads, index="mode"))
            figures.append(modes_figure(modes))
    audit = [
        _run(model.info),
        Table("Versions", ["package", "version"], [*map(list, versions().items())]),
    ]
    return Content(
        balance_equations(model),
        sections,
        tables,
        figures,
        audit,
        str(model).splitlines(),
    )


def _run(info: Mapping[str, Any]) -> Table:
    """What was run, when, and on which files."""
    rows = [["command", info["command"]]] if "command" in info else []
    rows.append(["written", datetime.now().astimezone().isoformat(" ", "seconds")])
    rows += [
        [one["file"], f"{one['bytes']} bytes, SHA-256 {one['sha256']}"]
        for one in info.get("inputs", ())
    ]
    return Table("This run", ["what", "value"], rows)


def _coefficients(model: ChainModel, bounds: Bounds) -> Table:
    rows: list[list[Any]] = []
    for site, force in model.restoring_forces.items():
        for (term, value), unit in zip(force.coefficients.items(), force.units):
            rows.append(
                [
                    str(site),
                    pretty(str(term)),
                    pretty(unit),
                    *_with_ends(value, bounds.get(f"{site}: {term}")),
                ]
            )
        shapes = (
            (law, name, x)
            for law in force.laws
            for name, x in law.shape.items()
            if x is not None
        )
        said = (
            (f"{n} ({names(law.name)})", pretty(law.units[n]), x)
            for law, n, x in shapes
        )
        rows += [
            [str(site), name, unit, *_with_ends(x, None)] for name, unit, x in said
        ]
    return _bounded(
        "Coefficients",
        ["site", "term or shape parameter", "unit", "estimate", "lower", "upper"],
        rows,
        4,
    )


def _with_ends(value: float, ends: Any) -> list[float]:
    """An estimate and its interval, with the digits that the interval leaves; faint
    where it holds zero.
    """
    low, high = ends or (np.nan, np.nan)
    return [Estimate(x, low, high) for x in (float(value), low, high)]


def _bounded(caption: str, head: list[str], rows: list[list[Any]], width: int) -> Table:
    """A table without the columns of intervals where there are none."""
    if not rows or np.isnan([row[width] for row in rows]).all():
        return Table(caption, head[:width], [row[:width] for row in rows])
    return Table(f"{caption}, with 95 % intervals", head, rows)


def _channels(m: Measured) -> Table:
    heads = {"what": "what it is", "noise": "noise estimate, rms"}
    shown = m.channels.assign(unit=[pretty(str(u)) for u in m.channels["unit"]])
    return table(f"Channels of {m.name}", shown.dropna(axis=1, how="all"), heads)


def _settings(groups: dict[str, dict[str, Any]]) -> Table:
    def said(value: Any) -> str:
        """A setting in words; numbers of a mapping to four digits."""
        if (
            isinstance(value, dict)
            and value
            and all(isinstance(x, float) for x in value.values())
        ):
            return listed(f"{key}: {as_text(x)}" for key, x in value.items())
        return str(value)

    rows = [
        [group, k, said(v)]
        for group, values in groups.items()
        for k, v in values.items()
    ]
    return Table("Every setting of this run", ["of", "setting", "value"], rows)


def _data(subject: Any, records: Any, band: Any) -> tuple[Any, Any]:
    """Data to draw the model over, and the filter of each record."""
    kept = getattr(getattr(subject, "result_", None), "data", None)
    if records is None and kept is None:
        return None, None
    given = [records] if isinstance(records, Record) else list(records or ())
    fitted = kept.records if kept is not None else ()
    if kept is not None and (
        records is None or list(map(id, given)) == list(map(id, fitted))
    ):
        return kept, filters_of(band, kept)  # they need not be fused again
    data = prepare(given).data
    return data, filters_of(band, data)


@dataclass
class Chapter:
    """One step of the loop's story, or what is left at its end."""

    title: str
    lead: str
    facts: list[tuple[str, str]]
    tables: list[Table]
    badge: str = ""
    state: str = ""
    figures: list[Figure] = field(default_factory=list)


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
    return f"above {low:.4g} Hz" if high is None else f"{low or 0:.4g} to {high:.4g} Hz"


def band_source(report: Any) -> str:
    """Where the band of a closed loop comes from, if its settings say so."""
    given = report.settings.get("loop", {}).get("band")
    return "" if given is None else given if given.startswith("found") else "as given"


def confirmed(report: Any) -> list[Any]:
    """The effects that held-out data confirm: those of the model."""
    return [step for step in report.steps if step.confirmed]


def standing(step: Any) -> str:
    """What held-out data say of an effect."""
    return "confirmed" if step.confirmed else "NOT CONFIRMED"


def joined(parts: Sequence[str]) -> str:
    """Words with commas and a last "and"."""
    return parts[0] if len(parts) == 1 else f"{listed(parts[:-1])} and {parts[-1]}"


def lead(report: Any) -> str:
    """The whole story in a few sentences: effects that are confirmed, and what is not
    to be relied on.
    """
    before, after = report.table["held-out"].iloc[0], report.final["held-out"]
    found = [_where(step) for step in confirmed(report)]
    if found:
        them = "it" if len(found) == 1 else "them"
        told = (
            f"The declared model lacked {joined(found)}, confirmed on held-out data:"
            f" with {them} the balance error "
        )
        told += f"there falls from {before:.3g} to {after:.3g} %."
    else:
        told = (
            f"The declared model leaves {before:.3g} % of the balances unexplained on"
            " held-out data, and the loop "
        )
        told += "added nothing to it."
        if not report.steps and "Nothing is claimed" in report.stopped_because:
            told += f" {sentence(report.stopped_because)}"
    refused = [_where(step) for step in report.steps if not step.confirmed]
    if refused:
        told += (
            f" NOT CONFIRMED on held-out data, and not in the model: {joined(refused)}."
        )
    unsure = [names(step.law) for step in confirmed(report) if not step.sure]
    return f"{told} Not sure by name: {listed(unsure)}." if unsure else told


def _where(step: Any) -> str:
    return f"{names(step.law)} at {step.site}"


def effects(report: Any) -> Table | None:
    """Every effect with its gain, in the order of acceptance; None if there is none."""
    sizes = ("gain", "gain_error", "gain_least", "gain_heldout")
    rows = [
        [_where(s), *(getattr(s, x) for x in sizes), 100 * s.share, standing(s)]
        for s in report.steps
    ]
    head = [
        "effect",
        "gain (dB)",
        "std. error (dB)",
        "least (dB)",
        "held-out gain (dB)",
        "share of force (%)",
    ]
    head.append("held-out data")
    return (
        Table("Effects in the order in which they were accepted", head, rows)
        if rows
        else None
    )


def errors(report: Any) -> Table:
    """Errors of the baseline and with each effect, and whether held-out data confirm
    it.
    """
    alone = ["held-out dof 1"] if report.model.n_dof == 1 else []  # is the pooled one
    shown = report.table.drop(columns=["band", *alone], errors="ignore")
    shown.index = [names(n) for n in shown.index]
    if report.steps:
        shown["held-out data"] = ["", *map(standing, report.steps)]
    return table(
        "Errors, percent NRMSE",
        shown,
        {c: f"{dof_words(c)} (%)" for c in report.table},
        index="model",
    )


def chapters(report: Any) -> list[Chapter]:
    """One chapter for each step, and the last on what is left."""
    evidence = list(report.evidence) + [None] * (
        len(report.steps) + 1 - len(report.evidence)
    )
    out = [_step(k, step, evidence[k - 1]) for k, step in enumerate(report.steps, 1)]
    out, first = [*out, _end(evidence[len(report.steps)], report)], _first(report)
    for chapter, one in zip(out, evidence):
        chapter.figures = (
            [] if one is None else evidence_figures(one, means=one is not first)
        )
    return out


def cautions(report: Any) -> list[str]:
    """What makes the result doubtful."""
    out = []
    for step in report.steps:
        law = _where(step)
        begin = law[:1].upper() + law[1:]
        if not step.confirmed:
            change = f"{step.error_before:.3g} to {step.error_after:.3g} %"
            out.append(
                f"{begin} is NOT CONFIRMED: the held-out error goes from {change}. The"
                " model does not hold it."
            )
            continue
        if not (step.sure or step.alternatives or step.company):
            out.append(
                f"{begin} is only the closest law: {100 * step.remainder:.0f} % of the"
                f" effect stays unexplained, and the gain is {step.gain:.2g} dB with a"
                f" standard error of {step.gain_error:.2g}."
            )
        out += _not_told_apart(step)
        if step.free_run_after > 1.1 * step.free_run_before:
            out.append(
                f"With {law} the held-out free run is worse than before"
                f" ({step.free_run_before:.3g} to {step.free_run_after:.3g} %), though"
                " the balances close better."
            )
    closed = {
        name: why
        for e in report.evidence
        for name, why in e.not_possible.items()
        if not why.expected
    }
    out += [
        sentence(f"{name} was not possible because {why.reason}")
        for name, why in closed.items()
    ]
    if any(e.floor is None for e in report.evidence):
        out.append(
            "What noise alone would leave is not known here: an unmeasured force is not"
            " told from noise."
        )
    return list(dict.fromkeys(out))


def _not_told_apart(step: Any) -> list[str]:
    """What else the data allow instead of an effect."""
    out = []
    if step.alternatives:
        others = listed(map(names, step.alternatives))
        out.append(
            f"At {step.site} the data cannot tell {names(step.family)} from {others}."
        )
    if step.company:
        together = joined(sorted(names(law) for law in (step.law, *step.company)))
        out.append(
            f"At {step.site} {together} may together stand for one law that is not in"
            " the catalogue."
        )
    if step.sensors:
        out.append(
            f"The same fault, reversed, at {' or '.join(step.sensors)} explains as much"
            f" as {_where(step)}."
        )
    return out


def _step(number: int, step: Any, evidence: Any) -> Chapter:
    """What was seen, decided and gained with one effect."""
    facts = [*_seen(evidence), ("Decision", sentence(step.evidence))]
    said = (
        f"{standing(step)}: balance error {step.error_before:.3g} →"
        f" {step.error_after:.3g} %, gain "
    )
    said += f"{step.gain_heldout:.2g} dB" + "; the model does not hold this effect" * (
        not step.confirmed
    )
    facts.append(("Held-out data", said))
    if np.isfinite(step.free_run_before) and np.isfinite(step.free_run_after):
        facts.append(
            (
                "Held-out free-run error",
                f"{step.free_run_before:.3g} → {step.free_run_after:.3g} %",
            )
        )
    apart = _not_told_apart(step)
    if apart and step.confirmed:
        facts.append(("What else it may be", " ".join(apart)))
    tables = [_parameters(step)]
    if step.tied:
        rows = [[names(law), site, float(gain)] for law, site, gain in step.tied]
        tables.append(
            Table(
                f"The data cannot tell from {names(step.law)}",
                ["law", "site", "gain (dB)"],
                rows,
            )
        )
    title = (
        f"Step {number}:"
        f" {'' if step.sure or not step.confirmed else 'closest law: '}{_where(step)}"
    )
    doc = (
        getattr(registry().get(step.law), "__doc__", None) or ""
    ).strip()  # the law's own first line
    about = doc.splitlines()[0].strip().replace("``", "") if doc else ""
    return Chapter(title, about, facts, tables, step.family, standing(step))


def _end(evidence: Any, report: Any) -> Chapter:
    """What is left, and the candidates that were refused."""
    tables = []
    if len(report.candidates):
        best = report.candidates.head(10)
        rows = [[names(law), *rest] for law, *rest in best.to_numpy().tolist()]
        tables.append(
            Table("The best candidates of the last search", list(best.columns), rows)
        )
    if len(report.lack_of_fit):
        rows = report.lack_of_fit.reset_index().to_numpy().tolist()
        tables.append(
            Table(
                "What general laws would still gain",
                ["site", "law", "gain (dB)", "standard error"],
                rows,
            )
        )
    return Chapter(
        "What is left",
        "",
        [*_seen(evidence), ("Why it stopped", sentence(report.stopped_because))],
        tables,
    )


def _seen(evidence: Any) -> list[tuple[str, str]]:
    """Answers to the three questions asked before any law is tried."""
    asked = {
        "Is it noise?": "detection",
        "Where?": "localisation",
        "What kind?": "characterisation",
    }
    return (
        []
        if evidence is None
        else [(words, evidence.sentences[x]) for words, x in asked.items()]
    )


def _parameters(step: Any) -> Table:
    """Parameters of a step with their units, and intervals where they are known."""
    ends = pd.DataFrame.from_dict(
        step.intervals or {}, orient="index", columns=["lower", "upper"]
    )
    frame = (
        pd.DataFrame({"estimate": pd.Series(step.parameters, dtype=float)})
        .join(ends)
        .dropna(axis=1, how="all")
    )
    rows = [
        [name, *values, pretty(step.units.get(str(name), ""))]
        for name, *values in frame.itertuples(name=None)
    ]
    return Table(
        f"Parameters of {names(step.law)} at {step.site}",
        ["parameter", *frame.columns, "unit"],
        rows,
    )
