"""Figures that compare models: orders, the change between two tests."""

from typing import Any, Self

import numpy as np
import pandas as pd

from ...selection.one_se_rule import errors_of, standard_error
from ._figure import Axis, Figure, Line, Map, Mark, index_of
from ._matplotlib import Display


class OrderSelectionDisplay(Display):
    """Validation curve: held-out error with its standard error over the folds, by order of the power series."""

    def __init__(
        self, table: pd.DataFrame, folds: pd.DataFrame | None = None, ylabel: str = "held-out balance error (% NRMSE)"
    ) -> None:
        self.table, self.folds, self.ylabel = table, folds, ylabel

    @classmethod
    def from_selection(cls, selection: Any) -> Self:
        """From what :func:`pysindy_nrf.select_order` found."""
        scores = selection.fold_scores
        folds = pd.DataFrame(100.0 * errors_of(scores.to_numpy()), index=scores.index, columns=scores.columns)
        folds = folds.replace(np.inf, np.nan)
        spread, chosen = [standard_error(row) for row in folds.to_numpy()], selection.table["chosen"].to_numpy()
        table = pd.DataFrame({"error": folds.mean(axis=1, skipna=False), "standard_error": spread, "chosen": chosen})
        if "free_run_error" in selection.table:
            table["free_run_error"] = selection.table["free_run_error"]
        words = {"acceleration": "acceleration error", "free_run": "free-run error"}
        what = words.get(selection.scoring, "balance error")
        return cls(table, folds, f"held-out {what} (% NRMSE)")

    def figures(self) -> list[Figure]:
        at, error = np.arange(len(self.table)), self.table["error"].to_numpy()
        marks: list[Mark] = []
        for k, fold in enumerate(() if self.folds is None else self.folds.to_numpy().T):
            marks.append(Line(at, fold, "" if k else "each fold", width=0.8, opacity=0.3))
        spread = self.table["standard_error"]
        marks.append(Line(at, error, "mean and standard error", width=1.5, marker="o", error=spread))
        if "free_run_error" in self.table:
            marks.append(Line(at, self.table["free_run_error"], "free run", "orange", 1.5, "dash", "s"))
        chosen = self.table["chosen"].to_numpy()
        marks.append(Line(at[chosen], error[chosen], "chosen", "red", dash="", marker="ring"))
        low, high = np.nanmin(error), np.nanmax(error)
        log = bool(low > 0 and high > 20 * low)
        y = Axis(self.ylabel, limits=(0, None) if low >= 0 and not log else None, log=log)
        x = Axis("order of the power series: total degree, or box (k, q)", ticks=[str(n) for n in self.table.index])
        return [Figure("Order selection", marks, x, y)]


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
