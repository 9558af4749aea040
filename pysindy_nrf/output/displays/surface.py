"""Restoring-force surface of a storey over the region it visited."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...common.extras import require
from ._axes import BLACK, axes, number


class RestoringForceSurfaceDisplay:
    """Restoring force over drift and rate, the visited region in full colour (paper Figs. 3, 6, 11, 14).

    Parameters
    ----------
    surface : DataFrame
        ``v`` (m/s), ``s`` (m), ``R`` (N), ``visited``; as of :meth:`ChainModel.surface`.
    site : str
        Name of the storey.
    reference : array-like of the same length, optional
        Another force on the same grid, N, drawn as a net: a published law, another model.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import ChainModel, laws
    >>> from pysindy_nrf.output.displays import RestoringForceSurfaceDisplay
    >>> from pysindy_nrf.regression.phase_plane_domain import VisitedRegion
    >>> t = np.linspace(0, 6.3, 500)
    >>> region = VisitedRegion.of(0.1 * np.cos(t), 0.001 * np.sin(t))
    >>> model = ChainModel([10.0], {1: laws.PowerSeries(1, [100.0, 1e5])}, visited={"storey 1": region})
    >>> display = RestoringForceSurfaceDisplay.from_estimator(model, 1)
    >>> display.surface.shape
    (1681, 4)
    """

    def __init__(self, surface: pd.DataFrame, site: str = "storey 1", reference: Any = None) -> None:
        self.surface = surface
        self.site = site
        self.reference = reference

    @classmethod
    def from_estimator(
        cls, estimator: Any, site: Any, reference: Any = None, size: int = 41
    ) -> RestoringForceSurfaceDisplay:
        """Display of a fitted regressor or model.

        Parameters
        ----------
        estimator : NRFRegressor or ChainModel
        site : str or int
        reference : callable, optional
            (v, s) -> N, e.g. the restoring force of another model.
        size : int
            Points along each side.

        Returns
        -------
        RestoringForceSurfaceDisplay
        """
        model = getattr(estimator, "model_", estimator)
        surface = model.surface(site, size)
        other = None if reference is None else reference(surface["v"].to_numpy(), surface["s"].to_numpy())
        return cls(surface, str(model.chain.site(site)), other)

    def plot(self, ax: Any = None, reference_label: str = "paper") -> RestoringForceSurfaceDisplay:
        """Draw.

        Parameters
        ----------
        ax : 3-D Axes, optional
        reference_label : str

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax, (4.8, 4.0), "3d")
        ticker = require("matplotlib.ticker", "plot", "Drawing")
        size = int(round(len(self.surface) ** 0.5))
        v, s, R = (self.surface[k].to_numpy().reshape(size, size) for k in ("v", "s", "R"))
        visited = self.surface["visited"].to_numpy().reshape(size, size)
        force = np.where(visited, R, np.nan)
        ax.plot_surface(
            1e3 * s, v, force, cmap="cividis", rstride=1, cstride=1, linewidth=0, antialiased=True, alpha=0.95
        )
        handles = [("identified, where visited", "#7b7b78"), ("not visited", "0.75")]
        low, high = np.nanmin(force), np.nanmax(force)
        room = 0.15 * (high - low)
        if self.reference is not None:
            other = np.asarray(self.reference, dtype=float).reshape(size, size)
            inside = visited & (other > low - room) & (other < high + room)
            ax.plot_wireframe(
                1e3 * s, v, np.where(inside, other, np.nan), color=BLACK, linewidth=0.6, rstride=3, cstride=3
            )
            handles.append((reference_label, BLACK))
        beyond = np.where((R > low - room) & (R < high + room), R, np.nan)
        ax.plot_wireframe(1e3 * s, v, beyond, color="0.75", linewidth=0.3, rstride=4, cstride=4)
        i = number(self.site)
        ax.set_xlabel(f"drift $s_{{{i}}}$ (mm)")
        ax.set_ylabel(f"rate $v_{{{i}}}$ (m/s)")
        ax.set_zlabel(f"force $R_{{{i}}}$ (N)")
        ax.set_title(f"{self.site}")
        lines = [ax.plot([], [], [], color=c, linewidth=3, label=text)[0] for text, c in handles]
        ax.legend(handles=lines, loc="upper left", fontsize="x-small", frameon=False)
        ax.set_zlim(low - room, high + room)
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_major_locator(ticker.MaxNLocator(5))
        ax.tick_params(labelsize="small", pad=1)
        ax.tick_params(axis="z", pad=4)
        ax.zaxis.labelpad = 11
        ax.view_init(elev=24, azim=-125)
        ax.set_box_aspect(None, zoom=0.8)
        self.ax_ = ax
        return self
