"""The outcome of an identification in files: model, tables, figures, page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from .. import report
from ..chain.model import ChainModel
from ..diagnosis.site_loops import loops_of
from ..drawing import matplotlib_renderer
from ..drawing.matplotlib_renderer import save
from ..records.files import write_table
from ..records.record import Record
from ..records.zero_phase_filter import filters_of
from ..report.figures.forces import loop_figures
from ..report.figures.motion import free_run_figures, response_figures
from ..report.model_content import identification_of
from ..report.words import band_text
from .exit_codes import ExitCode
from .outcome import Outcome
from .outcome_words import outcome_data, outcome_text
from .session import Session

_COLUMNS_OF_ERRORS = {
    "error": "error_percent",
    "residual": "residual_N_rms",
    "reference": "reference_N_rms",
}


def finish(
    session: Session,
    outcome: Outcome,
    figures: bool,
    records: Sequence[Record] = (),
    truth: ChainModel | None = None,
    excel: bool = False,
) -> ExitCode:
    """Write what was found, then print it.

    Parameters
    ----------
    session : Session
    outcome : Outcome
    figures : bool
        Whether figures are drawn.
    records : sequence of Record
        Empty for frequency responses.
    truth : ChainModel, optional
        The model behind a simulated record.
    excel : bool
        Whether a workbook is written.

    Returns
    -------
    ExitCode
    """
    session.conclude(outcome_text(outcome, truth))
    session.add_warnings(outcome.warnings)
    outcome.estimator.model_.info.update(session.provenance())
    with session.writing() as folder:
        written = write_outcome(outcome, folder, figures, records)
        if excel:
            written.append(_workbook(outcome, folder / "model.xlsx"))
    session.finish(outcome_data(outcome, records), written)

    if figures and not matplotlib_renderer.available():
        session.say(
            "No figures: matplotlib is not installed; pip install 'pysindy-nrf[plot]'"
            " brings it."
        )
    has_page = any(path.suffix == ".html" for path in written)
    if outcome.responses is None and not has_page:
        session.say("No page: pip install 'pysindy-nrf[report]' brings what it needs.")
    return outcome.exit_code


def write_outcome(
    outcome: Outcome, folder: Path, figures: bool, records: Sequence[Record]
) -> list[Path]:
    """Write model, tables, figures (with matplotlib) and the page of the records."""
    written = [folder / "model.json"]
    outcome.estimator.model_.to_json(written[0])
    for name, table in _tables(outcome).items():
        written.append(write_table(table, folder / f"{name}.csv"))
    if figures:
        written += _figures(outcome, folder)
    if outcome.responses is None and report.available():
        written.append(_page(outcome, folder / "report.html", records))
    return written


def _tables(outcome: Outcome) -> dict[str, pd.DataFrame]:
    """Tables by the names of their files."""
    model, errors = outcome.estimator.model_, outcome.estimator.errors_
    dofs = range(1, model.n_dof + 1)
    errors = errors.reset_index(names="balance").rename(columns=_COLUMNS_OF_ERRORS)
    tables = {
        "masses": pd.DataFrame({"dof": dofs, "mass_kg": model.masses}),
        "coefficients": coefficients(model),
        "balance_errors": errors,
    }
    if (model.masses > 0).all() and (model.total_masses > 0).all():
        modes = model.modes().reset_index()
        tables["modes"] = modes.rename(columns={"frequency": "frequency_Hz"})
    if len(outcome.free.table):
        free = outcome.free.table.add_suffix("_percent")
        tables["free_run_errors"] = free.reset_index(names="record")
    return tables


def coefficients(model: ChainModel) -> pd.DataFrame:
    """All coefficients of a model: ``site``, ``term``, ``value``, ``unit``."""
    rows = []
    for site, force in model.restoring_forces.items():
        for (term, value), unit in zip(force.coefficients.items(), force.units):
            rows.append((str(site), term, value, unit))
    return pd.DataFrame(rows, columns=["site", "term", "value", "unit"])


def _figures(outcome: Outcome, folder: Path) -> list[Path]:
    """Draw the restoring forces and the free run, or the frequency responses."""
    band, responses = outcome.estimator.band, outcome.responses
    if responses is not None:
        excited = responses.measured.excited
        figures = response_figures(
            responses.f,
            responses.by_measurement,
            responses.by_model,
            outcome.estimator.model_.units,
        )
        return save(
            folder / "frequency_response.png",
            figures,
            title=f"Accelerance, force on DOF {excited}, {band_text(band)}",
        )
    model, data = outcome.estimator.model_, outcome.estimator.fit_data("")
    loops = loops_of(model, data, filters_of(band, data))
    written = save(
        folder / "restoring_forces.png", loop_figures(model, loops), columns=2
    )
    return written + save(folder / "free_run.png", free_run_figures(outcome.free)[:1])


def _workbook(outcome: Outcome, path: Path) -> Path:
    """Write the workbook, over the data of the fit."""
    result = outcome.estimator.result_
    data = result.require_data("Fit again to write its forces.")
    loops = loops_of(result.model, data, result.problem.filters(data))
    return report.write_workbook(
        path, result.summary(), result.model, loops, data.quality
    )


def _page(outcome: Outcome, path: Path, records: Sequence[Record]) -> Path:
    """Write the page, over the data of the fit."""
    estimator = outcome.estimator
    shown = identification_of(
        estimator, records, estimator.band, estimator.fit_data("")
    )
    report.write_html(path, shown, notes=tuple(outcome.warnings))
    return path
