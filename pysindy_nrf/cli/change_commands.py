"""Commands on what a structure does and how it changed: ``forces`` and ``damage``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click
import numpy as np
import pandas as pd

from .. import report as pages
from . import options as opt
from .exit_codes import code_of_verdict
from .parameters import PATH
from .printing import table_text, verdict_data, verdict_text
from .session import Session

if TYPE_CHECKING:
    from ..diagnosis.verdict import Verdict
    from ..drawing.figure import Figure, Table
    from ..identification.regressor import NRFRegressor
    from ..monitoring.change import ChangeReport
    from ..records.dataset import Dataset
    from ..records.record import Record
    from ..report.figures.modes import MovingModes
    from ..report.results_page import ResultsPage


# Headings of columns in percent.
_HEAD_OF_CHANGES = {"change": "change (%)", "error": "standard error (%)"}


class ForcesOptions(opt.FitOptions):
    """Options of ``forces``."""

    output: Path
    figures: bool


class DamageOptions(opt.FitOptions):
    """Options of ``damage``."""

    least: float
    level: float
    blocks: int
    output: Path
    figures: bool


@click.command(short_help="Storey forces, the force of a damper, dissipated energy.")
@click.argument("file", required=False, type=PATH)
@opt.record_options
@click.option(
    "--bare",
    type=PATH,
    help="A test of the structure without its damper: the damper's force (eq. 21).",
)
@opt.degree_option(3, "Total degree of the power series, or box k,q.")
@opt.model_options
@opt.written_options
def forces(
    file: Path | None,
    bare: Path | None,
    as_json: bool,
    **options: Unpack[ForcesOptions],
) -> int:
    """Storey forces along a record, the energy that each storey dissipates, and the
    force of a damper.

    FILE is read as by identify; the file of --mapping may stand for it. The verdict is
    that of the model whose forces they are. With --bare, a test of the same structure
    without its damper, the linear force found there is subtracted: what is left is the
    damper's, storey by storey.

    \b
    Examples
      pysindy-nrf forces shaker.csv
      pysindy-nrf forces --mapping tower.toml
      pysindy-nrf forces with_damper.csv --bare without.csv
    """
    session = Session(as_json)
    tests = [[file] if file else []]
    if bare is not None:
        tests.append([bare])
    records = opt.records_of(session, options, *tests)
    if len(records) != len(tests):
        raise click.UsageError("forces takes one record; name its FILE.")
    with session.listening():
        forces = _forces_along(options, records)
        verdict = forces.estimator.verdict()

    table = _table_of_storeys(forces)
    session.conclude_headed("Verdict", verdict_text(verdict))
    session.conclude_headed("Forces of the storeys", table_text(table))
    session.drop_warnings(verdict.reasons)
    forces.estimator.model_.info.update(session.provenance())
    with session.writing() as folder:
        written = _write_forces(forces, table, folder)
        if options["figures"]:
            written += _draw_forces(forces, folder)
        if pages.available():
            page = folder / "forces.html"
            notes = session.warnings
            pages.write_html(page, forces.estimator, records[:1], notes=notes)
            written.append(page)
    data = {"storeys": table, "masses_kg": forces.estimator.masses_}
    session.finish({"verdict": verdict_data(verdict), **data}, written)
    return code_of_verdict(verdict)


@dataclass(frozen=True, eq=False)
class _Forces:
    """Forces along a record, and what was fitted to find them."""

    estimator: NRFRegressor
    data: Dataset
    storeys: pd.DataFrame
    energy: pd.DataFrame
    device: pd.DataFrame | None


def _forces_along(options: ForcesOptions, records: Sequence[Record]) -> _Forces:
    """Fit the model, and without a damper a linear one; take the forces along."""
    from ..chain.model import as_segments, storey_names
    from ..identification import damper_force, dissipated_energy

    estimator = opt.regressor_of(options).fit(records[0])
    linear = None
    if len(records) > 1:
        linear = opt.regressor_of(options).set_params(degree=1, laws=None)
        linear.fit(records[1])
    data = as_segments(estimator, records[0])
    energy = dissipated_energy(estimator, data, linear)
    along = estimator.model_.restoring_force(data)
    names = storey_names(estimator.model_)
    storeys = pd.DataFrame(along, columns=names, index=energy.index)
    device = None
    if linear is not None:
        device = damper_force(estimator, linear, data).add_prefix("damper, ")
    return _Forces(estimator, data, storeys, energy, device)


def _write_forces(forces: _Forces, table: pd.DataFrame, folder: Path) -> list[Path]:
    """Write forces, energies and the table of the storeys."""
    from ..records.files import write_table

    lines = forces.storeys
    if forces.device is not None:
        lines = lines.join(forces.device)
    return [
        write_table(lines.rename_axis("t"), folder / "forces.csv"),
        write_table(forces.energy.rename_axis("t"), folder / "energy.csv"),
        write_table(table.rename_axis("storey"), folder / "storeys.csv"),
    ]


def _table_of_storeys(forces: _Forces) -> pd.DataFrame:
    """Size of the forces, and the energy that is dissipated, by storey."""
    storeys, device = forces.storeys, forces.device
    unit = forces.estimator.model_.units.force
    rms, peak = np.sqrt((storeys**2).mean()), storeys.abs().max()
    table = pd.DataFrame({f"rms ({unit})": rms, f"peak ({unit})": peak})
    of_what = "dissipated (J)"
    if device is not None:
        table[f"damper, rms ({unit})"] = np.sqrt((device**2).mean()).to_numpy()
        of_what = "dissipated by the damper (J)"
    dissipated = forces.energy.iloc[-1]
    table[of_what] = dissipated
    table["share (%)"] = 100 * dissipated / dissipated.sum()
    return table


def _draw_forces(forces: _Forces, folder: Path) -> list[Path]:
    """Draw the loops of all sites and the energy."""
    from ..diagnosis.site_loops import loops_of
    from ..drawing.matplotlib_renderer import save
    from ..report.figures.forces import energy_figure, loop_figures

    model = forces.estimator.model_
    filters = forces.estimator.problem_.filters(forces.data)
    loops = loop_figures(model, loops_of(model, forces.data, filters))
    written = save(folder / "loops.png", loops, columns=2)
    return written + save(folder / "energy.png", [energy_figure(forces.energy)])


@click.command(
    short_help="What changed between two tests: where, how much, which term."
)
@click.argument("before", required=False, type=PATH)
@click.argument("after", required=False, type=PATH)
@opt.record_options
@opt.degree_option(1, "Total degree of the declared storeys, or box k,q.")
@opt.model_options
@click.option(
    "--least",
    type=float,
    default=1.0,
    help="Smallest change of interest, % of the spring or mass.",
)
@click.option(
    "--level",
    type=float,
    default=0.01,
    help="Level of significance, of all places and terms together.",
)
@click.option(
    "--blocks",
    type=click.IntRange(5),
    default=20,
    help="Pieces of each test, left out in turn.",
)
@opt.written_options
def damage(
    before: Path | None,
    after: Path | None,
    as_json: bool,
    **options: Unpack[DamageOptions],
) -> None:
    """Say which storey's force, or which mass, changed between two tests of one
    structure.

    BEFORE and AFTER are read as by identify; the two files of --mapping may stand for
    them. Forces are compared where both tests
    moved, so that another amplitude is no change; a declared law with a state or a
    shape (--law) is compared on its own parameters.

    \b
    Examples
      pysindy-nrf damage may.csv october.csv
      pysindy-nrf damage may.csv october.csv --band 0.5,40 --least 2
    """
    from ..monitoring import compare_tests
    from ..records.files import write_table

    session = Session(as_json)
    paths = [[path] for path in (before, after) if path is not None]
    records = opt.records_of(session, options, *(paths or [[]]))
    if len(records) != 2:
        raise click.UsageError("damage takes two records, BEFORE and AFTER.")
    with session.listening():
        estimator = opt.regressor_of(options)
        report = compare_tests(
            estimator,
            *records,
            n_blocks=options["blocks"],
            level=options["level"],
            least=options["least"],
        )
        verdicts = _verdicts_of_tests(estimator, records)

    words = [f"{name}: {verdict_text(v)}" for name, v in verdicts.items()]
    session.conclude_headed("Verdicts of both fits", "\n".join(words))
    session.conclude_headed("What changed", str(report))
    if len(report.changed):
        session.conclude("", table_text(report.changed))
    session.conclude_headed("The tests fitted apart", table_text(report.table))
    session.conclude_headed("Modes of the linear part", table_text(report.modes))
    with session.writing() as folder:
        written = [
            write_table(report.changed, folder / "changed.csv"),
            write_table(report.table, folder / "fitted_apart.csv"),
        ]
        if options["figures"]:
            written += _draw_changes(report, folder / "change.png")
        if pages.available():
            page = folder / "change.html"
            pages.write_html(page, _page_of_changes(session, report, verdicts))
            written.append(page)
    session.finish(_data_of_changes(report, verdicts), written)


def _verdicts_of_tests(
    estimator: NRFRegressor, records: Sequence[Record]
) -> dict[str, Verdict]:
    """Whether the declared law holds in each test: a comparison rests on both fits."""
    from sklearn.base import clone

    verdicts = {}
    for name, record in zip(("before", "after"), records):
        verdicts[name] = clone(estimator).fit(record).verdict()
    return verdicts


def _draw_changes(report: ChangeReport, path: Path) -> list[Path]:
    """Draw where the force of each storey changed, in the same colours."""
    from ..drawing.matplotlib_renderer import save

    figures = _maps_of_changes(report, report.storeys)
    return save(path, figures, columns=min(3, len(figures)))


def _maps_of_changes(report: ChangeReport, storeys: Sequence[str]) -> list[Figure]:
    """Where the force of storeys changed, in the same colours."""
    from ..report.figures.motion import change_figure

    maps = {site: report.map(site) for site in report.storeys}
    largest = max(changes["change"].abs().max() for changes in maps.values())
    units = report.before.units
    return [change_figure(maps[site], site, largest, units=units) for site in storeys]


def _table_of_modes(report: ChangeReport) -> Table:
    """Modes of both tests, and how alike their shapes are."""
    from ..drawing.tables import table

    head = {"mac": "MAC"}
    for when in ("before", "after"):
        head[f"frequency {when}"] = f"frequency {when} (Hz)"
        head[f"damping {when}"] = f"damping {when} (share of critical)"
    return table("Modes of the linear part", report.modes, head, index="mode")


def _page_of_changes(
    session: Session, report: ChangeReport, verdicts: Mapping[str, Verdict]
) -> ResultsPage:
    """The page of two tests: what changed, where, and both fits."""
    from ..drawing.tables import table
    from ..report.figures.modes import MovingModes, modes_of_two_tests
    from ..report.results_page import ResultsPage

    parts: list[Figure | Table | MovingModes] = []
    if len(report.changed):
        parts.append(table("What changed", report.changed, _HEAD_OF_CHANGES))
    changed = set(report.changed["place"])
    parts += _maps_of_changes(report, [s for s in report.storeys if s in changed])
    parts.append(table("The tests fitted apart", report.table, _HEAD_OF_CHANGES))
    if len(report.modes):
        both = modes_of_two_tests(report.before.modes(), report.after.modes())
        parts.append(MovingModes("Modes of the linear part in both tests", both))
        parts.append(_table_of_modes(report))
    sentences = str(report).splitlines()
    return ResultsPage(
        "What changed between two tests",
        sentences[0],
        parts,
        {f"The fit {name}": verdict for name, verdict in verdicts.items()},
        (*sentences[1:], *session.warnings),
        session.provenance(),
    )


def _data_of_changes(
    report: ChangeReport, verdicts: Mapping[str, Verdict]
) -> dict[str, object]:
    """What changed, as plain data."""
    masses = []
    for before, after in zip(report.before.masses, report.after.masses):
        masses.append({"before": before, "after": after})
    return {
        "said": str(report).splitlines(),
        "damaged": report.damaged,
        "changed": report.changed.to_dict("records"),
        "explained": report.explained.to_dict("records"),
        "fitted_apart": report.table.to_dict("records"),
        "masses_kg": masses,
        "modes": report.modes.to_dict("records"),
        "verdicts": {name: verdict_data(v) for name, v in verdicts.items()},
    }
