"""Figures of control charts, storey by storey."""

from __future__ import annotations

import pandas as pd

from ...drawing.figure import Axis, Figure, Line, Mark


def chart_figures(table: pd.DataFrame) -> list[Figure]:
    """One control chart for each storey.

    Parameters
    ----------
    table : DataFrame
        Of :class:`pysindy_nrf.monitoring.Tracked`.
    """
    figures = []
    for storey, rows in table.groupby("storey", sort=False):
        test = rows["test"]
        raised = rows[rows["alarm"]]
        marks: list[Mark] = [
            Line(test, rows["statistic"], "average of what tests leave", marker="o"),
            Line(test, rows["limit"], "limit", "ink", 0.8, dash="dash"),
            Line(test, -rows["limit"], "", "ink", 0.8, dash="dash"),
        ]
        if len(raised):
            tests = raised["test"]
            marks.append(Line(tests, raised["statistic"], "alarm", "red", 0, "", "s"))
        figures.append(
            Figure(
                f"Control chart of the stiffness, {storey}",
                marks,
                Axis("test"),
                Axis("standard errors"),
                heading=str(storey),
                alt=f"{len(raised)} of {len(rows)} tests raise an alarm.",
                caption="What the covariates explain is left out.",
            )
        )
    return figures
