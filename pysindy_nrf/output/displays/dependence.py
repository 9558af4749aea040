"""What a missing force depends on: shares, and the force against drift and rate."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.extras import require
from ._axes import BLACK, BLUE, SKY

_AXES = {"s": "drift s (m)", "v": "rate v (m/s)", "t": "time (s)", "amplitude": "amplitude of s (m)"}


class DependenceDisplay:
    """Shares of the dependences, and conditional means of the force.

    Parameters
    ----------
    found : pysindy_nrf.discrepancy.characterisation.Characterisation
    variables : tuple of str
        Keys of ``found.curves`` to draw.

    Attributes
    ----------
    ax_ : ndarray of Axes
    figure_ : Figure

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.discrepancy.characterisation import characterise
    >>> from pysindy_nrf.output.displays import DependenceDisplay
    >>> from pysindy_nrf.laws import Motion
    >>> t = np.arange(4000) / 500
    >>> s = np.sin(9 * t) + 0.7 * np.sin(23.1 * t)
    >>> v = 9 * np.cos(9 * t) + 0.7 * 23.1 * np.cos(23.1 * t)
    >>> display = DependenceDisplay(characterise(20 * np.sign(v), Motion(s, v, t=t))).plot()  # friction
    >>> display.found.dependence, len(display.ax_)
    ('v alone', 3)
    """

    def __init__(self, found: Any, variables: tuple[str, ...] = ("s", "v")) -> None:
        self.found, self.variables = found, variables

    def plot(self, ax: Any = None) -> DependenceDisplay:
        """Draw.

        Parameters
        ----------
        ax : sequence of Axes, optional
            One more than there are variables.

        Returns
        -------
        self
        """
        count = 1 + len(self.variables)
        if ax is None:
            plt = require("matplotlib.pyplot", "plot", "Drawing")
            _, ax = plt.subplots(1, count, figsize=(3.4 * count, 3.2), layout="constrained")
        ax = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        table = self.found.shares
        y = np.arange(len(table))
        colors = [BLUE if chosen else SKY for chosen in table["chosen"]]
        ax[0].barh(y, table["share"].clip(lower=0), color=colors, edgecolor=BLACK, linewidth=0.5, height=0.6)
        ax[0].set_yticks(y, table.index)
        ax[0].invert_yaxis()
        ax[0].set_xlim(0, 105)
        ax[0].set_xlabel("explained on data left out (%)")
        for axis, name in zip(ax[1:], self.variables):
            curve = self.found.curves[name]
            axis.errorbar(
                curve["centre"], curve["mean"], yerr=2 * curve["error"], color=BLUE, marker=".", linewidth=1, capsize=0
            )
            axis.axhline(0, color=BLACK, linewidth=0.5)
            axis.set_xlabel(_AXES.get(name, name))
            axis.set_ylabel("missing force (N)")
        self.ax_, self.figure_ = ax, ax[0].figure
        return self
