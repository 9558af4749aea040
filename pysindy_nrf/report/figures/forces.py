"""Figures of restoring forces: surfaces, loops, the energy dissipated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ...chain.model import ChainModel
from ...chain.sites import Site, index_of
from ...common.unit_system import TRANSLATION, UnitSystem
from ...diagnosis.site_loops import SiteLoop
from ...drawing.figure import (
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
from ...exceptions import NRFError

_TURN = "Drag to turn, or use the arrow keys."
# Points along each side of a surface on the page, and the share by which it goes beyond
# the data.
GRID_SIZE, GRID_MARGIN = 29, 0.08
# Share of the range of the force where the data were, by which what lies beyond them
# may exceed it; the rest is cut off.
HEADROOM = 0.15
# Rows and columns of the table of a surface.
N_TABLE = 7


# -- in space ------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Grid:
    """A force over a square grid of rates (along columns) and drifts (along rows)."""

    v: np.ndarray
    s: np.ndarray
    force: np.ndarray
    visited: np.ndarray
    units: UnitSystem = TRANSLATION

    @classmethod
    def of_table(cls, surface: pd.DataFrame, units: UnitSystem) -> _Grid:
        """The grid of a table with columns v, s, R and visited."""
        size = int(round(len(surface) ** 0.5))
        v, s, force, visited = (
            surface[name].to_numpy().reshape(size, size)
            for name in ("v", "s", "R", "visited")
        )
        return cls(v, s, force, visited, units)

    @property
    def where_visited(self) -> np.ndarray:
        """The force where the data were; everywhere if they were nowhere."""
        return self.force[self.visited] if self.visited.any() else self.force

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the force that is drawn."""
        inside = self.where_visited
        spare = HEADROOM * float(np.ptp(inside)) or 1.0
        return float(inside.min()) - spare, float(inside.max()) + spare

    def cut(self, force: np.ndarray) -> np.ndarray:
        """A force on this grid; NaN beyond the range that is drawn."""
        low, high = self.limits
        return np.where((force > low) & (force < high), force, np.nan)


def surface_figure(
    grid: pd.DataFrame,
    site: Site | str,
    reference: ArrayLike | None = None,
    name: str = "paper",
    loop: SiteLoop | None = None,
    units: UnitSystem = TRANSLATION,
) -> Figure:
    """Restoring force over drift and rate.

    Parameters
    ----------
    grid : DataFrame
        As returned by :meth:`ChainModel.surface`.
    site : str or Site
    reference : array-like, optional
        Another force on the same grid, drawn as a net.
    name : str
        Name of the reference.
    loop : SiteLoop, optional
        The path of the data.
    units : UnitSystem
        Of the model.
    """
    shown = _Grid.of_table(grid, units)
    where_visited = np.where(shown.visited, shown.force, np.nan)
    beyond = shown.cut(shown.force)
    marks: list[Mark] = [
        Surface(shown.s, shown.v, where_visited, "identified, where visited"),
        Surface(shown.s, shown.v, beyond, "not visited", "faint"),
    ]
    if reference is not None:
        other = shown.cut(np.reshape(reference, shown.force.shape))
        other = np.where(shown.visited, other, np.nan)
        marks.append(Surface(shown.s, shown.v, other, name, "net"))
    if loop is not None:
        marks.append(_path(loop, "ink", 1.5))

    x, y, z = _axes_in_space(site, units, shown.limits)
    return Figure(
        f"Restoring-force surface of {site}",
        marks,
        x,
        y,
        z,
        alt=_alt_of_surface(site, shown),
        caption=(
            "Coloured where the data were, grey where the law is extrapolated; the line"
            f" is the path of the data. {_TURN}"
        ),
        table=_table_of_surface(site, shown),
        heading=str(site),
        size=(4.8, 4.0),
        height=380,
    )


def _alt_of_surface(site: Site | str, grid: _Grid) -> str:
    """The ranges of force, drift and rate."""
    force, units = grid.where_visited, grid.units
    s, v = grid.s, grid.v
    return (
        f"Restoring force of {site} over drift and rate. It reaches from"
        f" {_span(force, units)} for drifts of {s.min():.3g} to {s.max():.3g}"
        f" {units.length} and rates of {v.min():.3g} to {v.max():.3g}"
        f" {units.of('m/s')}."
    )


def _table_of_surface(site: Site | str, grid: _Grid) -> Table:
    """The force at some rates and drifts; empty where the data never were."""
    picked = np.linspace(0, len(grid.force) - 1, N_TABLE).astype(int)
    units = grid.units
    head = [f"v ({units.of('m/s')})"]
    for j in picked:
        head.append(f"s = {grid.s[0, j]:.3g} {units.length}")

    rows = []
    for i in picked:
        row: list[float | str] = [float(f"{grid.v[i, 0]:.3g}")]
        for j in picked:
            row.append(float(grid.force[i, j]) if grid.visited[i, j] else "")
        rows.append(row)
    caption = (
        f"Force of {site} ({units.force}) by rate and drift; empty where the data never"
        " were"
    )
    return Table(caption, head, rows)


def force_figure(
    model: ChainModel, site: Site, loop: SiteLoop | None = None
) -> Figure | None:
    """The force of a site: its surface, or its path along the data.

    None where it is no surface and there are no data.
    """
    is_surface = not model.restoring_forces[site].has_memory
    why = "The force depends on the path, so it has no surface"
    if is_surface and site in model.visited:
        try:
            grid = model.surface(site, GRID_SIZE, margin=GRID_MARGIN)
            return surface_figure(grid, site, loop=loop, units=model.units)
        except NRFError:  # a law that needs time or a covariate is no surface
            is_surface = False
    if loop is None:
        return None

    if is_surface:
        why = "The visited region is not known"
    x, y, z = _axes_in_space(site, model.units)
    return Figure(
        f"Force of {site} along its path",
        [_path(loop, "blue", 3)],
        x,
        y,
        z,
        alt=(
            f"Path of the identified force of {site} over drift and rate, from"
            f" {_span(loop.identified, loop.units)}."
        ),
        caption=f"{why}: the identified force along the data. {_TURN}",
        table=_table_of_loop(loop),
        height=380,
    )


def _path(loop: SiteLoop, color: str, width: float) -> Line:
    return Line(loop.s, loop.v, "path of the data", color, width, z=loop.identified)


def _axes_in_space(
    site: Site | str,
    units: UnitSystem,
    limits: tuple[float, float] | None = None,
) -> tuple[Axis, Axis, Axis]:
    """Axes of drift, rate and force."""
    index = index_of(site)
    return (
        Axis(f"drift s_{{{index}}}", units.length),
        Axis(f"rate v_{{{index}}}", units.of("m/s")),
        Axis(f"force R_{{{index}}}", units.force, limits),
    )


# -- in the plane --------------------------------------------------------------


def loop_figures(model: ChainModel, loops: Sequence[SiteLoop]) -> list[Figure]:
    """Every loop and, where its site has a spring, the same without it."""
    stiffness = {}
    for site, force in model.restoring_forces.items():
        stiffness[str(site)] = float(force.linear_part()["k"])

    figures = []
    for loop in loops:
        figures.append(loop_figure(loop))
        if stiffness[loop.site]:
            figures.append(loop_figure(loop, stiffness[loop.site]))
    return figures


def loop_figure(loop: SiteLoop, stiffness: float = 0.0) -> Figure:
    """Force over drift, identified over measured.

    Parameters
    ----------
    loop : SiteLoop
    stiffness : float
        Of a linear spring that is taken off both forces, N/m.
    """
    spring = stiffness * loop.s
    identified = loop.identified - spring
    marks: list[Mark] = [Line(loop.s, identified, "identified", "blue", 1.0)]
    difference = ""
    if loop.measured is not None:
        measured = loop.measured - spring
        marks.insert(0, Line(loop.s, measured, "measured", "orange", 3.4))
        size = f"{rms(measured - identified):.3g} {loop.units.force}"
        difference = f", rms difference {size}"

    index = index_of(loop.site)
    title = f"Hysteresis loops of {loop.site}"
    force, name = f"force R_{{{index}}}", loop.site
    if stiffness:
        title = f"Loops of {loop.site} without its spring"
        force = f"force R_{{{index}}} − k s_{{{index}}}"
        name = f"{loop.site} without its linear spring"
    return Figure(
        title,
        marks,
        Axis(f"drift s_{{{index}}}", loop.units.length),
        Axis(force, loop.units.force),
        alt=(
            f"Force of {name} over its drift, identified over measured:"
            f" {_span(identified, loop.units)}{difference}."
        ),
        caption=_caption_of_loop(loop, stiffness),
        heading=name,
        height=380,
        table=_table_of_loop(loop, spring) if loop.t.size else None,
    )


def _caption_of_loop(loop: SiteLoop, stiffness: float) -> str:
    """What the two lines of a loop are."""
    if stiffness:
        k = f"{stiffness / 1e3:.4g} {loop.units.of('kN/m')}"
        return (
            f"The same without its linear spring, k = {k}: what is left is damping,"
            " friction, memory and curvature."
        )
    caption = "Nothing else measures it."
    if loop.measured is not None:
        caption = "Measured: the force that the measured motion asks for."
    if loop.record not in ("", "0"):  # "0" is the name of data without records
        caption += f" Around the largest motion of {loop.record}."
    return caption


def _table_of_loop(loop: SiteLoop, spring: np.ndarray | float = 0.0) -> Table:
    """Size and work of the forces in the stretch drawn."""
    forces = {"identified": loop.identified - spring}
    if loop.measured is not None:
        forces["measured"] = loop.measured - spring
        forces["difference"] = loop.measured - loop.identified

    rows = []
    for name, force in forces.items():
        work = float(np.trapezoid(force * loop.v, loop.t))
        rows.append([name, rms(force), float(np.abs(force).max()), work])
    unit = loop.units.force
    head = ["force", f"rms ({unit})", f"peak ({unit})", "energy taken out (J)"]
    return Table(f"Forces of {loop.site} in the stretch drawn", head, rows)


def _span(force: np.ndarray, units: UnitSystem) -> str:
    return f"{force.min():.3g} to {force.max():.3g} {units.force}"


def energy_figure(energy: pd.DataFrame) -> Figure:
    """Energy dissipated over time (J by s), one line a column."""
    marks = []
    for k, (name, line) in enumerate(energy.items()):
        color, dash = CYCLE[k % len(CYCLE)], DASHES[k % len(DASHES)]
        marks.append(Line(energy.index, line, str(name), color, 1.5, dash))
    x, y = Axis("time", "s"), Axis("dissipated energy", "J")
    return Figure("Dissipated energy", marks, x, y)
