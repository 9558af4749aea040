"""Forces and responses of a record."""

from __future__ import annotations

from typing import Any

import numpy as np

from ._axes import BLUE, RED, stacked, thin

_KINDS = {
    "force": ("F", "N", 1.0),
    "acceleration": ("a", "m/s$^2$", 1.0),
    "velocity": ("v", "m/s", 1.0),
    "displacement": ("x", "mm", 1e3),
}


class RecordDisplay:
    """Measured channels of one kind over time, one line of axes for each DOF (paper Figs. 2, 10).

    Parameters
    ----------
    record : Record
    kind : {"force", "acceleration", "velocity", "displacement"}

    Attributes
    ----------
    ax_ : ndarray of Axes
        One for each DOF, the uppermost floor on top.
    figure_ : Figure

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.output.displays import RecordDisplay
    >>> display = RecordDisplay(datasets.load_demo(), "displacement").plot()
    >>> display.ax_[-1].get_xlabel(), [axis.get_ylabel() for axis in display.ax_]
    ('time (s)', ['$x_{3}$ (mm)', '$x_{2}$ (mm)', '$x_{1}$ (mm)'])
    """

    def __init__(self, record: Any, kind: str = "acceleration") -> None:
        self.record = record
        self.kind = kind

    def plot(self, ax: Any = None) -> RecordDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes or array of Axes, optional

        Returns
        -------
        self
        """
        n = self.record.n_dof
        symbol, unit, factor = _KINDS[self.kind]
        values = getattr(self.record, self.kind)
        ax, self.figure_ = stacked(ax, n, (6.5, 1.2 * n + 0.6))
        for axis, j in zip(ax, range(n - 1, -1, -1)):
            if values is None or np.isnan(values[:, j]).all():
                axis.text(0.5, 0.5, "not measured", transform=axis.transAxes, ha="center", va="center", color="0.4")
            else:
                t, y = thin(self.record.time, factor * values[:, j])
                axis.plot(t, y, color=RED if symbol == "F" else BLUE, linewidth=0.7)
            axis.set_ylabel(f"${symbol}_{{{j + 1}}}$ ({unit})")
        ax[-1].set_xlabel("time (s)")
        self.ax_ = ax
        return self
