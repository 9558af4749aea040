"""Stiffness of every storey over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ._axes import BLACK, CYCLE, STYLES, axes


class TrackDisplay:
    """Stiffness of every storey over time, as a change from its first window.

    Parameters
    ----------
    table : DataFrame
        As of :func:`pysindy_nrf.monitoring.track`, of one record.
    onset : float, optional
        Time of a change, s; marked.
    window : float, optional
        Length of the windows, s; shown.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.output.displays import TrackDisplay
    >>> t = np.arange(1.0, 9.0, 0.25)
    >>> table = pd.DataFrame({"record": "quake", "t": t, "k1": np.where(t < 5, 4e4, 3.2e4), "k2": 3e4})
    >>> display = TrackDisplay(table, onset=5.0).plot()
    >>> display.ax_.get_ylabel()
    'change of stiffness (%)'
    """

    def __init__(self, table: pd.DataFrame, onset: float | None = None, window: float | None = None) -> None:
        self.table = table
        self.onset = onset
        self.window = window

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, F: Any = None, onset: float | None = None, **options: Any
    ) -> TrackDisplay:
        """Moving-window identification; see :func:`pysindy_nrf.monitoring.track`.

        Parameters
        ----------
        estimator : fitted NRFRegressor
        X, F, **options
        onset : float, optional
            s.

        Returns
        -------
        TrackDisplay
        """
        from ...monitoring import track

        return cls(track(estimator, X, F, **options), onset, options.get("window", 2.0))

    def plot(self, ax: Any = None) -> TrackDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax, (6.0, 3.2))
        columns = [c for c in self.table if str(c).startswith("k")]
        for i, name in enumerate(columns):
            k = self.table[name].to_numpy()
            ax.plot(
                self.table["t"],
                100 * (k / k[0] - 1),
                color=CYCLE[i % len(CYCLE)],
                linestyle=STYLES[i % len(STYLES)],
                label=f"storey {name[1:]}",
            )
        if self.onset is not None and np.isfinite(self.onset):
            ax.axvline(self.onset, color=BLACK, linewidth=0.8, linestyle=":")
            ax.annotate(
                f"onset {self.onset:.2f} s",
                (self.onset, 1),
                (4, -4),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="top",
                fontsize="small",
            )
        window = "window" if self.window is None else f"{self.window:g} s window"
        ax.set(xlabel=f"time at the middle of the {window} (s)", ylabel="change of stiffness (%)")
        ax.legend(frameon=False, fontsize="small", ncols=2)
        self.ax_ = ax
        return self
