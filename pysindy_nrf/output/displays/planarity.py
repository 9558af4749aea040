"""Planarity index of every storey beside its noise reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ._axes import BLACK, BLUE, SKY, axes


class PlanarityDisplay:
    """How far every storey's surface is from a plane, and how far noise alone would bend it.

    Parameters
    ----------
    table : DataFrame
        As of :func:`pysindy_nrf.estimation.planarity`.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.output.displays import PlanarityDisplay
    >>> table = pd.DataFrame({"index": [21.0, 0.9], "reference": [2.1, 2.0], "planar": [False, True]})
    >>> table.index = ["storey 1", "storey 2"]
    >>> [label.get_text() for label in PlanarityDisplay(table).plot().ax_.get_yticklabels()]
    ['storey 1', 'storey 2']
    """

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table

    @classmethod
    def from_estimator(cls, estimator: Any, X: Any, F: Any = None, **options: Any) -> PlanarityDisplay:
        """Planarity of a fitted regressor; see :func:`pysindy_nrf.estimation.planarity`.

        Parameters
        ----------
        estimator : fitted NRFRegressor
        X, F, **options

        Returns
        -------
        PlanarityDisplay
        """
        from ...estimation import nonlinearity_location as planarity

        return cls(planarity(estimator, X, F, **options))

    def plot(self, ax: Any = None) -> PlanarityDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        from ...estimation.nonlinearity_location import LEAST

        ax, self.figure_ = axes(ax)
        y = np.arange(len(self.table))
        colors = [SKY if planar else BLUE for planar in self.table["planar"]]
        ax.barh(y, self.table["index"], color=colors, height=0.6, edgecolor=BLACK, linewidth=0.5)
        reference = np.fmax(self.table["reference"].to_numpy(), LEAST)
        ax.plot(
            reference,
            y,
            linestyle="",
            marker="|",
            markersize=16,
            markeredgewidth=2,
            color=BLACK,
            label="reference (noise, at least 1 %)",
        )
        for k, planar in enumerate(self.table["planar"]):
            ax.annotate(
                "planar" if planar else "not planar",
                (max(self.table["index"].iloc[k], reference[k]), k),
                (6, 0),
                textcoords="offset points",
                va="center",
                fontsize="small",
            )
        ax.set(yticks=y, yticklabels=self.table.index, xlabel="off the plane (% of the storey's force)")
        ax.set_xlim(0, 1.35 * max(self.table["index"].max(), reference.max()))
        ax.set_ylim(-0.6, len(y) - 0.1)
        ax.legend(frameon=False, fontsize="x-small", loc="upper right")
        self.ax_ = ax
        return self
