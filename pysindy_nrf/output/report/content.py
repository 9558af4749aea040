"""Content of the page, gathered from a report of the loop, a regressor or a model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from ...common.audit import settings_of, versions
from ...data.record import Record
from ...discrepancy.site_loops import SiteLoop, loops_of
from ...exceptions import NRFError, NRFWarning
from ...regression.chain_model import ChainModel
from ...regression.segments import SegmentSet
from ...signals.measured import Measured, as_measured
from ..displays import BeforeAfterDisplay
from ..displays._figure import Figure, Table, dof_words, table
from ..displays.evidence import residual_figure
from ..displays.forces import force_figure, loop_figure
from ..displays.motion import modes_figure
from .equations import as_text, balance_equations, law_equation, pretty_label, pretty_unit, shape_values
from .story import Chapter, band_text, cautions, chapters, lead, listed, names


@dataclass
class Room:
    """One site of the model: equation, shape parameters, figures."""

    site: str
    equation: list[str]
    shapes: list[str]
    figures: list[Figure]


@dataclass
class Content:
    """Everything the template shows."""

    balances: list[list[str]]
    rooms: list[Room]
    tables: list[Table]
    figures: list[Figure]
    versions: Table
    equation_text: list[str]
    title: str = ""
    lead: str = ""
    kind: str = "identification"
    stopped: str = ""
    tiles: list[tuple[str, str, str]] = field(default_factory=list)
    measured: list[tuple[Measured, Table]] = field(default_factory=list)
    chapters: list[Chapter] = field(default_factory=list)
    errors: list[Figure | Table] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    settings: Table | None = None


def of_loop(report: Any, title: str | None = None) -> Content:
    """Page of a closed loop."""
    content = _model_part(report.model, report.loops, getattr(report, "intervals", None))
    content.kind, content.title = "loop", title or "Closing the loop"
    content.lead, content.stopped = lead(report), report.stopped_because
    last = report.table.iloc[-1]
    since = [f"from {x:.3g} %" if report.steps else "" for x in report.table.iloc[0][["held-out", "free run"]]]
    content.tiles = [
        ("Effects found", str(len(report.steps)), ""),
        ("Held-out balance error", f"{last['held-out']:.3g} %", since[0] or "the baseline's"),
    ]
    if np.isfinite(last["free run"]):
        content.tiles.append(("Held-out free-run error", f"{last['free run']:.3g} %", since[1]))
    content.tiles += [("Degrees of freedom", str(report.model.n_dof), ""), ("Band", band_text(report.band), "")]
    content.measured = [(m, _channels(m)) for m in report.measured]
    content.chapters = chapters(report)
    heads = {c: f"{dof_words(c)} (%)" for c in report.table if c != "band"} | {"band": "band (Hz)"}
    shown = report.table.assign(band=report.table["band"].astype(str).str.replace(" Hz", ""))
    shown.index = [names(n) for n in shown.index]
    content.errors = [
        *BeforeAfterDisplay.from_report(report).figures(),
        table("Errors, percent NRMSE", shown, heads, index="model"),
    ]
    content.warnings = cautions(report)
    content.settings = _settings(report.settings or settings_of(loop={"band": report.band}))
    return content


def of_model(
    subject: Any, records: Any = None, title: str | None = None, notes: Sequence[str] = (), band: Any = None
) -> Content:
    """Page of an identification: of a model, or of a fitted regressor (over its own data without records)."""
    model: ChainModel = getattr(subject, "model_", subject)
    known = model.info.get("band")
    band = band if band is not None else None if known is None else tuple(known)
    notes = list(notes)
    data, filters = _data(subject, records, band)
    loops, sizes = [], None
    if data is not None:
        from ...discrepancy.residual import residual_of

        loops = loops_of(model, data, filters)
        try:
            sizes = residual_of(model, data, filters).sizes
        except NRFError as error:
            notes.append(str(error))
    content = _model_part(model, loops, _intervals(subject, notes))
    content.tiles = [("Degrees of freedom", str(model.n_dof), "")]
    figure = None if sizes is None else residual_figure(sizes)
    content.errors += [] if figure is None else [figure]
    if hasattr(subject, "errors_"):
        errors = subject.errors_
        pooled = f"{errors.loc['pooled', 'error']:.3g} %"
        content.tiles.insert(0, ("Balance error, pooled", pooled, "on the fitted data"))
        heads = {"error": "error (%)", "residual": "residual rms (N)", "reference": "reference rms (N)", "of": "of"}
        errors = errors.set_axis([dof_words(i) for i in errors.index])
        content.errors.append(table("Balance errors on the fitted data, percent NRMSE", errors, heads, "balance"))
    gap: Any = getattr(subject, "third_law_gap_", ())
    if len(gap):
        caption = "Newton's third law: how far the two estimates of one storey differ"
        rows = [[str(site), x] for site, x in gap.items()]
        content.errors.append(Table(caption, ["storey", "difference (% of its rms)"], rows))
    missing: Any = getattr(subject, "missing_terms_", ())
    if len(missing):
        shown = missing.assign(biased=np.where(missing["biased"], "yes", "no"))
        content.errors.append(table("What terms beyond the laws would explain", shown, _MISSING, "step of the solve"))
    content.tiles += [("Total mass", f"{float(model.masses.sum()):.4g} kg", ""), ("Band", band_text(band), "")]
    forces = sum(bool(held) for held in model.laws.values())
    content.title = title or "Identified chain"
    content.lead = (
        f"{model.n_dof} mass{'es' if model.n_dof > 1 else ''} and {forces} restoring "
        f"force{'s' if forces != 1 else ''}, identified from measured forces and motions."
    )
    content.measured = [(m, _channels(m)) for m in as_measured(records)]
    content.warnings = notes
    groups = {"model": model.info | {"band": band}}
    if hasattr(subject, "get_params"):
        groups = {"regressor": subject.get_params(deep=False), **groups}
    content.settings = _settings(settings_of(**groups))
    return content


# columns of pysindy_nrf.diagnostics.missing_terms, in words
_MISSING = {
    "residual": "residual (% of its force)",
    "gain": "held-out part of it that further terms remove (%)",
    "missing": "size of these terms (% of its force)",
    "shift": "mass moves with them by (%)",
    "lasting": "part of it that a constant or a straight line in time removes (%)",
    "biased": "a law is missing",
}


def _model_part(model: ChainModel, loops: Sequence[SiteLoop], intervals: Any) -> Content:
    """Equations, sites, masses, coefficients, modes."""
    by_site = {loop.site: loop for loop in loops}
    rooms = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        loop = by_site.get(str(site))
        drawn = [force_figure(model, site, loop)]
        if loop is not None:
            spring = float(force.linear_part()["k"])
            drawn += [loop_figure(loop), *([loop_figure(loop, spring)] if spring else [])]
        rooms.append(Room(str(site), law_equation(force), shape_values(force), [f for f in drawn if f is not None]))
    bounds = bounds_of(intervals)
    tables, figures = [_masses(model, bounds), _coefficients(model, bounds)], []
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
    held = Table("Versions", ["package", "version"], [list(row) for row in versions().items()])
    return Content(balance_equations(model), rooms, tables, figures, held, str(model).splitlines())


def bounds_of(intervals: Any) -> dict[str, tuple[float, float]]:
    """Lower and upper bound by parameter name."""
    if not isinstance(intervals, pd.DataFrame) or "parameter" not in intervals:
        return {}
    return {str(r.parameter): (float(r.lower), float(r.upper)) for r in intervals.itertuples()}


_NO_BOUNDS = (float("nan"), float("nan"))


def _masses(model: ChainModel, bounds: dict[str, tuple[float, float]]) -> Table:
    rows = [[f"m{j}", float(m), *bounds.get(f"m{j}", _NO_BOUNDS)] for j, m in enumerate(model.masses, 1)]
    if not any(row[0] in bounds for row in rows):
        return Table("Masses", ["mass", "estimate (kg)"], [row[:2] for row in rows])
    return Table("Masses, with 95 % intervals", ["mass", "estimate (kg)", "lower (kg)", "upper (kg)"], rows)


def _coefficients(model: ChainModel, bounds: dict[str, tuple[float, float]]) -> Table:
    rows: list[list[Any]] = []
    for site, force in model.restoring_forces.items():
        for (term, value), unit in zip(force.coefficients.items(), force.units):
            ends = bounds.get(f"{site}: {term}", _NO_BOUNDS)
            rows.append([str(site), pretty_label(str(term)), float(value), *ends, pretty_unit(unit)])
        for law in force.laws:
            units = {p.name: p.unit for p in law.shapes}
            given = ((name, x) for name, x in law.shape.items() if x is not None)
            rows += [
                [str(site), f"{n} ({names(law.name)})", float(x), *_NO_BOUNDS, pretty_unit(units.get(n, "1"))]
                for n, x in given
            ]
    head = ["site", "term or shape parameter", "estimate", "lower", "upper", "unit"]
    if np.isnan([row[3] for row in rows]).all():
        head, rows = [*head[:3], "unit"], [[*row[:3], row[5]] for row in rows]
    return Table("Coefficients", head, rows)


def _channels(m: Measured) -> Table:
    heads = {"what": "what it is", "noise": "noise estimate, rms"}
    shown = m.channels.assign(unit=[pretty_unit(str(u)) for u in m.channels["unit"]])
    if not shown["noise"].notna().any():
        shown = shown.drop(columns="noise")
    return table(f"Channels of {m.name}", shown, heads)


def _settings(groups: dict[str, dict[str, Any]]) -> Table:
    rows = [[group, k, _said(v)] for group, values in groups.items() for k, v in values.items()]
    return Table("Every setting of this run", ["of", "setting", "value"], rows)


def _said(value: Any) -> str:
    """A setting in words; numbers of a mapping to four digits."""
    if isinstance(value, dict) and value and all(isinstance(x, float) for x in value.values()):
        return listed(f"{key}: {as_text(x)}" for key, x in value.items())
    return str(value)


def _intervals(subject: Any, notes: list[str]) -> Any:
    if not hasattr(subject, "confidence_intervals"):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NRFWarning)
            return subject.confidence_intervals()
    except NRFError as error:
        notes.append(f"No intervals: {error}")
        return None


def _data(subject: Any, records: Any, band: Any) -> tuple[Any, Any]:
    """Data to draw the model over, and the filter of each record."""
    from ...discrepancy.prepare import prepare
    from ...signals.zero_phase_filter import filters_of

    kept = getattr(subject, "_records", None)
    if records is None and kept is None:
        return None, None
    given = [records] if isinstance(records, Record) else list(records or ())
    if kept is not None and (records is None or _fitted_to(kept, given)):  # they need not be fused again
        return kept, filters_of(band, kept)
    data = prepare(given).data
    return data, filters_of(band, data)


def _fitted_to(data: SegmentSet, records: Sequence[Record]) -> bool:
    """Whether the data are these records: lengths, forces and motion of the base; names where nothing is given."""
    if [seg.n_samples for seg in data.segments] != [rec.n_samples for rec in records]:
        return False
    for seg, rec in zip(data.segments, records):
        inputs = [(seg.F, rec.force)]
        if rec.base_acceleration is not None and seg.ag is not None:
            inputs.append((seg.ag, rec.base_acceleration))
        if not all(np.array_equal(mine, given, equal_nan=True) for mine, given in inputs):
            return False
        if seg.name != rec.name and not any(np.nan_to_num(given).any() for _, given in inputs):
            return False
    return True
