"""Figures of motion and of models: free runs, modes, frequency responses, orders, the
change between two tests.
"""

from typing import Any

import numpy as np
import pandas as pd

from ...chain.sites import index_of
from ...selection.one_se_rule import errors_of, standard_error
from .figure import CYCLE, DASHES, Axis, Figure, Line, Map, Mark, Table
from .matplotlib_renderer import Drawing


def below(dof: int, label: str, unit: str) -> Axis:
    """The abscissa of a column of figures: labelled below the lowest, DOF 1."""
    return Axis(label, unit) if dof == 1 else Axis()


def free_run_figure(free: Any, cycles: float = 25.0) -> list[Figure]:
    """The free run over the measurement, at the DOF that moves most, over some cycles
    about its largest motion.
    """
    if free is None or not free.runs:
        return []
    (seg, run), errors = free.runs[0], free.table.iloc[0]
    x = np.cumsum(seg.s[seg.valid], axis=1)
    j = int(np.argmax(np.abs(x).max(axis=0)))
    crossings = int(np.count_nonzero(np.diff(np.signbit(x[:, j] - x[:, j].mean()))))
    width = min(len(x), int(2 * cycles * len(x)) // max(crossings, 1) + 2)
    start = int(np.clip(np.abs(x[:, j]).argmax() - width // 3, 0, len(x) - width))
    rows = slice(start, start + width, max(1, width // 1500))
    own = np.clip(
        run.displacement[rows, j], *(2.5 * np.abs(x[:, j]).max() * np.array([-1, 1]))
    )
    marks: list[Mark] = [
        Line(run.time[rows], x[rows, j], "measured", "orange", 3.4),
        Line(
            run.time[rows],
            own,
            f"the model alone ({errors.iloc[j]:.3g} % NRMSE over the record)",
            "blue",
            1.1,
        ),
    ]
    said = ", ".join(f"{name} {e:.3g} %" for name, e in errors.items())
    numbers = Table(
        "Free-run error, percent NRMSE",
        ["DOF", "error (%)"],
        [*map(list, errors.items())],
    )
    return [
        Figure(
            f"Free run: the model alone under the measured force, DOF {j + 1}",
            marks,
            Axis("time", "s"),
            Axis(f"x_{{{j + 1}}}", "m"),
            alt=f"Free-run error over the record, percent NRMSE: {said}.",
            wide=True,
            caption=(
                f"Error over the whole record: {said}. Drawn about the largest motion."
            ),
            size=(8.0, 3.0),
            height=320,
            table=numbers,
        )
    ]


def response_figures(
    f: np.ndarray, measured: np.ndarray, found: np.ndarray
) -> list[Figure]:
    """Size of measured and modelled frequency responses (accelerance), one figure a
    DOF, the uppermost first.
    """
    out = []
    for j in range(measured.shape[1], 0, -1):
        marks: list[Mark] = [
            Line(f, np.abs(measured[:, j - 1]), "measured", "orange", 1.8)
        ]
        marks.append(Line(f, np.abs(found[:, j - 1]), "model", "blue", 0.9, "dash"))
        x, y = below(j, "frequency", "Hz"), Axis(f"|H_{{{j}}}|", "m/s²/N", log=True)
        out.append(
            Figure(
                f"Accelerance of DOF {j}", marks, x, y, legend="above", size=(8.0, 2.1)
            )
        )
    return out


def modes_figure(modes: pd.DataFrame) -> Figure:
    """Shapes of the linear part's first six modes, floor over displacement."""
    floors = [c for c in modes.columns if str(c).startswith("dof")]
    shown = modes.head(6)
    at = np.arange(len(floors) + 1)
    marks: list[Mark] = [
        Line(
            [0.0, *row[floors]],
            at,
            f"{row['frequency']:.4g} Hz, damping {100 * row['damping']:.2g} %",
            CYCLE[k % 6],
            1.5,
            DASHES[k % 6],
            "o",
        )
        for k, (_, row) in enumerate(shown.iterrows())
    ]
    said = "; ".join(
        f"mode {i} at {row['frequency']:.4g} Hz" for i, row in shown.iterrows()
    )
    return Figure(
        "Mode shapes of the linear part",
        marks,
        Axis("mode shape (largest entry 1)", zero=True),
        Axis(ticks=["base", *(f"DOF {f[4:]}" for f in floors)]),
        alt=f"Shapes of the modes, largest entry 1: {said}.",
        legend="above",
        height=120 + 58 * len(floors),
    )


def order_drawing(selection: Any) -> Drawing:
    """Held-out error by order of the power series, with its standard error over the
    folds.
    """
    errors = 100.0 * errors_of(selection.fold_scores.to_numpy())
    folds = np.where(np.isfinite(errors), errors, np.nan)
    at, error = np.arange(len(folds)), folds.mean(axis=1)
    marks: list[Mark] = [
        Line(at, fold, "" if k else "each fold", width=0.8, opacity=0.3)
        for k, fold in enumerate(folds.T)
    ]
    spread = [standard_error(row) for row in folds]
    marks.append(
        Line(at, error, "mean and standard error", width=1.5, marker="o", error=spread)
    )
    if "free_run_error" in selection.table:
        marks.append(
            Line(
                at,
                selection.table["free_run_error"],
                "free run",
                "orange",
                1.5,
                "dash",
                "s",
            )
        )
    chosen = selection.table["chosen"].to_numpy()
    marks.append(
        Line(at[chosen], error[chosen], "chosen", "red", dash="", marker="ring")
    )
    low, high = np.nanmin(error), np.nanmax(error)
    log = bool(low > 0 and high > 20 * low)
    what = {"acceleration": "acceleration", "free_run": "free-run"}.get(
        selection.scoring, "balance"
    )
    y = Axis(
        f"held-out {what} error (% NRMSE)", limits=None if log else (0, None), log=log
    )
    ticks = [str(order) for order in selection.fold_scores.index]
    return Drawing(
        [
            Figure(
                "Order selection",
                marks,
                Axis("total degree, or box (k, q)", ticks=ticks),
                y,
            )
        ]
    )


def change_figure(
    table: pd.DataFrame, site: Any, largest: float | None = None, colorbar: bool = True
) -> Figure:
    """Where in the (v, s) plane the force of a site changed (``ChangeReport.map``), and
    where significantly.
    """
    n = int(round(len(table) ** 0.5))
    columns = (
        table[k].to_numpy().reshape(n, n)
        for k in ("v", "s", "change", "visited", "significant")
    )
    v, s, change, visited, significant = columns
    shown = np.where(visited, change, np.nan)
    top = largest or float(np.nanmax(np.abs(shown))) or 1.0
    found = Map(
        s,
        v,
        shown,
        "change of force (N)",
        top,
        visited & ~significant,
        "not significant",
        colorbar,
    )
    i = index_of(site)
    x, y = Axis(f"drift s_{{{i}}}", "m"), Axis(f"rate v_{{{i}}}", "m/s")
    return Figure(f"Change of the force of {site}", [found], x, y, heading=str(site))
