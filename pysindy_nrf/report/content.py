"""What the page shows, and the parts that every page of a model has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
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
from ..common.audit import versions
from ..common.unit_system import TRANSLATION, UnitSystem
from ..diagnosis.effects import Bounds, Interval, plain_name
from ..diagnosis.modes import equivalent_modes
from ..diagnosis.site_loops import SiteLoop
from ..diagnosis.verdict import Verdict
from ..drawing.figure import Figure, dof_words
from ..drawing.tables import Table, table
from ..exceptions import NRFError
from ..records.checks.channel_checks import Measured, doubts_by_channel
from ..records.figures import coherence_figure, spectrum_figures, time_figures
from ..records.quality import QualityNote
from ..records.record import Record
from .figures.forces import force_figure, loop_figures
from .figures.modes import MovingModes, modes_of
from .figures.motion import measured_response_figure
from .words import Band, listed

_UNKNOWN = (np.nan, np.nan)
# Records whose channels are drawn: more make the page heavy.
DRAWN_RECORDS = 3
# Records by whose names a page is called.
MAX_NAMES_IN_TITLE = 3
# Share by which a frequency or a damping at the measured amplitude must differ from
# that of the linear part to be shown: few tests know a frequency better.
LEAST_CHANGE_OF_MODES = 0.01


@dataclass(frozen=True)
class Tile:
    """One number of the page's head."""

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True, eq=False)
class SiteSection:
    """One site of the model: equation, shape parameters, figures."""

    site: str
    equation: list[str]
    shapes: list[str]
    figures: list[Figure]


@dataclass(frozen=True, eq=False)
class Chapter:
    """One step of the loop's story, or what is left at its end."""

    title: str
    facts: list[tuple[str, str]]
    tables: list[Table]
    lead: str = ""
    badge: str = ""
    state: str = ""
    figures: list[Figure] = field(default_factory=list)


@dataclass(frozen=True)
class Floor:
    """A floor of the drawing: its mass in words, and what is drawn at it."""

    words: str
    forced: bool
    open: bool


@dataclass(frozen=True)
class Storey:
    """A storey of the drawing.

    ``state`` is empty where there is none, ``"linear"``, or ``"guilty"`` where an
    effect acts.
    """

    words: str
    state: str


@dataclass(frozen=True)
class Frame:
    """The structure as it is drawn, from the ground up; its effects stand below."""

    floors: list[Floor]
    storeys: list[Storey]
    effects: list[str]
    base_moves: bool = False


@dataclass(frozen=True, eq=False)
class ModelPart:
    """Equations, sites, numbers and modes of a model."""

    balances: list[list[str]]
    sites: list[SiteSection]
    tables: list[Table]
    equation_text: list[str]
    moving: MovingModes | None = None


@dataclass(frozen=True, eq=False)
class MeasuredRecord:
    """One record: its channels in numbers, what is known of them, and drawn."""

    record: Measured
    channels: Table
    quality: Table | None = None
    figures: list[Figure] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Content:
    """Everything the template shows; a verdict is named if there are several."""

    title: str
    lead: str
    audit: list[Table]
    model: ModelPart | None = None
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    care: list[str] = field(default_factory=list)
    frame: Frame | None = None
    picture: list[Figure] = field(default_factory=list)
    stopped: str = ""
    tiles: list[Tile] = field(default_factory=list)
    measured: list[MeasuredRecord] = field(default_factory=list)
    chapters: list[Chapter] = field(default_factory=list)
    effects: Table | None = None
    errors: list[Figure | Table] = field(default_factory=list)
    results: list[Figure | Table | MovingModes] = field(default_factory=list)
    units: UnitSystem = TRANSLATION


# -- the model -----------------------------------------------------------------


def model_part(
    model: ChainModel, loops: Sequence[SiteLoop], bounds: Bounds
) -> ModelPart:
    """Equations, sites, masses, coefficients and modes of a model.

    Parameters
    ----------
    model : ChainModel
    loops : sequence of SiteLoop
        Forces of its sites along the data.
    bounds : mapping of str to (float, float)
        95 % intervals by parameter.
    """
    tables = [_masses(model, bounds), _coefficients(model, bounds)]
    moving = None
    modes = _modes(model)
    if len(modes):
        tables.append(_modes_table("Modes of the linear part", modes))
        moving = MovingModes("Modes of the linear part", modes_of(modes))
        at_amplitude = _modes_at_amplitude(model, loops)
        of_linear_part = modes[at_amplitude.columns]
        if not np.allclose(at_amplitude, of_linear_part, rtol=LEAST_CHANGE_OF_MODES):
            caption = "Modes at the measured amplitude"
            tables.append(_modes_table(caption, at_amplitude))

    sections = _site_sections(model, loops, bounds)
    text = str(model).splitlines()
    balances = balance_equations(model)
    return ModelPart(balances, sections, tables, text, moving)


def _site_sections(
    model: ChainModel, loops: Sequence[SiteLoop], bounds: Bounds
) -> list[SiteSection]:
    """The sites that hold a law."""
    by_site = {loop.site: loop for loop in loops}
    sections = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        loop = by_site.get(str(site))
        figures = []
        surface = force_figure(model, site, loop)
        if surface is not None:
            figures.append(surface)
        if loop is not None:
            figures += loop_figures(model, [loop])
        equation = law_equation(force, bounds)
        section = SiteSection(str(site), equation, shape_values(force), figures)
        sections.append(section)
    return sections


def _modes(model: ChainModel) -> pd.DataFrame:
    """Modes of the linear part; empty if it has none."""
    if not (model.masses > 0).all():
        return pd.DataFrame()
    try:
        return model.modes()
    except (NRFError, np.linalg.LinAlgError):
        return pd.DataFrame()


def _modes_at_amplitude(model: ChainModel, loops: Sequence[SiteLoop]) -> pd.DataFrame:
    """Frequencies and dampings of the equivalent linear chain.

    Those of the linear part where the force of a site is not known along the data.
    """
    drawn = {loop.site for loop in loops}
    modes = model.modes()
    acting = [str(site) for site, force in model.restoring_forces.items() if force.laws]
    if drawn.issuperset(acting):
        modes = equivalent_modes(model, loops)
    return modes[["frequency", "damping"]]


def _modes_table(caption: str, modes: pd.DataFrame) -> Table:
    head = {"frequency": "frequency (Hz)", "damping": "damping ratio"}
    for name in modes.columns:
        if name.startswith("dof"):
            head[name] = dof_words(name)
    return table(caption, modes, head, index="mode")


def _masses(model: ChainModel, bounds: Bounds) -> Table:
    rows: list[list[str | float]] = []
    for j, mass in enumerate(model.masses, 1):
        rows.append([f"m{j}", *_with_ends(mass, bounds.get(f"m{j}"))])
    unit = pretty(model.units.mass)
    head = ["mass", f"estimate ({unit})", f"lower ({unit})", f"upper ({unit})"]
    return _with_intervals("Masses", head, rows)


def _coefficients(model: ChainModel, bounds: Bounds) -> Table:
    """Coefficients and shape parameters of all sites."""
    rows: list[list[str | float]] = []
    for site, force in model.restoring_forces.items():
        for (term, value), unit in zip(force.coefficients.items(), force.units):
            ends = _with_ends(value, bounds.get(f"{site}: {term}"))
            rows.append([str(site), pretty(str(term)), pretty(unit), *ends])
        for law in force.laws:
            units = force.shape_units(law)
            for name, value in law.shape.items():
                if value is not None:
                    label = f"{name} ({plain_name(law.name)})"
                    unit = pretty(units[name])
                    rows.append([str(site), label, unit, *_with_ends(value)])
    head = ["site", "term or shape parameter", "unit", "estimate", "lower", "upper"]
    return _with_intervals("Coefficients", head, rows)


def _with_ends(value: float, interval: Interval | None = None) -> list[Estimate]:
    """An estimate and the ends of its interval, with the digits that this leaves."""
    low, high = interval or _UNKNOWN
    return [Estimate(number, low, high) for number in (float(value), low, high)]


def _with_intervals(
    caption: str, head: list[str], rows: Sequence[Sequence[str | float]]
) -> Table:
    """A table; without its last two columns where there is no interval."""
    if not rows or np.isnan([row[-2] for row in rows]).all():
        return Table(caption, head[:-2], [row[:-2] for row in rows])
    return Table(f"{caption}, with 95 % intervals", head, rows)


# -- the structure as it is drawn ----------------------------------------------


def frame_of(
    model: ChainModel,
    bounds: Bounds,
    effects: Mapping[str, str],
    open_dofs: Iterable[int],
    records: Sequence[Measured],
) -> Frame:
    """The drawing of a model.

    Parameters
    ----------
    model : ChainModel
    bounds : mapping of str to (float, float)
    effects : mapping of str to str
        What the model has besides linear storeys, in words by site.
    open_dofs : iterable of int
        DOFs whose balance does not close.
    records : sequence of Measured
    """
    open_balances = set(open_dofs)
    forced: set[int] = set()
    for record in records:
        forced.update(record.forced)

    floors, storeys = [], []
    for j, mass in enumerate(model.masses, 1):
        estimate = Estimate(mass, *bounds.get(f"m{j}", _UNKNOWN))
        words = f"m{j} = {as_text(estimate)} {pretty(model.units.mass)}"
        floors.append(Floor(words, j in forced, j in open_balances))
        storeys.append(_storey(model, j, bounds, effects))
    base_moves = any(record.base_moves for record in records)
    return Frame(floors, storeys, list(effects.values()), base_moves)


def _storey(
    model: ChainModel, number: int, bounds: Bounds, effects: Mapping[str, str]
) -> Storey:
    """One storey with its stiffness."""
    name = f"storey {number}"
    forces = {str(site): force for site, force in model.restoring_forces.items()}
    force = forces.get(name)
    if force is None or not force.laws:
        return Storey("", "")

    words = name
    stiffness = float(force.linear_part()["k"]) / 1e3
    if stiffness:
        low, high = bounds.get(f"{name}: s", _UNKNOWN)
        estimate = Estimate(stiffness, low / 1e3, high / 1e3)
        words = f"k{number} = {as_text(estimate)} {model.units.of('kN/m')}"
    return Storey(words, "guilty" if name in effects else "linear")


# -- records and settings ------------------------------------------------------


def names_of(records: Sequence[Measured]) -> str:
    """Names of the records, by which a page is called."""
    return listed(record.name for record in records[:MAX_NAMES_IN_TITLE])


def measured_part(
    records: Iterable[Measured],
    model: ChainModel | None = None,
    notes: Sequence[QualityNote] = (),
    band: Band = None,
) -> list[MeasuredRecord]:
    """What was measured, record by record; the first records are drawn.

    Parameters
    ----------
    records : iterable of Measured
    model : ChainModel, optional
        Whose frequency responses are drawn next to the measured ones.
    notes : sequence of QualityNote
        What is known of channels, clocks and units of all records.
    band : (float or None, float or None), optional
        Band that was used, Hz.
    """
    head = {"what": "what it is", "noise": "noise estimate, rms"}
    parts: list[MeasuredRecord] = []
    for record in records:
        units = [pretty(str(unit)) for unit in record.channels["unit"]]
        channels = record.channels.assign(unit=units).dropna(axis=1, how="all")
        shown = table(f"Channels of {record.name}", channels, head)
        figures = []
        if len(parts) < DRAWN_RECORDS and record.record is not None:
            figures = data_figures(record.record, notes, model, band)
        quality = quality_table(record.name, notes)
        parts.append(MeasuredRecord(record, shown, quality, figures))
    return parts


def data_figures(
    record: Record,
    notes: Sequence[QualityNote],
    model: ChainModel | None = None,
    band: Band = None,
) -> list[Figure]:
    """A record over time and by frequency; its responses with those of a model."""
    doubts = doubts_by_channel(record, notes)
    figures = time_figures(record, doubts)
    coherence = coherence_figure(record)
    if coherence is not None:
        figures.append(coherence)
    if model is not None:
        # a mass or a stiffness of zero has no response
        with suppress(NRFError, np.linalg.LinAlgError):
            response = measured_response_figure(record, model, band)
            if response is not None:
                figures.append(response)
    return figures + spectrum_figures(record, band)


def quality_table(record: str, notes: Sequence[QualityNote]) -> Table | None:
    """What is known of the channels of a record, and what was done about it."""
    rows = []
    for note in notes:
        if note.record in ("", record):
            rows.append([note.channel or "record", note.kind, note.size, note.message])
    if not rows:
        return None
    head = ["channel", "what", "size", "in words"]
    return Table(f"What is known of the channels of {record}", head, rows)


def audit_part(
    info: Mapping[str, Any], settings: Mapping[str, Mapping[str, object]]
) -> list[Table]:
    """What was run, with which settings, and which versions."""
    installed = [[name, version] for name, version in versions().items()]
    tables = [
        _run(info.get("command", ""), info.get("inputs", ())),
        _settings(settings),
        Table("Versions", ["package", "version"], installed),
    ]
    return [table for table in tables if table.rows]


def _run(command: str, inputs: Iterable[Mapping[str, object]]) -> Table:
    """What was run, when, and on which files."""
    rows: list[list[object]] = []
    if command:
        rows.append(["command", command])
    rows.append(["written", datetime.now().astimezone().isoformat(" ", "seconds")])
    for source in inputs:
        size = f"{source['bytes']} bytes, SHA-256 {source['sha256']}"
        rows.append([source["file"], size])
    return Table("This run", ["what", "value"], rows)


def _settings(groups: Mapping[str, Mapping[str, object]]) -> Table:
    rows = []
    for group, values in groups.items():
        for name, value in values.items():
            rows.append([group, name, _setting(value)])
    return Table("Every setting of this run", ["of", "setting", "value"], rows)


def _setting(value: object) -> str:
    """A setting in words; numbers of a mapping to four digits."""
    if not isinstance(value, dict) or not value:
        return str(value)
    if not all(isinstance(number, float) for number in value.values()):
        return str(value)
    return listed(f"{key}: {as_text(number)}" for key, number in value.items())
