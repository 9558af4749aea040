"""Figures that compare models: orders, the change between two tests."""

from typing import Any

import numpy as np
import pandas as pd

from ...selection.one_se_rule import errors_of, standard_error
from ._figure import Axis, Figure, Line, Map, Mark, index_of
from ._matplotlib import Drawing


def order_drawing(selection: Any) -> Drawing:
    """Held-out error by order of the power series, with its standard error over the folds."""
    errors = 100.0 * errors_of(selection.fold_scores.to_numpy())
    folds = np.where(np.isfinite(errors), errors, np.nan)
    at, error = np.arange(len(folds)), folds.mean(axis=1)
    marks: list[Mark] = [
        Line(at, fold, "" if k else "each fold", width=0.8, opacity=0.3) for k, fold in enumerate(folds.T)
    ]
    spread = [standard_error(row) for row in folds]
    marks.append(Line(at, error, "mean and standard error", width=1.5, marker="o", error=spread))
    if "free_run_error" in selection.table:
        marks.append(Line(at, selection.table["free_run_error"], "free run", "orange", 1.5, "dash", "s"))
    chosen = selection.table["chosen"].to_numpy()
    marks.append(Line(at[chosen], error[chosen], "chosen", "red", dash="", marker="ring"))
    low, high = np.nanmin(error), np.nanmax(error)
    log = bool(low > 0 and high > 20 * low)
    what = {"acceleration": "acceleration", "free_run": "free-run"}.get(selection.scoring, "balance")
    y = Axis(f"held-out {what} error (% NRMSE)", limits=None if log else (0, None), log=log)
    ticks = [str(order) for order in selection.fold_scores.index]
    return Drawing([Figure("Order selection", marks, Axis("total degree, or box (k, q)", ticks=ticks), y)])


def change_figure(table: pd.DataFrame, site: Any, largest: float | None = None, colorbar: bool = True) -> Figure:
    """Where in the (v, s) plane the force of a site changed (``ChangeReport.map``), and where significantly."""
    n = int(round(len(table) ** 0.5))
    columns = (table[k].to_numpy().reshape(n, n) for k in ("v", "s", "change", "visited", "significant"))
    v, s, change, visited, significant = columns
    shown = np.where(visited, change, np.nan)
    top = largest or float(np.nanmax(np.abs(shown))) or 1.0
    found = Map(s, v, shown, "change of force (N)", top, visited & ~significant, "not significant", colorbar)
    i = index_of(site)
    x, y = Axis(f"drift s_{{{i}}}", "m"), Axis(f"rate v_{{{i}}}", "m/s")
    return Figure(f"Change of the force of {site}", [found], x, y, heading=str(site))
