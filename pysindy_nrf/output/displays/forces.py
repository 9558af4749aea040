"""Figures of restoring forces: surfaces, loops, the energy dissipated."""

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import pandas as pd

from ...discrepancy.residual import SiteLoop
from ...estimation import dissipated_energy
from ...exceptions import ChannelError, NRFError
from ...mechanics.sites import Site
from ...regression.chain_model import as_model, as_segments
from ._figure import CYCLE, DASHES, Axis, Figure, Line, Mark, Surface, Table, index_of, rms
from ._matplotlib import Display

_TURN = "Drag to turn, or use the arrow keys."


def surface_figure(
    grid: pd.DataFrame, site: Any, reference: Any = None, name: str = "paper", loop: SiteLoop | None = None
) -> Figure:
    """Restoring force over drift and rate; a reference is a net, the path of the data a line."""
    size = int(round(len(grid) ** 0.5))
    v, s, R = (grid[k].to_numpy().reshape(size, size) for k in ("v", "s", "R"))
    visited = grid["visited"].to_numpy().reshape(size, size)
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
        marks.append(Surface(s, v, kept(np.reshape(reference, (size, size)), visited), name, "net"))
    if loop is not None:
        marks.append(_path_line(loop, "ink", 1.5))
    pick = np.linspace(0, size - 1, 7).astype(int)
    rows = [[float(f"{v[i, 0]:.3g}"), *(float(R[i, j]) if visited[i, j] else "" for j in pick)] for i in pick]
    head = ["v (m/s)", *(f"s = {s[0, j]:.3g} m" for j in pick)]
    return Figure(
        f"Restoring-force surface of {site}", marks, *_space(site, (low, high)),
        alt=f"Restoring force of {site} over drift and rate. It reaches from {inside.min():.3g} to {inside.max():.3g} "
        f"N for drifts of {s.min():.3g} to {s.max():.3g} m and rates of {v.min():.3g} to {v.max():.3g} m/s.",
        caption="Coloured where the data were, grey where the law is extrapolated; the line is the path of the data. "
        + _TURN,
        heading=str(site),
        table=Table(f"Force of {site} (N) by rate and drift; empty where the data never were", head, rows),
        size=(4.8, 4.0), height=380,
    )  # fmt: skip


def force_figure(model: Any, site: Site, loop: SiteLoop | None = None) -> Figure | None:
    """Surface of a site's force or, where it is none, the path of the force along the data; None without data."""
    memory = model.restoring_forces[site].has_memory
    if not memory and site in model.visited:
        try:
            return surface_figure(model.surface(site, 33, margin=0.08), site, loop=loop)
        except NRFError:  # a law that needs time or a covariate is no surface
            memory = True
    if loop is None:
        return None
    why = "The force depends on the path, so it is no surface" if memory else "The visited region is not known"
    return Figure(
        f"Force of {site} along its path", [_path_line(loop, "blue", 3)], *_space(site),
        alt=f"Path of the identified force of {site} over drift and rate, from {_span(loop.identified)}.",
        caption=f"{why}: the identified force along the data. {_TURN}", table=_loop_table(loop), height=380,
    )  # fmt: skip


def _path_line(loop: SiteLoop, color: str, width: float) -> Line:
    return Line(loop.s, loop.v, "path of the data", color, width, z=loop.identified)


def _space(site: Any, limits: tuple[float, float] | None = None) -> tuple[Axis, Axis, Axis]:
    """Axes of drift, rate and force."""
    i = index_of(site)
    return Axis(f"drift s_{{{i}}}", "m"), Axis(f"rate v_{{{i}}}", "m/s"), Axis(f"force R_{{{i}}}", "N", limits)


def loop_figure(loop: SiteLoop, stiffness: float = 0.0) -> Figure:
    """Force over drift, identified over measured; without the spring of ``stiffness`` (N/m), if that is given."""
    spring = stiffness * loop.s
    found = loop.identified - spring
    measured = None if loop.measured is None else loop.measured - spring
    marks: list[Mark] = [Line(loop.s, found, "identified", "blue", 1.0)]
    gap, how = "", "Nothing else measures it."
    if measured is not None:
        marks.insert(0, Line(loop.s, measured, "measured", "orange", 1.8, opacity=0.85))
        gap = f", rms difference {rms(measured - found):.3g} N"
        how = "Measured is what the balances above ask for."
    if loop.record not in ("", "0"):
        how += f" Around the largest motion of {loop.record}."
    if stiffness:
        how = f"The same without its linear spring, k = {stiffness / 1e3:.4g} kN/m: what is left is damping, friction, "
        how += "memory and curvature."
    i, without = index_of(loop.site), " without its linear spring" if stiffness else ""
    return Figure(
        f"Loops of {loop.site} without its spring" if stiffness else f"Hysteresis loops of {loop.site}", marks,
        Axis(f"drift s_{{{i}}}", "m"), Axis(f"force R_{{{i}}} − k s_{{{i}}}" if stiffness else f"force R_{{{i}}}", "N"),
        alt=f"Force of {loop.site}{without} over its drift, identified over measured: {_span(found)}{gap}.",
        caption=how, heading=loop.site, table=_loop_table(loop, spring) if loop.t.size else None, height=380,
    )  # fmt: skip


def _loop_table(loop: SiteLoop, spring: Any = 0.0) -> Table:
    """Size and work of the forces in the stretch drawn."""
    forces = {"identified": loop.identified - spring}
    if loop.measured is not None:
        forces |= {"measured": loop.measured - spring, "difference": loop.measured - loop.identified}
    sizes = ((n, rms(R), np.abs(R).max(), np.trapezoid(R * loop.v, loop.t)) for n, R in forces.items())
    rows = [[name, *map(float, of)] for name, *of in sizes]
    head = ["force", "rms (N)", "peak (N)", "energy taken out (J)"]
    return Table(f"Forces of {loop.site} in the stretch drawn", head, rows)


def _span(x: np.ndarray) -> str:
    return f"{x.min():.3g} to {x.max():.3g} N"


class RestoringForceSurfaceDisplay(Display):
    """Restoring force over drift and rate, the visited region in full colour (paper Figs. 3, 6, 11, 14).

    Parameters
    ----------
    surface : DataFrame
        ``v`` (m/s), ``s`` (m), ``R`` (N), ``visited``; as of :meth:`ChainModel.surface`.
    site : str
    reference : array-like of the same length, optional
        Another force on the same grid, N, drawn as a net: a published law, another model.
    reference_label : str

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets, displays
    >>> model = NRFRegressor().fit(datasets.load_demo())
    >>> displays.RestoringForceSurfaceDisplay.from_estimator(model, 1).surface.shape
    (1681, 4)
    """

    def __init__(
        self, surface: pd.DataFrame, site: str = "storey 1", reference: Any = None, reference_label: str = "paper"
    ) -> None:
        self.surface, self.site, self.reference, self.reference_label = surface, site, reference, reference_label

    @classmethod
    def from_estimator(cls, estimator: Any, site: Any, reference: Any = None, size: int = 41) -> Self:
        """Display of a fitted regressor or model.

        Parameters
        ----------
        estimator : NRFRegressor or ChainModel
        site : str or int
        reference : callable, optional
            (v, s) -> N, e.g. the restoring force of another model.
        size : int
            Points along each side.
        """
        model = getattr(estimator, "model_", estimator)
        surface = model.surface(site, size)
        other = None if reference is None else reference(surface["v"].to_numpy(), surface["s"].to_numpy())
        return cls(surface, str(model.chain.site(site)), other)

    def figures(self) -> list[Figure]:
        return [surface_figure(self.surface, self.site, self.reference, self.reference_label)]


class HysteresisLoopDisplay(Display):
    """Loops of the restoring force over the drift, identified over measured.

    Parameters
    ----------
    drift, identified, measured : ndarray of shape (n_samples,)
        m, N, and N if known: the force that balances the inertia above the storey.
    site : str

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import HysteresisLoopDisplay
    >>> t = np.linspace(0, 6.3, 500)
    >>> force = 30.0 * np.sin(t) + 10.0 * np.sign(np.cos(t))  # spring and friction
    >>> HysteresisLoopDisplay(0.001 * np.sin(t), force, site="storey 2").plot().ax_.get_ylabel()
    'force $R_{2}$ (N)'
    """

    def __init__(self, drift: Any, identified: Any, measured: Any = None, site: str = "storey 1") -> None:
        self.drift, self.identified = np.asarray(drift, dtype=float), np.asarray(identified, dtype=float)
        self.measured = None if measured is None else np.asarray(measured, dtype=float)
        self.site = site

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, F: Any, site: Any, **options: Any) -> Self:
        """Loops of a storey; "measured" is the force that balances the inertia above it with the identified masses.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        X, F, **options
            Data, as for ``fit``.
        site : str or int
            A storey.

        Raises
        ------
        ChannelError
            If the site is no storey, or the chain has further links, whose share of the balance is not known.
        """
        model = as_model(estimator)
        place = model.chain.site(site)
        if not place.is_storey or any(model.laws[s] for s in model.laws if not s.is_storey):
            cure = "Pass drift and forces yourself."
            raise ChannelError(f"The force of {place} cannot be read off the balances above it", cure)
        i = place.p - 1
        data = as_segments(estimator, X, F, **options)
        drift = data.scatter([seg.s[seg.valid] for seg in data.segments])[:, i]
        above = data.scatter([seg.F[seg.valid] - model.masses * seg.a[seg.valid] for seg in data.segments])
        return cls(drift, model.restoring_force(data)[:, i], above[:, i:].sum(axis=1), str(place))

    def figures(self) -> list[Figure]:
        none = np.empty(0)
        return [loop_figure(SiteLoop(self.site, "", none, self.drift, none, self.identified, self.measured))]


class EnergyDisplay(Display):
    """Dissipated energy over time (paper Figs. 13, 16).

    Parameters
    ----------
    time : ndarray of shape (n_samples,)
        s.
    energy : mapping of str to ndarray of shape (n_samples,)
        J, by the name that stands in the legend.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.output.displays import EnergyDisplay
    >>> t = np.linspace(0, 10, 500)
    >>> EnergyDisplay(t, {"identified": 2.0 * t, "true": 2.1 * t}).plot().ax_.get_ylabel()
    'dissipated energy (J)'
    """

    def __init__(self, time: Any, energy: Mapping[str, Any]) -> None:
        self.time = np.asarray(time, dtype=float)
        self.energy = {name: np.asarray(line, dtype=float) for name, line in energy.items()}

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, without: Any = None, **options: Any) -> Self:
        """Energy dissipated in every storey; parameters as of :func:`pysindy_nrf.estimation.dissipated_energy`.

        Parameters
        ----------
        estimator : fitted NRFRegressor or ChainModel
        """
        table = dissipated_energy(estimator, X, without, **options)
        return cls(table.index.to_numpy(dtype=float), {name: table[name].to_numpy() for name in table})

    def figures(self) -> list[Figure]:
        marks: list[Mark] = [
            Line(self.time, line, name, CYCLE[k % 6], 1.5, DASHES[k % 6])
            for k, (name, line) in enumerate(self.energy.items())
        ]
        return [Figure("Dissipated energy", marks, Axis("time", "s"), Axis("dissipated energy", "J"))]
