"""Figures of a model: surfaces that turn, loops, modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from ...discrepancy.site_loops import SiteLoop
from ...exceptions import NRFError
from ...mechanics.sites import Site
from ...regression.chain_model import ChainModel
from .equations import as_text
from .figures import BLUE, INK, MUTED, ORANGE, Figure, axis, layout, plain, rounded, unit_of
from .tables import Table, rows_table

_SIZE = 33
_CAMERA = {"eye": {"x": -1.5, "y": -1.72, "z": 0.95}, "center": {"x": 0, "y": 0, "z": -0.12}}


def surface(model: ChainModel, site: Site, loop: SiteLoop | None = None) -> Figure | None:
    """Restoring force over drift and rate; where the force depends on the path, the path itself."""
    force = model.restoring_forces[site]
    if force.has_memory or site not in model.visited:
        return None if loop is None else _path(force.has_memory, loop)
    try:
        grid = model.surface(site, _SIZE, margin=0.08)
    except NRFError:  # a law that needs time or a covariate is no surface
        return None if loop is None else _path(True, loop)
    v, s, R = (grid[k].to_numpy().reshape(_SIZE, _SIZE) for k in ("v", "s", "R"))
    visited = grid["visited"].to_numpy().reshape(_SIZE, _SIZE)
    inside = R[visited] if visited.any() else R
    room = 0.25 * float(np.ptp(inside)) or 1.0
    low, high = float(inside.min()) - room, float(inside.max()) + room
    (fs, us), (fv, uv), (fr, ur) = unit_of(s, "m"), unit_of(v, "m/s"), unit_of(inside, "N")
    x, y = rounded(fs * s[0]), rounded(fv * v[:, 0])
    flat = [[0, MUTED], [1, MUTED]]
    data = [
        {
            "type": "surface", "x": x, "y": y, "z": rounded(fr * np.where(visited, R, np.nan)), "name": "visited",
            "colorscale": "Cividis", "showscale": False, "hovertemplate": _hover(us, uv, ur),
            "contours": {"z": {"show": False}}, "lighting": {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05},
        },
        {
            "type": "surface", "x": x, "y": y, "name": "not visited", "opacity": 0.28, "hoverinfo": "skip",
            "z": rounded(fr * np.where((R > low) & (R < high), R, np.nan)), "colorscale": flat, "showscale": False,
        },
    ]  # fmt: skip
    if loop is not None:
        data.append(_line(loop, fs, fv, fr, "path of the data"))
    index = _index(site)
    alt = (
        f"Restoring force of {site} over drift and rate. It reaches from {inside.min():.3g} to {inside.max():.3g} N "
        f"for drifts of {s.min():.3g} to {s.max():.3g} m and rates of {v.min():.3g} to {v.max():.3g} m/s."
    )
    return Figure(
        f"Restoring-force surface of {site}",
        alt,
        data,
        _scene(index, us, uv, ur, (fs * s, fv * v, fr * np.clip(R, low, high))),
        _grid_table(site, v, s, R, visited),
        "Coloured where the data were, grey where the law is extrapolated; the line is the path of the data. "
        "Drag to turn, or use the arrow keys.",
    )


def _path(memory: bool, loop: SiteLoop) -> Figure:
    (fs, us), (fv, uv), (fr, ur) = unit_of(loop.s, "m"), unit_of(loop.v, "m/s"), unit_of(loop.identified, "N")
    why = "The force depends on the path, so it is no surface" if memory else "The visited region is not known"
    alt = f"Path of the identified force of {loop.site} over drift and rate, from {_range(loop.identified, 'N')}."
    return Figure(
        f"Force of {loop.site} along its path",
        alt,
        [_line(loop, fs, fv, fr, "identified", BLUE, 3)],
        _scene(_index(Site(loop.site)), us, uv, ur, (fs * loop.s, fv * loop.v, fr * loop.identified)),
        _loop_table(loop),
        f"{why}: the identified force along the data. Drag to turn, or use the arrow keys.",
    )


def loop_figure(loop: SiteLoop, stiffness: float = 0.0) -> Figure:
    """Force over drift, identified over measured."""
    if stiffness:
        spring = stiffness * loop.s
        measured = None if loop.measured is None else loop.measured - spring
        loop = replace(loop, identified=loop.identified - spring, measured=measured)
    (fs, us), (fr, ur) = unit_of(loop.s, "m"), unit_of(loop.identified, "N")
    x = rounded(fs * loop.s)
    data = []
    if loop.measured is not None:
        data.append(
            {"type": "scatter", "mode": "lines", "x": x, "y": rounded(fr * loop.measured), "name": "measured",
             "line": {"color": ORANGE, "width": 2.2}, "opacity": 0.85}
        )  # fmt: skip
    data.append(
        {"type": "scatter", "mode": "lines", "x": x, "y": rounded(fr * loop.identified), "name": "identified",
         "line": {"color": BLUE, "width": 1.1}}
    )  # fmt: skip
    index = _index(Site(loop.site))
    gap = "" if loop.measured is None else f", rms difference {_rms(loop.measured - loop.identified):.3g} N"
    without = f" without its linear spring of {as_text(stiffness)} N/m" if stiffness else ""
    shown = f"Force of {loop.site}{without} over its drift, identified over measured"
    alt = f"{shown}: {_range(loop.identified, 'N')}{gap}."
    name = f"R{index} − k s{index}" if stiffness else f"R{index}"
    where = f" Around the largest motion of {loop.record}." if loop.record not in ("", "0") else ""
    how = "Measured is what the balances above ask for." if loop.measured is not None else "Nothing else measures it."
    return Figure(
        f"Loops of {loop.site} without its spring" if stiffness else f"Hysteresis loops of {loop.site}",
        alt,
        data,
        layout(axis(f"drift s{index} ({us})"), axis(f"{name} ({ur})"), 380),
        _loop_table(loop),
        f"The same without its linear spring, k = {as_text(stiffness)} N/m: what is left is damping, friction, "
        "memory and curvature."
        if stiffness
        else f"{how}{where}",
    )


def _line(
    loop: SiteLoop, fs: float, fv: float, fr: float, name: str, color: str = INK, width: float = 1.5
) -> dict[str, object]:
    return {
        "type": "scatter3d", "mode": "lines", "name": name, "hoverinfo": "skip",
        "x": rounded(fs * loop.s), "y": rounded(fv * loop.v), "z": rounded(fr * loop.identified),
        "line": {"color": color, "width": width},
    }  # fmt: skip


def _hover(us: str, uv: str, ur: str) -> str:
    return f"s %{{x:.3g}} {us}<br>v %{{y:.3g}} {uv}<br>R %{{z:.4g}} {ur}<extra></extra>"


def _scene(index: str, us: str, uv: str, ur: str, data: tuple[np.ndarray, np.ndarray, np.ndarray]) -> dict[str, object]:
    def one(title: str, values: np.ndarray) -> dict[str, object]:
        return {"title": {"text": title}, "tickmode": "array", "tickvals": _ticks(values)}

    # the title of an upright axis leaves the picture when it turns: it stands still in the corner
    corner = {"x": 0, "y": 1, "xref": "paper", "yref": "paper", "xanchor": "left", "yanchor": "top", "showarrow": False}
    return {
        "annotations": [{"text": f"upright: R{index} ({ur})", **corner}],
        "scene": {
            "xaxis": one(f"s{index} ({us})", data[0]), "yaxis": one(f"v{index} ({uv})", data[1]),
            "zaxis": one("", data[2]),
            "camera": _CAMERA, "aspectmode": "manual", "aspectratio": {"x": 1.1, "y": 1.1, "z": 0.75},
        },
        "height": 380, "margin": {"l": 0, "r": 0, "t": 0, "b": 0}, "showlegend": False,
    }  # fmt: skip


def _ticks(values: np.ndarray) -> list[float]:
    """Three to five round numbers inside the range; none near its ends, where those of two axes would touch."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return []
    low, high = low + 0.12 * span, high - 0.12 * span
    decade = 10.0 ** np.floor(np.log10((high - low) / 3))
    step = decade * max(k for k in (1, 2, 5) if k == 1 or k * decade <= (high - low) / 3)
    inside = np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    if len(inside) > 5:
        inside = inside[inside % 2 == 0]
    return [float(f"{k * step:.6g}") for k in inside]


def _index(site: Site) -> str:
    text = plain(site.p if site.is_storey else f"{site.p},{site.q}" if site.kind == "link" else f"dof {site.p}")
    return f"<sub>{text}</sub>"


def _grid_table(site: Site, v: np.ndarray, s: np.ndarray, R: np.ndarray, visited: np.ndarray) -> Table:
    pick = np.linspace(0, _SIZE - 1, 7).astype(int)
    rows = []
    for i in pick:
        row: list[float | str] = [float(f"{v[i, 0]:.3g}")]
        row += [float(f"{R[i, j]:.4g}") if visited[i, j] else "" for j in pick]
        rows.append(row)
    head = ["v (m/s)", *(f"s = {s[0, j]:.3g} m" for j in pick)]
    return rows_table(f"Force of {site} (N) by rate and drift; empty where the data never were", head, rows)


def _loop_table(loop: SiteLoop) -> Table:
    rows = [["identified", _rms(loop.identified), float(np.abs(loop.identified).max()), _work(loop, loop.identified)]]
    if loop.measured is not None:
        rows.append(["measured", _rms(loop.measured), float(np.abs(loop.measured).max()), _work(loop, loop.measured)])
        gap = loop.measured - loop.identified
        rows.append(["difference", _rms(gap), float(np.abs(gap).max()), _work(loop, gap)])
    head = ["force", "rms (N)", "peak (N)", "energy taken out (J)"]
    return rows_table(f"Forces of {loop.site} in the stretch drawn", head, rows)


def _work(loop: SiteLoop, force: np.ndarray) -> float:
    return float(np.trapezoid(force * loop.v, loop.t))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _range(x: np.ndarray, unit: str) -> str:
    return f"{x.min():.3g} to {x.max():.3g} {unit}"


def mode_shapes(modes: pd.DataFrame) -> Figure:
    """Shapes of the linear part, floor over displacement."""
    floors = [c for c in modes.columns if c.startswith("dof")]
    colors = (BLUE, ORANGE, "var(--green)", "var(--red)", "var(--sky)", MUTED)
    dashes = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
    data = [
        {
            "type": "scatter", "mode": "lines+markers", "name": f"{row['frequency']:.4g} Hz",
            "x": rounded([0.0, *(row[f] for f in floors)]), "y": list(range(len(floors) + 1)),
            "line": {"color": colors[k % 6], "dash": dashes[k % 6]}, "marker": {"color": colors[k % 6]},
        }
        for k, (_, row) in enumerate(modes.head(6).iterrows())
    ]  # fmt: skip
    ticks = {"tickvals": list(range(len(floors) + 1)), "ticktext": ["base", *(f"DOF {f[4:]}" for f in floors)]}
    said = "; ".join(f"mode {i} at {row['frequency']:.4g} Hz" for i, row in modes.head(6).iterrows())
    return Figure(
        "Mode shapes of the linear part",
        f"Shapes of the modes, largest entry 1: {said}.",
        data,
        layout(axis("shape (largest entry 1)"), axis("", **ticks), 120 + 46 * len(floors)),
    )
