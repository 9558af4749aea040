"""Figures of coefficients against time."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ...drawing.figure import Axis, Figure, Line, Mark


def course_figures(table: pd.DataFrame, instants: pd.DataFrame) -> list[Figure]:
    """One figure for each coefficient, with its band and its sudden changes.

    Parameters
    ----------
    table : DataFrame
        ``site``, ``term``, ``unit``, ``t``, ``value``, ``lower``, ``upper``.
    instants : DataFrame
        ``site``, ``term``, ``t``.
    """
    figures = []
    for (site, term), rows in table.groupby(["site", "term"], sort=False):
        of_term = (instants["site"] == site) & (instants["term"] == term)
        times = instants.loc[of_term, "t"].to_numpy(float)
        figures.append(_course_figure(str(site), str(term), rows, times))
    return figures


def _course_figure(
    site: str, term: str, rows: pd.DataFrame, instants: np.ndarray
) -> Figure:
    """One coefficient."""
    t = rows["t"].to_numpy()
    marks: list[Mark] = [Line(t, rows["value"], "value", "blue", 1.6)]
    low, high = rows["value"], rows["value"]
    caption = "Its band is not known."
    if rows["lower"].notna().all():
        low, high = rows["lower"], rows["upper"]
        marks.append(Line(t, low, "95 % band", "sky", 0.8, dash="dash"))
        marks.append(Line(t, high, "", "sky", 0.8, dash="dash"))
        caption = "With its 95 % band."
    ends = [float(low.min()), float(high.max())]
    for number, instant in enumerate(instants):
        name = "" if number else "sudden change"
        marks.append(Line([instant, instant], ends, name, "red", 0.8, dash="dot"))
    first, last = rows["value"].iloc[0], rows["value"].iloc[-1]
    unit = rows["unit"].iloc[0]
    return Figure(
        f"{site}, coefficient of {term} against time",
        marks,
        Axis("time", "s"),
        Axis(f"coefficient of {term}", unit),
        heading=site,
        alt=f"From {first:.4g} to {last:.4g} {unit}.",
        caption=caption,
    )
