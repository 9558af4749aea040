"""Figures of indicators of damage, cycle by cycle."""

from __future__ import annotations

import pandas as pd

from ...drawing.figure import CYCLE, Axis, Figure, Line, Mark

# Label of the ordinate, and its unit.
INDICATORS = {
    "loss": ("loss of stiffness", "%"),
    "energy": ("energy of a cycle", "J"),
    "plastic": ("cumulative plastic drift", "m"),
    "residual": ("residual drift", "m"),
}


def cycle_figures(table: pd.DataFrame) -> list[Figure]:
    """One figure for each indicator, a line for each storey.

    Parameters
    ----------
    table : DataFrame
        Of :class:`pysindy_nrf.monitoring.StoreyCycles`.
    """
    figures = []
    for indicator, (label, unit) in INDICATORS.items():
        marks: list[Mark] = []
        for number, (storey, rows) in enumerate(table.groupby("storey", sort=False)):
            middle = 0.5 * (rows["start"] + rows["end"])
            error = rows[f"{indicator}_upper"] - rows[indicator]
            color = CYCLE[number % len(CYCLE)]
            name = str(storey)
            value = rows[indicator]
            marks.append(Line(middle, value, name, color, marker="o", error=error))
        figures.append(
            Figure(
                f"{label[0].upper()}{label[1:]} by storey and cycle",
                marks,
                Axis("time", "s"),
                Axis(label, unit),
                caption="With 95 % intervals.",
            )
        )
    return figures
