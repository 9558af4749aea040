"""What stands on the page, gathered from a report of the loop, a regressor or a model."""

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
from .equations import as_text, balance_equations, law_equation, pretty_label, pretty_unit, shape_values
from .figures import Figure
from .figures_evidence import before_after, residual_bars
from .figures_model import loop_figure, mode_shapes, surface
from .tables import Table, rows_table, table


@dataclass
class Room:
    """One site of the model."""

    site: str
    equation: list[str]
    shapes: list[str]
    figures: list[Figure]


@dataclass
class Chapter:
    """One step of the loop's story, or what is left at its end."""

    title: str
    lead: str
    facts: list[tuple[str, str]]
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    badge: str = ""


@dataclass
class Content:
    """Everything the template shows."""

    title: str
    lead: str
    tiles: list[tuple[str, str, str]]
    measured: list[tuple[Measured, Table]]
    balances: list[list[str]]
    rooms: list[Room]
    tables: list[Table]
    figures: list[Figure]
    chapters: list[Chapter] = field(default_factory=list)
    errors: list[Any] = field(default_factory=list)
    stopped: str = ""
    warnings: list[str] = field(default_factory=list)
    settings: Table | None = None
    versions: Table | None = None
    equation_text: list[str] = field(default_factory=list)
    kind: str = "identification"


def of_loop(report: Any, title: str | None = None) -> Content:
    """The page of a closed loop."""
    from .story import cautions, chapters, lead

    model = report.model
    first, last = (float(report.table["held-out"].iloc[i]) for i in (0, -1))
    free = float(report.table["free run"].iloc[-1])
    tiles = [
        ("Effects found", str(len(report.steps)), ""),
        ("Held-out balance error", f"{last:.3g} %", f"from {first:.3g} %" if report.steps else "the baseline's"),
    ]
    if np.isfinite(free):
        before = float(report.table["free run"].iloc[0])
        tiles.append(("Held-out free-run error", f"{free:.3g} %", f"from {before:.3g} %" if report.steps else ""))
    tiles += [("Degrees of freedom", str(model.n_dof), ""), ("Band", _band(report.band), "")]
    content = _model_part(model, report.loops, getattr(report, "intervals", None))
    content.kind, content.title, content.tiles = "loop", title or "Closing the loop", tiles
    content.lead, content.stopped = lead(report), report.stopped_because
    content.measured = [(m, _channels(m)) for m in report.measured]
    content.chapters = chapters(report)
    heads = {c: f"{c} (%)".replace("dof", "DOF") for c in report.table.columns if c != "band"} | {"band": "band (Hz)"}
    shown = report.table.assign(band=report.table["band"].astype(str).str.replace(" Hz", ""))
    content.errors = [
        before_after(report.table),
        table("Errors, percent NRMSE", shown.set_axis([_words(n) for n in shown.index]), heads, index="model"),
    ]
    content.warnings = cautions(report)
    content.settings = _settings(report.settings or settings_of(loop={"band": report.band}))
    return content


def of_model(
    subject: Any, records: Any = None, title: str | None = None, notes: Sequence[str] = (), band: Any = None
) -> Content:
    """The page of an identification."""
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
    errors = getattr(subject, "errors_", None)
    if sizes is not None:
        content.errors.append(residual_bars(sizes))
    tiles = [("Degrees of freedom", str(model.n_dof), "")]
    if errors is not None:
        tiles.insert(0, ("Balance error, pooled", f"{errors.loc['pooled', 'error']:.3g} %", "on the fitted data"))
        heads = {"error": "error (%)", "residual": "residual rms (N)", "reference": "reference rms (N)", "of": "of"}
        named = errors.set_axis([str(i).replace("dof", "DOF") for i in errors.index])
        content.errors.append(table("Balance errors on the fitted data, percent NRMSE", named, heads, index="balance"))
    gap = getattr(subject, "third_law_gap_", None)
    if gap is not None and len(gap):
        frame = pd.DataFrame({"gap": gap.to_numpy()}, index=[str(i) for i in gap.index])
        caption = "Newton's third law: how far the two estimates of one storey differ"
        content.errors.append(table(caption, frame, {"gap": "difference (% of its rms)"}, index="storey"))
    missing = getattr(subject, "missing_terms_", None)
    if isinstance(missing, pd.DataFrame) and len(missing):
        content.errors.append(_missing(missing))
    total = float(model.masses.sum())
    tiles += [("Total mass", f"{total:.4g} kg", ""), ("Band", _band(band), "")]
    content.tiles, content.title = tiles, title or "Identified chain"
    forces = sum(bool(held) for held in model.laws.values())
    content.lead = (
        f"{model.n_dof} mass{'es' if model.n_dof > 1 else ''} and {forces} restoring "
        f"force{'s' if forces != 1 else ''}, identified from measured forces and motions."
    )
    content.measured = [(m, _channels(m)) for m in as_measured(records)]
    content.warnings = notes
    groups = {"model": {k: v for k, v in model.info.items() if k not in ("band",)} | {"band": band}}
    if hasattr(subject, "get_params"):
        groups = {"regressor": subject.get_params(deep=False), **groups}
    content.settings = _settings(settings_of(**groups))
    return content


def _model_part(model: ChainModel, loops: Sequence[SiteLoop], intervals: Any) -> Content:
    """Equations, sites, masses, coefficients, modes."""
    by_site = {loop.site: loop for loop in loops}
    rooms = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        loop = by_site.get(str(site))
        drawn = [surface(model, site, loop)]
        if loop is not None:
            spring = float(force.linear_part()["k"])
            drawn += [loop_figure(loop), *([loop_figure(loop, spring)] if spring else [])]
        rooms.append(Room(str(site), law_equation(force), shape_values(force), [f for f in drawn if f is not None]))
    tables = [_masses(model, intervals), _coefficients(model, intervals)]
    figures = []
    if (model.masses > 0).all():
        try:
            modes = model.modes()
        except (NRFError, np.linalg.LinAlgError):
            modes = None
        if modes is not None and len(modes):
            heads = {"frequency": "frequency (Hz)", "damping": "damping ratio"}
            heads |= {c: c.replace("dof", "DOF") for c in modes.columns if c.startswith("dof")}
            tables.append(table("Modes of the linear part", modes, heads, index="mode"))
            figures.append(mode_shapes(modes))
    rows = list(versions().items())
    return Content(
        "",
        "",
        [],
        [],
        balance_equations(model),
        rooms,
        tables,
        figures,
        versions=rows_table("Versions", ["package", "version"], rows),
        equation_text=str(model).splitlines(),
    )


def bounds_of(intervals: Any) -> dict[str, tuple[float, float]]:
    """Lower and upper bound by parameter name."""
    if not isinstance(intervals, pd.DataFrame) or "parameter" not in intervals:
        return {}
    return {str(r.parameter): (float(r.lower), float(r.upper)) for r in intervals.itertuples()}


def _masses(model: ChainModel, intervals: Any) -> Table:
    known = bounds_of(intervals)
    rows: list[list[Any]] = [[f"m{j}", float(m), *known.get(f"m{j}", ())] for j, m in enumerate(model.masses, 1)]
    return _bounded("Masses", ["mass", "estimate (kg)"], ["lower (kg)", "upper (kg)"], rows)


def _coefficients(model: ChainModel, intervals: Any) -> Table:
    known, rows = bounds_of(intervals), []
    for site, force in model.restoring_forces.items():
        for (term, value), unit in zip(force.coefficients.items(), force.units):
            bounds = known.get(f"{site}: {term}", ())
            rows.append([str(site), pretty_label(str(term)), float(value), *bounds, pretty_unit(unit)])
        for law in force.laws:
            units = {p.name: p.unit for p in law.shapes}
            rows += [
                [str(site), f"{name} ({_words(law.name)})", float(x), pretty_unit(units.get(name, "1"))]
                for name, x in law.shape.items()
                if x is not None
            ]
    wide = max((len(r) for r in rows), default=4)
    rows = [r if len(r) == wide else [*r[:-1], *[float("nan")] * (wide - len(r)), r[-1]] for r in rows]
    head = ["site", "term or shape parameter", "estimate"]
    return rows_table("Coefficients", [*head, *(["lower", "upper"] if wide > 4 else []), "unit"], rows)


def _bounded(caption: str, head: list[str], more: list[str], rows: list[list[Any]]) -> Table:
    wide = max((len(r) for r in rows), default=2)
    rows = [[*r, *[float("nan")] * (wide - len(r))] for r in rows]
    return rows_table(f"{caption}, with 95 % intervals" if wide > 2 else caption, head + more[: wide - 2], rows)


def _missing(found: pd.DataFrame) -> Table:
    """Of :func:`pysindy_nrf.diagnostics.missing_terms`, in words."""
    heads = {
        "residual": "residual (% of its force)",
        "gain": "held-out part of it that further terms remove (%)",
        "missing": "size of these terms (% of its force)",
        "shift": "mass moves with them by (%)",
        "lasting": "part of it that a constant or a straight line in time removes (%)",
        "biased": "a law is missing",
    }
    shown = found.assign(biased=["yes" if b else "no" for b in found["biased"]])
    return table("What terms beyond the laws would explain", shown, heads, index="step of the solve")


def _channels(m: Measured) -> Table:
    heads = {"what": "what it is", "rms": "rms", "peak": "peak", "noise": "noise estimate, rms"}
    shown = m.channels.assign(unit=[pretty_unit(str(u)) for u in m.channels["unit"]])
    if not shown["noise"].notna().any():
        shown = shown.drop(columns="noise")
    return table(f"Channels of {m.name}", shown, heads)


def _settings(groups: dict[str, dict[str, Any]]) -> Table:
    rows = [[group, k, _said(v)] for group, values in groups.items() for k, v in values.items()]
    return rows_table("Every setting of this run", ["of", "setting", "value"], rows)


def _said(value: Any) -> str:
    """A setting in words; numbers of a mapping to four digits."""
    if isinstance(value, dict) and value and all(isinstance(x, float) for x in value.values()):
        return ", ".join(f"{key}: {as_text(x)}" for key, x in value.items())
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

    kept = getattr(subject, "_fit_data", None)
    if records is None and kept is None:
        return None, None
    given = [records] if isinstance(records, Record) else list(records or ())
    if kept is not None and (records is None or _fitted_to(kept.data, given)):  # they need not be fused again
        own = subject.model_.info.get("band")
        same = (None if own is None else tuple(own)) == (None if band is None else tuple(band))
        return kept.data, kept.filters if same else filters_of(band, kept.data)
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


def _band(band: Any) -> str:
    if band is None or all(edge is None for edge in band):
        return "all frequencies"
    low, high = band
    return f"{low or 0:g}–{'∞' if high is None else format(high, 'g')} Hz"


def _words(name: Any) -> str:
    return str(name).replace("_", " ")
