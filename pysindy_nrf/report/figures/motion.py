"""Figures of motion and of models: free runs, frequency responses, changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ...chain.frequency_response import transfer
from ...chain.model import ChainModel
from ...chain.sites import Site, index_of
from ...common.unit_system import TRANSLATION, UnitSystem
from ...diagnosis.free_run import FreeRuns
from ...drawing.figure import Axis, Figure, Line, Map, Mark, Table
from ...records.channels import finite_span
from ...records.figures import driving_and_answering
from ...records.record import Record
from ...records.spectra import spectra_of
from ..words import Band

# Cycles of a free run that are drawn, about the largest motion.
DRAWN_CYCLES = 25
# Points of a line of a free run, at most about this many.
DRAWN_POINTS = 1000
# A free run that leaves the measured motion by more than this factor is cut off.
CUT_OFF = 2.5


def below(dof: int, label: str, unit: str) -> Axis:
    """The abscissa of a column of figures: labelled below the lowest, DOF 1."""
    return Axis(label, unit) if dof == 1 else Axis()


def free_run_figures(runs: FreeRuns | None) -> list[Figure]:
    """The first free run over the measurement, with its error below.

    One figure a DOF; the DOF that moves most comes first. Empty without a run.
    """
    if runs is None or not runs.runs:
        return []
    segment, _ = runs.runs[0]
    measured = np.cumsum(segment.s[segment.valid], axis=1)
    largest = np.abs(measured).max(axis=0)
    in_order = 1 + np.argsort(-largest, kind="stable")
    return [free_run_figure(runs, dof) for dof in in_order.tolist()]


def free_run_figure(runs: FreeRuns, dof: int) -> Figure:
    """The first free run over the measurement at one DOF, with its error below."""
    segment, run = runs.runs[0]
    measured = np.cumsum(segment.s[segment.valid], axis=1)
    j = dof - 1
    errors = runs.table.iloc[0]
    rows = _rows_about_the_largest(measured[:, j])
    bound = CUT_OFF * np.abs(measured[:, j]).max()
    free = np.clip(np.asarray(run.displacement)[rows, j], -bound, bound)
    time, motion = run.time[rows], measured[rows, j]
    unit = runs.units.length

    alone = f"the model alone ({errors.iloc[j]:.3g} % NRMSE over the record)"
    by_dof = [f"{name} {error:.3g} %" for name, error in errors.items()]
    error = Figure(
        f"Error of the free run, DOF {j + 1}",
        [Line(time, free - motion, "model less measured", "red", 0.9)],
        Axis("time", "s"),
        Axis(f"error of x_{{{j + 1}}}", unit, zero=True),
        size=(8.0, 1.8),
        height=150,
    )
    return Figure(
        f"Free run: the model alone under the measured force, DOF {j + 1}",
        [
            Line(time, motion, "measured", "orange", 3.4),
            Line(time, free, alone, "blue", 1.1),
        ],
        Axis(),
        Axis(f"x_{{{j + 1}}}", unit),
        alt=f"Free-run error over the record, percent NRMSE: {', '.join(by_dof)}.",
        wide=True,
        caption=(
            f"Error over the whole record: {', '.join(by_dof)}. Drawn about the largest"
            " motion; the error stands below."
        ),
        size=(8.0, 2.6),
        height=230,
        below=(error,),
        table=Table(
            "Free-run error, percent NRMSE",
            ["DOF", "error (%)"],
            [list(pair) for pair in errors.items()],
        ),
    )


def _rows_about_the_largest(x: np.ndarray) -> slice:
    """Rows of some cycles about the largest displacement."""
    n_crossings = int(np.count_nonzero(np.diff(np.signbit(x - x.mean()))))
    of_cycles = int(2 * DRAWN_CYCLES * len(x)) // max(n_crossings, 1) + 2
    width = min(len(x), of_cycles)
    start = int(np.clip(np.abs(x).argmax() - width // 3, 0, len(x) - width))
    return slice(start, start + width, max(1, width // DRAWN_POINTS))


def response_figures(
    f: np.ndarray,
    measured: np.ndarray,
    modelled: np.ndarray,
    units: UnitSystem = TRANSLATION,
) -> list[Figure]:
    """Size of measured and modelled frequency responses, one figure a DOF.

    Parameters
    ----------
    f : ndarray of shape (n_lines,)
        Hz.
    measured, modelled : ndarray of shape (n_lines, n_dof)
        Accelerance, m/s^2 by N. The uppermost DOF comes first.
    units : UnitSystem, optional
    """
    figures = []
    for j in range(measured.shape[1], 0, -1):
        marks: list[Mark] = [
            Line(f, np.abs(measured[:, j - 1]), "measured", "orange", 1.8),
            Line(f, np.abs(modelled[:, j - 1]), "model", "blue", 0.9, "dash"),
        ]
        figure = Figure(
            f"Accelerance of DOF {j}",
            marks,
            below(j, "frequency", "Hz"),
            Axis(f"|H_{{{j}}}|", units.of("m/s²/N"), log=True),
            legend="above",
            size=(8.0, 2.1),
        )
        figures.append(figure)
    return figures


def measured_response_figure(
    record: Record, model: ChainModel, band: Band = None
) -> Figure | None:
    """Measured frequency responses of a record, and those of a model's linear part.

    Parameters
    ----------
    record : Record
    model : ChainModel
    band : (float or None, float or None), optional
        Hz; all that is in it is drawn.

    Returns
    -------
    Figure or None
        None without a clock, or where forces and a moving base drive together.
    """
    drive, answers = _drive_and_answers(record)
    if not record.has_clock or drive is None or not answers:
        return None
    name, column = drive
    inputs, outputs = _columns(record, [name]), _columns(record, answers)
    rows = finite_span([*inputs.T, *outputs.T], [name, *answers], record.name)
    spectra = spectra_of(inputs[rows], outputs[rows], record.fs)
    low, high = band or (None, None)
    shown = (spectra.f > (low or 0.0)) & (spectra.f < (high or 0.5 * record.fs))
    f = spectra.f[shown]
    measured = np.abs(spectra.responses[shown, :, 0])
    modelled = np.abs(transfer(model.matrices(), f, answers)[:, :, column])
    return _stacked_responses(record, name, answers, (f, measured, modelled))


def _drive_and_answers(
    record: Record,
) -> tuple[tuple[str, int] | None, list[str]]:
    """What alone drives a record with its column among responses, and what answers."""
    inputs, outputs = driving_and_answering(record)
    answers = list(outputs)
    if record.base_moves:
        # displacements may be those seen from outside
        answers = [name for name in answers if name[0] == "a"]
    if list(inputs) == ["ag"]:
        return ("ag", -1), answers
    if record.base_moves or len(inputs) != 1:
        return None, answers
    (name,) = inputs
    return (name, int(name[1:]) - 1), answers


def _columns(record: Record, names: Sequence[str]) -> np.ndarray:
    """Channels as columns."""
    channels = record.channels()
    return np.column_stack([channels[name].astype(float) for name in names])


def _stacked_responses(
    record: Record,
    drive: str,
    answers: Sequence[str],
    lines: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> Figure:
    """Responses of all floors below each other, the uppermost first."""
    f, measured, modelled = lines
    panels: list[Figure] = []
    for k in reversed(range(len(answers))):
        is_lowest = k == 0
        label = "" if panels else "measured"
        panels.append(
            Figure(
                answers[k],
                [
                    Line(f, measured[:, k], label, "orange", 2.6),
                    Line(f, modelled[:, k], label and "model", "blue", 1.1),
                ],
                Axis("frequency", "Hz") if is_lowest else Axis(),
                Axis(f"|{answers[k]}/{drive}|", log=True),
                size=(6.5, 1.8),
                height=130,
            )
        )
    return replace(
        panels[0],
        title=f"Frequency responses to {drive}, {record.name}",
        alt=f"Measured and modelled responses of {', '.join(answers)} to {drive}.",
        caption=(
            "Measured (Welch's averages) and of the linear part of the model, in SI"
            " units. Nonlinear forces move and blunt the measured peaks."
        ),
        wide=len(panels) > 2,
        table=_table_of_peaks(answers, lines),
        below=tuple(panels[1:]),
    )


def _table_of_peaks(
    answers: Sequence[str], lines: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Table:
    """The largest response of each floor, measured and modelled."""
    f, measured, modelled = lines
    rows: list[list[object]] = []
    for k, name in enumerate(answers):
        row: list[object] = [name]
        for response in (measured[:, k], modelled[:, k]):
            peak = int(np.argmax(response))
            row += [float(f[peak]), float(response[peak])]
        rows.append(row)
    head = ["channel", "measured at (Hz)", "peak", "model at (Hz)", "peak of the model"]
    return Table("Largest responses", head, rows)


def order_figure(
    table: pd.DataFrame, errors: np.ndarray, orders: Sequence[str], scoring: str
) -> Figure:
    """Held-out error by order of the power series.

    Parameters
    ----------
    table : DataFrame
        ``chosen`` and, if it was asked for, ``free_run_error`` (%), by order.
    errors : ndarray of shape (n_orders, n_folds)
        Shares of the reference; inf where an order could not be fitted.
    orders : sequence of str
    scoring : str
        What the folds are judged by.
    """
    folds = np.where(np.isfinite(errors), 100.0 * errors, np.nan)
    n_folds = folds.shape[1]
    mean, spread = folds.mean(axis=1), np.zeros(len(folds))
    if n_folds > 1:
        spread = folds.std(axis=1, ddof=1) / np.sqrt(n_folds)

    x = np.arange(len(folds))
    marks: list[Mark] = []
    for k, fold in enumerate(folds.T):
        name = "" if k else "each fold"
        marks.append(Line(x, fold, name, width=0.8, opacity=0.3))
    name = "mean and standard error"
    marks.append(Line(x, mean, name, width=1.5, marker="o", error=spread))
    if "free_run_error" in table:
        free = table["free_run_error"]
        marks.append(Line(x, free, "free run", "orange", 1.5, "dash", "s"))
    chosen = table["chosen"].to_numpy()
    marks.append(Line(x[chosen], mean[chosen], "chosen", "red", dash="", marker="ring"))

    low, high = np.nanmin(mean), np.nanmax(mean)
    log = bool(0 < 20 * low < high)
    measures = {"acceleration": "acceleration", "free_run": "free-run"}
    label = f"held-out {measures.get(scoring, 'balance')} error (% NRMSE)"
    return Figure(
        "Order selection",
        marks,
        Axis("total degree, or box (k, q)", ticks=list(orders)),
        Axis(label, limits=None if log else (0, None), log=log),
    )


def change_figure(
    table: pd.DataFrame,
    site: Site | str,
    largest: float | None = None,
    colorbar: bool = True,
    units: UnitSystem = TRANSLATION,
) -> Figure:
    """Where in the (v, s) plane the force of a site changed.

    Parameters
    ----------
    table : DataFrame
        As returned by ``ChangeReport.map``.
    site : str or Site
    largest : float, optional
        Change at the ends of the colours, N; the largest of the table if None.
    colorbar : bool
    units : UnitSystem
        Of the models.
    """
    size = int(round(len(table) ** 0.5))
    grid = {}
    for name in ("v", "s", "change", "visited", "significant"):
        grid[name] = table[name].to_numpy().reshape(size, size)

    change = np.where(grid["visited"], grid["change"], np.nan)
    limit = largest or float(np.nanmax(np.abs(change))) or 1.0
    doubtful = grid["visited"] & ~grid["significant"]
    mark = Map(
        grid["s"],
        grid["v"],
        change,
        f"change of force ({units.force})",
        limit,
        doubtful,
        "not significant",
        colorbar,
    )
    index = index_of(site)
    x = Axis(f"drift s_{{{index}}}", units.length)
    y = Axis(f"rate v_{{{index}}}", units.of("m/s"))
    largest_change = float(np.nan_to_num(np.abs(change)).max())
    return Figure(
        f"Change of the force of {site}",
        [mark],
        x,
        y,
        alt=(
            f"Change of the force of {site} over drift and rate; the largest is"
            f" {largest_change:.3g} {units.force}."
        ),
        caption="On the page only what is significant is coloured.",
        heading=str(site),
    )
