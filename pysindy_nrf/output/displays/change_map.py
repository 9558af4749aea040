"""Change of a storey's force between two tests, over drift and rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ...common.extras import require
from ._axes import axes, number


class ChangeMapDisplay:
    """Where in the (v, s) plane a storey's force changed, and where the change is significant.

    Parameters
    ----------
    table : DataFrame
        As of :meth:`pysindy_nrf.monitoring.ChangeReport.map`.
    site : str
    largest : float, optional
        Force at the ends of the colour scale, N; the largest change if None. One scale for all storeys lets them
        be compared.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.output.displays import ChangeMapDisplay
    >>> v, s = (g.ravel() for g in np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.002, 0.002, 9)))
    >>> table = pd.DataFrame({"v": v, "s": s, "change": -4e3 * s, "error": 0.5})  # 4 kN/m of stiffness lost
    >>> table["significant"], table["visited"] = abs(table["change"]) > 1.0, True
    >>> display = ChangeMapDisplay(table, "storey 2").plot()
    >>> display.ax_.get_title(loc="left")
    'storey 2'
    """

    def __init__(self, table: pd.DataFrame, site: str = "storey 1", largest: float | None = None) -> None:
        self.table = table
        self.site = site
        self.largest = largest

    @classmethod
    def from_report(cls, report: Any, site: Any, largest: float | None = None, size: int = 41) -> ChangeMapDisplay:
        """Map of one storey of a :class:`pysindy_nrf.monitoring.ChangeReport`.

        Parameters
        ----------
        report : ChangeReport
        site : str or int
        largest : float, optional
        size : int

        Returns
        -------
        ChangeMapDisplay
        """
        return cls(report.map(site, size), str(report.before.chain.site(site)), largest)

    def plot(self, ax: Any = None, colorbar: bool = True) -> ChangeMapDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional
        colorbar : bool

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        size = int(round(len(self.table) ** 0.5))
        v, s, change = (self.table[k].to_numpy().reshape(size, size) for k in ("v", "s", "change"))
        visited, significant = (self.table[k].to_numpy().reshape(size, size) for k in ("visited", "significant"))
        shown = np.where(visited, change, np.nan)
        top = self.largest or np.nanmax(np.abs(shown)) or 1.0
        image = ax.pcolormesh(1e3 * s, v, shown, cmap="PuOr", vmin=-top, vmax=top, shading="auto")
        if (visited & ~significant).any():
            patches = require("matplotlib.patches", "plot", "Drawing")
            doubt = ax.contourf(1e3 * s, v, visited & ~significant, levels=[0.5, 1.5], colors="none", hatches=["////"])
            doubt.set_edgecolor("0.6")
            doubt.set_linewidth(0.0)
            mark = patches.Patch(facecolor="none", edgecolor="0.6", hatch="////", label="not significant")
            ax.legend(handles=[mark], frameon=False, fontsize="x-small", loc="lower right", bbox_to_anchor=(1, 0.99))
        if colorbar:
            self.figure_.colorbar(image, ax=ax, label="change of force (N)")
        i = number(self.site)
        ax.set(xlabel=f"drift $s_{{{i}}}$ (mm)", ylabel=f"rate $v_{{{i}}}$ (m/s)")
        ax.set_title(self.site, loc="left")
        self.ax_ = ax
        return self
