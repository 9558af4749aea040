"""Figures of restoring forces: surfaces, loops, the energy dissipated."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...chain.sites import Site, index_of
from ...discrepancy.residual import SiteLoop
from ...exceptions import NRFError
from .figure import (
    CYCLE,
    DASHES,
    Axis,
    Figure,
    Line,
    Mark,
    Surface,
    Table,
    rms,
)

_TURN = "Drag to turn, or use the arrow keys."


def surface_figure(
    grid: pd.DataFrame,
    site: Any,
    reference: Any = None,
    name: str = "paper",
    loop: SiteLoop | None = None,
) -> Figure:
    """Restoring force over drift and rate; a reference is a net, the path of the data a
    line.
    """
    size = int(round(len(grid) ** 0.5))
    v, s, R, visited = (
        grid[k].to_numpy().reshape(size, size) for k in ("v", "s", "R", "visited")
    )
    inside = R[visited] if visited.any() else R
    spare = 0.15 * float(np.ptp(inside)) or 1.0
    low, high = float(inside.min()) - spare, float(inside.max()) + spare

    def kept(force: np.ndarray, where: Any = True) -> np.ndarray:
        return np.where(where & (force > low) & (force < high), force, np.nan)

    marks: list[Mark] = [
        Surface(s, v, np.where(visited, R, np.nan), "identified, where visited"),
        Surface(s, v, kept(R), "not visited", "faint"),
    ]
    if reference is not None:
        marks.append(
            Surface(
                s, v, kept(np.reshape(reference, (size, size)), visited), name, "net"
            )
        )
    if loop is not None:
        marks.append(_path_line(loop, "ink", 1.5))
    pick = np.linspace(0, size - 1, 7).astype(int)
    rows = [
        [
            float(f"{v[i, 0]:.3g}"),
            *(float(R[i, j]) if visited[i, j] else "" for j in pick),
        ]
        for i in pick
    ]
    head = ["v (m/s)", *(f"s = {s[0, j]:.3g} m" for j in pick)]
    return Figure(
        f"Restoring-force surface of {site}",
        marks,
        *_space(site, (low, high)),
        alt=(
            f"Restoring force of {site} over drift and rate. It reaches from"
            f" {inside.min():.3g} to {inside.max():.3g} N for drifts of {s.min():.3g}"
            f" to {s.max():.3g} m and rates of {v.min():.3g} to {v.max():.3g} m/s."
        ),
        caption=(
            "Coloured where the data were, grey where the law is extrapolated; the line"
            " is the path of the data. "
        )
        + _TURN,
        table=Table(
            f"Force of {site} (N) by rate and drift; empty where the data never were",
            head,
            rows,
        ),
        heading=str(site),
        size=(4.8, 4.0),
        height=380,
    )


def force_figure(model: Any, site: Site, loop: SiteLoop | None = None) -> Figure | None:
    """Surface of a site's force or, where it is none, the path of the force along the
    data; None without data.
    """
    memory = model.restoring_forces[site].has_memory
    if not memory and site in model.visited:
        try:
            return surface_figure(model.surface(site, 29, margin=0.08), site, loop=loop)
        except NRFError:  # a law that needs time or a covariate is no surface
            memory = True
    if loop is None:
        return None
    why = (
        "The force depends on the path, so it is no surface"
        if memory
        else "The visited region is not known"
    )
    return Figure(
        f"Force of {site} along its path",
        [_path_line(loop, "blue", 3)],
        *_space(site),
        alt=(
            f"Path of the identified force of {site} over drift and rate, from"
            f" {_span(loop.identified)}."
        ),
        caption=f"{why}: the identified force along the data. {_TURN}",
        table=_loop_table(loop),
        height=380,
    )


def _path_line(loop: SiteLoop, color: str, width: float) -> Line:
    return Line(loop.s, loop.v, "path of the data", color, width, z=loop.identified)


def _space(
    site: Any, limits: tuple[float, float] | None = None
) -> tuple[Axis, Axis, Axis]:
    """Axes of drift, rate and force."""
    i = index_of(site)
    return (
        Axis(f"drift s_{{{i}}}", "m"),
        Axis(f"rate v_{{{i}}}", "m/s"),
        Axis(f"force R_{{{i}}}", "N", limits),
    )


def loop_figures(model: Any, loops: Sequence[SiteLoop]) -> list[Figure]:
    """Every loop and, where its site has a spring, the same without it."""
    springs = {
        str(site): float(force.linear_part()["k"])
        for site, force in model.restoring_forces.items()
    }
    return [
        loop_figure(loop, k)
        for loop in loops
        for k in dict.fromkeys((0.0, springs[loop.site]))
    ]


def loop_figure(loop: SiteLoop, stiffness: float = 0.0) -> Figure:
    """Force over drift, identified over measured; without the spring of ``stiffness``
    (N/m), if that is given.
    """
    spring = stiffness * loop.s
    found = loop.identified - spring
    measured = None if loop.measured is None else loop.measured - spring
    marks: list[Mark] = [Line(loop.s, found, "identified", "blue", 1.0)]
    gap, how = "", "Nothing else measures it."
    if measured is not None:
        marks.insert(0, Line(loop.s, measured, "measured", "orange", 3.4))
        gap = f", rms difference {rms(measured - found):.3g} N"
        how = "Measured: the force that the measured motion asks for."
    if loop.record not in ("", "0"):
        how += f" Around the largest motion of {loop.record}."
    if stiffness:
        how = (
            f"The same without its linear spring, k = {stiffness / 1e3:.4g} kN/m: what"
            " is left is damping, friction, "
        )
        how += "memory and curvature."
    i, without = index_of(loop.site), " without its linear spring" if stiffness else ""
    return Figure(
        (
            f"Loops of {loop.site} without its spring"
            if stiffness
            else f"Hysteresis loops of {loop.site}"
        ),
        marks,
        Axis(f"drift s_{{{i}}}", "m"),
        Axis(
            f"force R_{{{i}}} − k s_{{{i}}}" if stiffness else f"force R_{{{i}}}", "N"
        ),
        alt=(
            f"Force of {loop.site}{without} over its drift, identified over measured:"
            f" {_span(found)}{gap}."
        ),
        caption=how,
        heading=f"{loop.site}{without}",
        height=380,
        table=_loop_table(loop, spring) if loop.t.size else None,
    )


def _loop_table(loop: SiteLoop, spring: Any = 0.0) -> Table:
    """Size and work of the forces in the stretch drawn."""
    forces = {"identified": loop.identified - spring}
    if loop.measured is not None:
        forces |= {
            "measured": loop.measured - spring,
            "difference": loop.measured - loop.identified,
        }
    rows = [
        [n, rms(R), float(np.abs(R).max()), float(np.trapezoid(R * loop.v, loop.t))]
        for n, R in forces.items()
    ]
    head = ["force", "rms (N)", "peak (N)", "energy taken out (J)"]
    return Table(f"Forces of {loop.site} in the stretch drawn", head, rows)


def _span(x: np.ndarray) -> str:
    return f"{x.min():.3g} to {x.max():.3g} N"


def energy_figure(energy: pd.DataFrame) -> Figure:
    """Energy dissipated over time (J by s), one line a column."""
    marks: list[Mark] = [
        Line(energy.index, line, str(name), CYCLE[k % 6], 1.5, DASHES[k % 6])
        for k, (name, line) in enumerate(energy.items())
    ]
    return Figure(
        "Dissipated energy", marks, Axis("time", "s"), Axis("dissipated energy", "J")
    )
