"""Figures as plotly's plain dictionaries; colours are names that the page's style sheet
defines.
"""

import math
import re
from typing import Any

import numpy as np

from .figure import Axis, Bars, Figure, Line, Surface

# Resolved in the browser, so that one figure is readable in light, in dark and in
# print.
_INK, _MUTED = "var(--ink)", "var(--muted)"
_MARKERS = {"|": "line-ns-open", "ring": "circle-open", "s": "square"}
_DASHES = {"shortdot": "longdashdot"}
_CAMERA = {
    "eye": {"x": -1.5, "y": -1.72, "z": 0.95},
    "center": {"x": 0, "y": 0, "z": -0.12},
}


def as_plotly(figure: Figure) -> dict[str, Any]:
    """Data and layout of a figure."""
    scales = [
        unit_of(_along(figure, side), axis.unit)
        for side, axis in zip("xyz", _axes(figure))
    ]
    factors = [factor for factor, _ in scales]
    drawn: dict[type, Any] = {
        Bars: _bars,
        Line: _line,
        Surface: _surface,
    }  # a map has no trace
    data = [
        drawn[type(mark)](mark, figure, factors)
        for mark in figure.marks
        if type(mark) in drawn
    ]
    titles = [
        plain(x.label + (f" ({unit})" if unit else ""))
        for x, (_, unit) in zip(_axes(figure), scales)
    ]
    shown = (
        (
            plain(axis.label),
            f"%{{{x}{':.4g' if axis.ticks is None else ''}}}",
            plain(unit),
        )
        for x, axis, (_, unit) in zip("xyz", _axes(figure), scales)
    )
    hover = "<br>".join(" ".join(filter(None, parts)) for parts in shown)
    for trace in (one for one in data if "hoverinfo" not in one):
        trace["hovertemplate"] = f"{hover}<extra>{trace['name']}</extra>"
    if figure.z is not None:
        return {"data": data, "layout": _scene(titles, data, figure.height)}
    x, y = (_axis(title, axis) for title, axis in zip(titles, _axes(figure)))
    height, upright = (
        figure.height,
        [mark for mark in figure.marks if isinstance(mark, Bars)],
    )
    if figure.lying:
        y |= {"autorange": "reversed", "ticks": ""}
        height = (92 if figure.named else 66) + 26 * len(figure.y.ticks or ())
    layout = {
        "xaxis": x,
        "yaxis": y,
        "height": height,
        "hovermode": "closest",
        "showlegend": figure.named,
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "yanchor": "bottom",
            "xanchor": "left",
        },
        "margin": {"l": 52, "r": 14, "t": 34 if figure.named else 8, "b": 44},
    }
    return {
        "data": data,
        "layout": (
            layout | ({"barmode": "group", "bargap": 0.25} if len(upright) > 1 else {})
        ),
    }


def unit_of(values: Any, base: str) -> tuple[float, str]:
    """A factor and a unit in which lengths, rates, forces and times are neither tiny
    nor huge.
    """
    array = np.abs(np.asarray(values, dtype=float))
    top = float(np.nanmax(array)) if array.size and np.isfinite(array).any() else 0.0
    prefixes = {
        "N": ((1e-6, "M", 1.0), (1e-3, "k", 1.0)),
        "m": ((1.0, "", 0.5), (1e3, "m", 0.5), (1e6, "µ", 0.5)),
    }
    prefixes |= {"m/s": prefixes["m"], "s": prefixes["m"]}
    fit = (
        (factor, prefix + base)
        for factor, prefix, least in prefixes.get(base, ())
        if top * factor >= least
    )
    return next(fit, (1.0, base))


def plain(text: Any) -> str:
    """Text that plotly shows as it is: it would read tags and entities in it; indices
    are lowered.
    """
    safe = str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"_\{([^}]*)\}", r"<sub>\1</sub>", safe)


def rounded(values: Any, digits: int = 4) -> list[Any]:
    """Numbers with so many digits of the largest one; None where there is none."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    top = float(np.abs(finite).max()) if finite.size else 0.0
    places = min(digits - int(math.floor(math.log10(top))) if top > 0 else 0, 300)
    kept = np.array(
        [
            round(x, places) if math.isfinite(x) else None
            for x in array.ravel().tolist()
        ],
        dtype=object,
    )
    return kept.reshape(array.shape).tolist()


def _axes(figure: Figure) -> list[Axis]:
    """The two or three axes."""
    return [axis for axis in (figure.x, figure.y, figure.z) if axis is not None]


def _along(figure: Figure, side: str) -> Any:
    """All numbers that an axis shows, for its unit; only of what is drawn in full."""
    shown = [
        mark
        for mark in figure.marks
        if isinstance(mark, Line) or getattr(mark, "style", "") == "full"
    ]
    lines = [getattr(mark, side, None) for mark in shown]
    return np.concatenate(
        [
            [np.nan],
            *(np.ravel(np.asarray(x, dtype=float)) for x in lines if x is not None),
        ]
    )


def _axis(title: str, axis: Axis) -> dict[str, Any]:
    out: dict[str, Any] = {
        "title": {"text": title, "standoff": 8},
        "automargin": True,
        "zeroline": axis.zero,
    }
    if axis.ticks is not None:
        out |= {
            "tickvals": list(range(len(axis.ticks))),
            "ticktext": [plain(text) for text in axis.ticks],
        }
    if axis.limits == (0, None):
        out["rangemode"] = "tozero"
    elif axis.limits is not None:
        out["range"] = list(axis.limits)
    return out


def _line(line: Line, figure: Figure, scales: list[float]) -> dict[str, Any]:
    color = f"var(--{line.color})"
    mode = "+".join(["lines"] * bool(line.dash) + ["markers"] * bool(line.marker))
    out: dict[str, Any] = {
        "type": "scatter",
        "mode": mode,
        "name": plain(line.name),
        "opacity": line.opacity,
        "line": {
            "color": color,
            "width": line.width,
            "dash": _DASHES.get(line.dash, line.dash or "solid"),
        },
        **{
            side: rounded(f * np.asarray(v))
            for side, v, f in zip("xyz", (line.x, line.y, line.z), scales)
        },
    }
    if line.marker:
        size = {"|": 15, "ring": 12}.get(line.marker, 5)
        out["marker"] = {
            "symbol": _MARKERS.get(line.marker, "circle"),
            "size": size,
            "color": color,
        }
        out["marker"] |= (
            {"line": {"width": 2.5, "color": color}} if line.marker == "|" else {}
        )
    if line.error is not None:
        out["error_y"] = {
            "type": "data",
            "array": rounded(scales[1] * np.asarray(line.error)),
            "thickness": 1,
        }
        out["error_y"] |= {"width": 2, "color": _INK}
    if line.z is not None:
        out |= {"type": "scatter3d", "hoverinfo": "skip"}
    return out


def _bars(bars: Bars, figure: Figure, scales: list[float]) -> dict[str, Any]:
    values = np.asarray(bars.values, dtype=float)
    colors = (
        f"var(--{bars.color})"
        if isinstance(bars.color, str)
        else [f"var(--{c})" for c in bars.color]
    )
    long, across = ("x", "y") if figure.lying else ("y", "x")
    out: dict[str, Any] = {
        "type": "bar",
        "orientation": "h" if figure.lying else "v",
        "name": plain(bars.name),
        across: list(range(len(values))),
        long: rounded(values),
        "marker": {"color": colors},
    }
    if bars.hatched:
        out["marker"]["pattern"] = {"shape": "/"}
    if bars.low is not None:
        ends = (
            np.asarray(bars.high, dtype=float) - values,
            values - np.asarray(bars.low, dtype=float),
        )
        up, down = (rounded(np.nan_to_num(np.clip(end, 0, None))) for end in ends)
        error = {"type": "data", "symmetric": False, "array": up, "arrayminus": down}
        out[f"error_{long}"] = error | {"color": _INK, "thickness": 1, "width": 3}
    return out


def _surface(surface: Surface, figure: Figure, scales: list[float]) -> dict[str, Any]:
    x, y = scales[0] * np.asarray(surface.x)[0], scales[1] * np.asarray(surface.y)[:, 0]
    out: dict[str, Any] = {
        "type": "surface",
        "x": rounded(x),
        "y": rounded(y),
        "name": plain(surface.name),
    }
    out |= {"z": rounded(scales[2] * np.asarray(surface.z), 3), "showscale": False}
    if surface.style == "full":
        return out | {
            "colorscale": "Cividis",
            "contours": {"z": {"show": False}},
            "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
        }
    return out | {
        "opacity": 0.28,
        "hoverinfo": "skip",
        "colorscale": [[0, _MUTED], [1, _MUTED]],
    }


def _scene(
    titles: list[str], data: list[dict[str, Any]], height: int
) -> dict[str, Any]:
    """Layout of a drawing in space."""

    def one(title: str, side: str) -> dict[str, Any]:
        shown = [np.ravel(np.asarray(trace[side], dtype=float)) for trace in data]
        return {
            "title": {"text": title},
            "tickmode": "array",
            "tickvals": ticks(np.concatenate(shown)),
        }

    # the title of an upright axis leaves the picture when it turns: it stands still in
    # the corner
    corner = {
        "x": 0,
        "y": 1,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "top",
        "showarrow": False,
    }
    return {
        "annotations": [{"text": f"upright: {titles[2]}", **corner}],
        "scene": {
            "xaxis": one(titles[0], "x"),
            "yaxis": one(titles[1], "y"),
            "zaxis": one("", "z"),
            "camera": _CAMERA,
            "aspectmode": "manual",
            "aspectratio": {"x": 1.1, "y": 1.1, "z": 0.75},
        },
        "height": height,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "showlegend": False,
    }


def ticks(values: np.ndarray) -> list[float]:
    """Three to five round numbers inside the range; none near its ends, where those of
    two axes would touch.
    """
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return []
    low, high = low + 0.12 * span, high - 0.12 * span
    decade = 10.0 ** np.floor(np.log10((high - low) / 3))
    step = decade * max(
        k for k in (1, 2, 5) if k == 1 or k * decade <= (high - low) / 3
    )
    inside = np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    if len(inside) > 5:
        inside = inside[inside % 2 == 0]
    return [float(f"{k * step:.6g}") for k in inside]
