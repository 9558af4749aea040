"""A forest plot: every estimate with its 95 % interval, as percent of the estimate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ...diagnosis.effects import Bounds
from ...drawing.figure import Axis, Figure, Line, Mark, Table

# Parameters that are drawn, the widest intervals first; more cannot be read.
DRAWN_PARAMETERS = 40
# Reach of the axis over the widest interval that excludes zero; the least, percent.
SPARE_REACH, LEAST_REACH = 1.3, 5.0


def intervals_figure(estimates: Mapping[str, float], bounds: Bounds) -> Figure | None:
    """Intervals of masses and coefficients side by side.

    Parameters
    ----------
    estimates : mapping of str to float
        By parameter, such as ``"m1"`` and ``"storey 2: s"``.
    bounds : mapping of str to (float, float)
        95 % intervals.

    Returns
    -------
    Figure or None
        None if there is no interval.
    """
    table = _table_of_intervals(estimates, bounds)
    if table.empty:
        return None
    width = table["upper"] - table["lower"]
    relative = (width / table["estimate"].abs()).rank(ascending=False)
    shown = table[relative <= DRAWN_PARAMETERS]

    percent = 100.0 / shown["estimate"].to_numpy()
    ends = shown[["lower", "upper"]].to_numpy() * percent[:, None] - 100.0
    ends = np.sort(ends, axis=1)
    reach = _reach_of_axis(ends)
    ends = np.clip(ends, -reach, reach)
    rows = np.arange(len(shown), dtype=float)
    gap = np.full(len(shown), np.nan)
    marks: list[Mark] = [
        Line(
            np.column_stack([ends, gap]).ravel(),
            np.column_stack([rows, rows, gap]).ravel(),
            "95 % interval",
            "blue",
            2.0,
        ),
        Line(0.0 * rows, rows, "estimate", "ink", 0.0, "", "o"),
    ]
    head = ["parameter", "estimate", "lower", "upper"]
    return Figure(
        "Intervals of masses and coefficients",
        marks,
        Axis("deviation from the estimate", "%", (-reach, reach), zero=True),
        Axis(ticks=[str(name) for name in shown.index]),
        alt=(
            f"95 % intervals of {len(shown)} parameters; the widest is that of"
            f" {relative.idxmin()}."
        ),
        caption=(
            "Each interval as percent of its estimate. One that reaches -100 % holds"
            f" zero. Drawn up to {reach:.3g} %."
        ),
        lying=True,
        legend="above",
        size=(6.0, 1.2 + 0.28 * len(shown)),
        table=Table("95 % intervals", head, shown.reset_index().to_numpy().tolist()),
    )


def _reach_of_axis(ends: np.ndarray) -> float:
    """Half-width of the axis, percent: intervals that hold zero are cut off at it."""
    widths = np.abs(ends).max(axis=1)
    determined = widths[widths < 100.0]
    if not determined.size:
        return 100.0
    return max(LEAST_REACH, SPARE_REACH * float(determined.max()))


def _table_of_intervals(estimates: Mapping[str, float], bounds: Bounds) -> pd.DataFrame:
    """Estimates that are not zero and have an interval."""
    rows = {}
    for name, value in estimates.items():
        low, high = bounds.get(name, (np.nan, np.nan))
        if value and np.isfinite([low, high]).all():
            rows[name] = (float(value), low, high)
    columns = ["estimate", "lower", "upper"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)
