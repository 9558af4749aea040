"""Figures of the page as plain plotly dictionaries; colours are names that the page's style sheet defines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .tables import Table

# Resolved in the browser, so that one figure is readable in light, in dark and in print.
INK, MUTED, BLUE, ORANGE, GREEN, RED, SKY = (
    "var(--ink)",
    "var(--muted)",
    "var(--blue)",
    "var(--orange)",
    "var(--green)",
    "var(--red)",
    "var(--sky)",
)
SERIES = (MUTED, BLUE, ORANGE, GREEN, RED, SKY)


@dataclass
class Figure:
    """A figure with its words and its numbers.

    Attributes
    ----------
    title : str
    alt : str
        What is seen, for those who cannot see it.
    data, layout : plotly's own
    table : Table
        The numbers behind it.
    caption : str
    wide : bool
    """

    title: str
    alt: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    table: Table | None = None
    caption: str = ""
    wide: bool = False

    @property
    def turns(self) -> bool:
        """Whether it is a scene in space."""
        return "scene" in self.layout


def plain(text: Any) -> str:
    """Text that plotly shows as it is: it would read tags and entities in it."""
    return str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def rounded(values: Any, digits: int = 4) -> list[Any]:
    """Numbers with so many digits of the largest one; None where there is none."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    top = float(np.abs(finite).max()) if finite.size else 0.0
    places = digits - int(math.floor(math.log10(top))) if top > 0 else 0
    places = min(places, 300)

    def one(x: float) -> float | None:
        return None if not math.isfinite(x) else round(x, places)

    return [one(x) for x in array.tolist()] if array.ndim == 1 else [[one(x) for x in row] for row in array.tolist()]


def unit_of(values: Any, base: str) -> tuple[float, str]:
    """A factor and a unit in which numbers are neither tiny nor huge."""
    array = np.abs(np.asarray(values, dtype=float))
    top = float(np.nanmax(array)) if array.size and np.isfinite(array).any() else 1.0
    for factor, prefix in ((1e-6, "M"), (1e-3, "k")):
        if base == "N" and top * factor >= 1.0:
            return factor, prefix + base
    if top >= (0.5 if base != "N" else 0.0) or top == 0:
        return 1.0, base
    for factor, prefix in ((1e3, "m"), (1e6, "µ")):
        if base != "N" and top * factor >= 0.5:
            return factor, prefix + base
    return 1.0, base


def axis(title: str, **more: Any) -> dict[str, Any]:
    """An axis with a title and its unit."""
    return {"title": {"text": title, "standoff": 8}, "automargin": True, "zeroline": False, **more}


def layout(
    x: dict[str, Any], y: dict[str, Any], height: int = 300, showlegend: bool = True, **more: Any
) -> dict[str, Any]:
    """Layout of a plane figure."""
    legend = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "xanchor": "left"}
    margin = {"l": 52, "r": 14, "t": 34 if showlegend else 8, "b": 44}
    return {
        "xaxis": x, "yaxis": y, "height": height, "legend": legend, "margin": margin, "hovermode": "closest",
        "showlegend": showlegend, **more,
    }  # fmt: skip


def bars(
    names: Sequence[str], values: Any, colors: Any, *, low: Any = None, high: Any = None, name: str = "", **more: Any
) -> dict[str, Any]:
    """Lying bars, the first on top, with bounds if they are given."""
    values = np.asarray(values, dtype=float)
    out: dict[str, Any] = {
        "type": "bar",
        "orientation": "h",
        "y": [plain(n) for n in names],
        "x": rounded(values),
        "marker": {"color": colors},
        "name": name,
        "hovertemplate": "%{y}: %{x:.3g}<extra></extra>",
        **more,
    }
    if low is not None and high is not None:
        up, down = np.asarray(high, dtype=float) - values, values - np.asarray(low, dtype=float)
        out["error_x"] = {
            "type": "data",
            "symmetric": False,
            "array": rounded(np.nan_to_num(np.clip(up, 0, None))),
            "arrayminus": rounded(np.nan_to_num(np.clip(down, 0, None))),
            "color": INK,
            "thickness": 1,
            "width": 3,
        }
    return out


def bar_layout(title: str, count: int, high: float = 105.0, **more: Any) -> dict[str, Any]:
    """Layout of lying bars."""
    y = axis("", autorange="reversed", ticks="", type="category")
    height = (92 if more.get("showlegend", True) else 66) + 26 * count
    return layout(axis(title, range=[0, high]), y, height, **more)
