"""Figures as plotly's plain dictionaries.

Colours are names that the page's style sheet defines. The browser resolves them, so
that one figure is readable in light, in dark and in print.
"""

from __future__ import annotations

import math
import re
from typing import TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike

from ...drawing.figure import Axis, Bars, Figure, Line, Map, Surface

_INK, _MUTED = "var(--ink)", "var(--muted)"
_MARKERS = {"|": "line-ns-open", "ring": "circle-open", "s": "square"}
_MARKER_SIZES = {"|": 15, "ring": 12}
_DASHES = {"shortdot": "longdashdot", "": "solid"}
_CAMERA = {
    "eye": {"x": -1.5, "y": -1.72, "z": 0.95},
    "center": {"x": 0, "y": 0, "z": -0.12},
}
# Prefixes of units with the factor from SI, and the least number that is shown in them.
_PREFIXES: dict[str, tuple[tuple[float, str, float], ...]] = {
    "N": ((1e-6, "M", 1.0), (1e-3, "k", 1.0)),
    "m": ((1.0, "", 0.5), (1e3, "m", 0.5), (1e6, "µ", 0.5)),
}
_PREFIXES |= dict.fromkeys(("m/s", "s", "rad", "rad/s"), _PREFIXES["m"])
_PREFIXES["N m"] = _PREFIXES["N"]
# Digits of numbers along lines and bars, and on surfaces.
DIGITS, DIGITS_OF_SURFACES = 4, 3
# Pixels of a lying bar, and of what stands around the bars, with and without a legend.
LYING_BAR = 26
AROUND_BARS, AROUND_NAMED_BARS = 66, 92
# Points from which on an even abscissa is not written point by point.
LONG_LINE = 100
# Part of the height between two axes that stand below each other.
PANEL_GAP = 0.03
# Share of the range at its ends in which no tick of an axis in space stands, and the
# most ticks.
FREE_END, MAX_TICKS = 0.12, 5


# A dictionary of plotly: its values are texts, numbers, lists and dictionaries.
Spec = dict[str, object]


class Plot(TypedDict):
    """A figure as plotly reads it."""

    data: list[Spec]
    layout: Spec


def as_plotly(figure: Figure) -> Plot:
    """Data and layout of a figure.

    Parameters
    ----------
    figure : Figure

    Returns
    -------
    Plot
        ``data`` and ``layout``, as plotly reads them; numbers in a prefix of their unit
        that makes them neither tiny nor huge.

    Examples
    --------
    >>> from pysindy_nrf.report import Axis, Figure, Line, as_plotly
    >>> drift = Line([0.0, 1.0], [0.0, 0.002], name="measured")
    >>> plot = as_plotly(
    ...     Figure("Drift", [drift], Axis("time", "s"), Axis("s", "m"))
    ... )
    >>> plot["layout"]["yaxis"]["title"]["text"], plot["data"][0]["y"]
    ('s (mm)', [0.0, 2.0])
    """
    scales, units = [], []
    for side, axis in zip("xyz", figure.axes):
        factor, unit = unit_of(_drawn_along(figure, side), axis.unit)
        scales.append(factor)
        units.append(unit)

    data = _traces(figure, scales)
    hover = _hover(figure, units)
    for trace in data:
        if "hoverinfo" not in trace:
            trace["hovertemplate"] = f"{hover}<extra>{trace['name']}</extra>"

    titles = []
    for axis, unit in zip(figure.axes, units):
        label = f"{axis.label} ({unit})" if unit else axis.label
        titles.append(plain(label))
    if figure.z is not None:
        return {"data": data, "layout": _layout_in_space(titles, data, figure.height)}
    plot: Plot = {"data": data, "layout": _layout_in_plane(titles, figure)}
    return _with_panels_below(plot, figure) if figure.below else plot


def _with_panels_below(plot: Plot, figure: Figure) -> Plot:
    """A plot with the figures below it, on the same abscissa."""
    data, layout = list(plot["data"]), dict(plot["layout"])
    bottoms, tops = _stacked_domains(len(figure.panels))
    upright = cast(Spec, layout["yaxis"])
    layout["yaxis"] = upright | {"domain": [bottoms[0], tops[0]]}
    for number, panel in enumerate(figure.below, 2):
        further = as_plotly(panel)
        data += [trace | {"yaxis": f"y{number}"} for trace in further["data"]]
        upright = cast(Spec, further["layout"]["yaxis"])
        domain = [bottoms[number - 1], tops[number - 1]]
        layout[f"yaxis{number}"] = upright | {"domain": domain}

    lowest = cast(Spec, further["layout"]["xaxis"])
    clock: Spec = {"title": lowest["title"], "anchor": f"y{number}"}
    layout["xaxis"] = cast(Spec, layout["xaxis"]) | clock
    layout["showlegend"] = any(panel.named for panel in figure.panels)
    layout["height"] = sum(panel.height for panel in figure.panels)
    return {"data": data, "layout": layout}


def _stacked_domains(n_panels: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends of panels of equal height, from the top down."""
    height = (1.0 - PANEL_GAP * (n_panels - 1)) / n_panels
    tops = 1.0 - np.arange(n_panels) * (height + PANEL_GAP)
    return np.clip(tops - height, 0.0, 1.0), tops


def _traces(figure: Figure, scales: list[float]) -> list[Spec]:
    """What plotly draws of each mark."""
    traces = []
    for mark in figure.marks:
        if isinstance(mark, Bars):
            traces.append(_bars(mark, figure.lying))
        elif isinstance(mark, Line):
            traces.append(_line(mark, scales))
        elif isinstance(mark, Surface):
            traces.append(_surface(mark, scales))
        else:
            traces.append(_map(mark, scales))
    return traces


def _drawn_along(figure: Figure, side: str) -> np.ndarray:
    """All numbers along an axis that set its unit: those of what is drawn in full."""
    numbers = [np.array([np.nan])]
    for mark in figure.marks:
        in_full = isinstance(mark, Line) or getattr(mark, "style", "") == "full"
        values = getattr(mark, side, None) if in_full else None
        if values is not None:
            numbers.append(np.ravel(np.asarray(values, dtype=float)))
    return np.concatenate(numbers)


def _hover(figure: Figure, units: list[str]) -> str:
    """Template of what is shown under the pointer: label, number and unit by axis."""
    lines = []
    for side, axis, unit in zip("xyz", figure.axes, units):
        number = f"%{{{side}:.4g}}" if axis.ticks is None else f"%{{{side}}}"
        parts = (plain(axis.label), number, plain(unit))
        lines.append(" ".join(filter(None, parts)))
    return "<br>".join(lines)


def unit_of(values: ArrayLike, base: str) -> tuple[float, str]:
    """A factor and a unit in which numbers are neither tiny nor huge."""
    sizes = np.abs(np.asarray(values, dtype=float))
    largest = 0.0
    if sizes.size and np.isfinite(sizes).any():
        largest = float(np.nanmax(sizes))
    for factor, prefix, least in _PREFIXES.get(base, ()):
        if largest * factor >= least:
            return factor, prefix + base
    return 1.0, base


def plain(text: object) -> str:
    """Text that plotly shows as it is; indices are lowered.

    Plotly would read tags and entities in it.
    """
    safe = str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"_\{([^}]*)\}", r"<sub>\1</sub>", safe)


def rounded(values: ArrayLike, digits: int = DIGITS) -> list[object]:
    """Numbers with so many digits of the largest one; None where there is none."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    largest = float(np.abs(finite).max()) if finite.size else 0.0
    places = 0
    if largest > 0:
        places = min(digits - int(math.floor(math.log10(largest))), 300)

    numbers = np.empty(array.size, dtype=object)
    for k, number in enumerate(array.ravel().tolist()):
        numbers[k] = round(number, places) if math.isfinite(number) else None
    return numbers.reshape(array.shape).tolist()


# -- traces --------------------------------------------------------------------


def _line(line: Line, scales: list[float]) -> Spec:
    color = f"var(--{line.color})"
    modes = []
    if line.dash:
        modes.append("lines")
    if line.marker:
        modes.append("markers")
    dash = _DASHES.get(line.dash, line.dash)
    trace: Spec = {
        "type": "scatter",
        "mode": "+".join(modes),
        "name": plain(line.name),
        "opacity": line.opacity,
        "line": {"color": color, "width": line.width, "dash": dash},
    }
    for side, values, scale in zip("xyz", (line.x, line.y, line.z), scales):
        trace[side] = rounded(scale * np.asarray(values))
    if line.z is None:
        trace = _with_even_abscissa(trace, scales[0] * np.asarray(line.x, dtype=float))
    if line.marker:
        trace["marker"] = _marker(line.marker, color)
    if line.error is not None:
        half = rounded(scales[1] * np.asarray(line.error))
        style = {"thickness": 1, "width": 2, "color": _INK}
        trace["error_y"] = {"type": "data", "array": half, **style}
    if line.z is not None:
        trace |= {"type": "scatter3d", "hoverinfo": "skip"}
    return trace


def _with_even_abscissa(trace: Spec, x: np.ndarray) -> Spec:
    """A trace whose long even abscissa is written by its start and its step."""
    if len(x) < LONG_LINE:
        return trace
    step = (x[-1] - x[0]) / (len(x) - 1)
    if not np.allclose(np.diff(x), step, rtol=1e-3, atol=0.0):
        return trace
    even = {name: values for name, values in trace.items() if name != "x"}
    return even | {"x0": float(f"{x[0]:.6g}"), "dx": float(f"{step:.8g}")}


def _marker(name: str, color: str) -> Spec:
    """The marks of a line."""
    marker: Spec = {
        "symbol": _MARKERS.get(name, "circle"),
        "size": _MARKER_SIZES.get(name, 5),
        "color": color,
    }
    if name == "|":
        marker["line"] = {"width": 2.5, "color": color}
    return marker


def _bars(bars: Bars, lying: bool) -> Spec:
    values = np.asarray(bars.values, dtype=float)
    colors: str | list[str] = f"var(--{bars.color})"
    if not isinstance(bars.color, str):
        colors = [f"var(--{name})" for name in bars.color]
    along, across = ("x", "y") if lying else ("y", "x")
    marker: Spec = {"color": colors}
    if bars.hatched:
        marker["pattern"] = {"shape": "/"}
    trace: Spec = {
        "type": "bar",
        "orientation": "h" if lying else "v",
        "name": plain(bars.name),
        across: list(range(len(values))),
        along: rounded(values),
        "marker": marker,
    }
    if bars.low is not None:
        up = np.asarray(bars.high, dtype=float) - values
        down = values - np.asarray(bars.low, dtype=float)
        trace[f"error_{along}"] = {
            "type": "data",
            "symmetric": False,
            "array": _half_length(up),
            "arrayminus": _half_length(down),
            "color": _INK,
            "thickness": 1,
            "width": 3,
        }
    return trace


def _half_length(values: np.ndarray) -> list[object]:
    """One side of error bars; nothing where it is not known."""
    return rounded(np.nan_to_num(np.clip(values, 0, None)))


def _surface(surface: Surface, scales: list[float]) -> Spec:
    trace: Spec = {
        "type": "surface",
        "x": rounded(scales[0] * np.asarray(surface.x)[0]),
        "y": rounded(scales[1] * np.asarray(surface.y)[:, 0]),
        "z": rounded(scales[2] * np.asarray(surface.z), DIGITS_OF_SURFACES),
        "name": plain(surface.name),
        "showscale": False,
    }
    if surface.style == "full":
        return trace | {
            "colorscale": "Cividis",
            "contours": {"z": {"show": False}},
            "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
        }
    return trace | {
        "opacity": 0.28,
        "hoverinfo": "skip",
        "colorscale": [[0, _MUTED], [1, _MUTED]],
    }


def _map(field: Map, scales: list[float]) -> Spec:
    """Values by colour; what is in doubt is left out."""
    values = np.where(field.hatched, np.nan, np.asarray(field.values, dtype=float))
    colours = [[0.0, "var(--orange)"], [0.5, "var(--card)"], [1.0, "var(--blue)"]]
    return {
        "type": "heatmap",
        "x": rounded(scales[0] * np.asarray(field.x)[0]),
        "y": rounded(scales[1] * np.asarray(field.y)[:, 0]),
        "z": rounded(values, DIGITS_OF_SURFACES),
        "name": plain(field.label),
        "zmin": -field.limit,
        "zmax": field.limit,
        "colorscale": colours,
        "showscale": field.bar,
        "colorbar": {"title": {"text": plain(field.label), "side": "right"}},
    }


# -- layout --------------------------------------------------------------------


def _layout_in_plane(titles: list[str], figure: Figure) -> Spec:
    x, y = _axis(titles[0], figure.x), _axis(titles[1], figure.y)
    height = figure.height
    if figure.lying:
        y |= {"autorange": "reversed", "ticks": ""}
        around = AROUND_NAMED_BARS if figure.named else AROUND_BARS
        height = around + LYING_BAR * len(figure.y.ticks or ())
    legend = {"orientation": "h", "x": 0, "y": 1.02}
    legend |= {"yanchor": "bottom", "xanchor": "left"}
    layout: Spec = {
        "xaxis": x,
        "yaxis": y,
        "height": height,
        "hovermode": "closest",
        "showlegend": figure.named,
        "legend": legend,
        "margin": {"l": 52, "r": 14, "t": 34 if figure.named else 8, "b": 44},
    }
    if figure.n_bars > 1:
        layout |= {"barmode": "group", "bargap": 0.25}
    return layout


def _axis(title: str, axis: Axis) -> Spec:
    layout: Spec = {
        "title": {"text": title, "standoff": 8},
        "automargin": True,
        "zeroline": axis.zero,
    }
    if axis.ticks is not None:
        layout["tickvals"] = list(range(len(axis.ticks)))
        layout["ticktext"] = [plain(text) for text in axis.ticks]
    if axis.log:
        # plotly takes the ends of such an axis as powers of ten
        layout |= {"type": "log", "exponentformat": "power", "dtick": 1}
    if axis.limits == (0, None):
        layout["rangemode"] = "tozero"
    elif axis.limits is not None:
        layout["range"] = [_plotted(end, axis.log) for end in axis.limits]
    return layout


def _plotted(end: float | None, log: bool) -> float | None:
    """An end of an axis as plotly reads it."""
    if end is None or not log:
        return end
    return math.log10(end)


def _layout_in_space(titles: list[str], data: list[Spec], height: int) -> Spec:
    # the title of an upright axis leaves the picture when it turns: it stands still in
    # the corner
    upright: Spec = {"text": f"upright: {titles[2]}", "showarrow": False}
    upright |= {"x": 0, "y": 1, "xref": "paper", "yref": "paper"}
    upright |= {"xanchor": "left", "yanchor": "top"}
    scene: Spec = {
        "camera": _CAMERA,
        "aspectmode": "manual",
        "aspectratio": {"x": 1.1, "y": 1.1, "z": 0.75},
    }
    for side, title in zip("xyz", (*titles[:2], "")):
        numbers = [np.ravel(np.asarray(trace[side], dtype=float)) for trace in data]
        scene[f"{side}axis"] = {
            "title": {"text": title},
            "tickmode": "array",
            "tickvals": ticks(np.concatenate(numbers)),
        }
    return {
        "annotations": [upright],
        "scene": scene,
        "height": height,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "showlegend": False,
    }


def ticks(values: np.ndarray) -> list[float]:
    """Three to five round numbers inside the range.

    None near its ends, where those of two axes would touch.
    """
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return []

    low, high = low + FREE_END * span, high - FREE_END * span
    wanted = (high - low) / 3
    step = 10.0 ** np.floor(np.log10(wanted))
    step *= max(k for k in (1, 2, 5) if k == 1 or k * step <= wanted)
    multiples = np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    if len(multiples) > MAX_TICKS:
        multiples = multiples[multiples % 2 == 0]
    return [float(f"{k * step:.6g}") for k in multiples]
