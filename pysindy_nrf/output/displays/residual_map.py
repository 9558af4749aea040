"""Where and when the balances do not close."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ._axes import axes

_COLUMNS = 240


class ResidualMapDisplay:
    """Running rms of the residual of every storey or balance along a record.

    Parameters
    ----------
    table : DataFrame
        Rows ``"storey i"`` or ``"dof j"``, columns time in s; rms as a percentage of the reference.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> from pysindy_nrf import NRFRegressor, datasets
    >>> from pysindy_nrf.output.displays import ResidualMapDisplay
    >>> X, F = datasets.load_demo().to_features()
    >>> display = ResidualMapDisplay.from_estimator(NRFRegressor(degree=3).fit(X, F), X, F).plot()
    >>> list(display.table.index)
    ['storey 1', 'storey 2', 'storey 3']
    """

    def __init__(self, table: pd.DataFrame) -> None:
        self.table = table

    @classmethod
    def from_residual(cls, residual: Any, kind: str = "storey", record: int = 0) -> ResidualMapDisplay:
        """From a one-step residual.

        Parameters
        ----------
        residual : pysindy_nrf.discrepancy.residual.Residual
        kind : {"storey", "dof"}
        record : int

        Returns
        -------
        ResidualMapDisplay
        """
        parts = residual.storey if kind == "storey" else residual.balance
        e = parts[record]
        edges = np.linspace(0, len(e), min(_COLUMNS, len(e)) + 1).astype(int)
        squares = np.add.reduceat(e**2, edges[:-1]) / np.diff(edges)[:, None]
        names = [f"{kind} {j + 1}" for j in range(e.shape[1])]
        reference = residual.sizes.loc[names, "reference"].to_numpy()
        seg = residual.data.segments[record]
        time = np.arange(len(e)) if seg.t is None else seg.t[seg.valid]
        return cls(pd.DataFrame(100 * (np.sqrt(squares) / reference).T, index=names, columns=time[edges[:-1]]))

    @classmethod
    def from_estimator(
        cls, estimator: Any, X: Any, F: Any = None, kind: str = "storey", **options: Any
    ) -> ResidualMapDisplay:
        """From a fitted regressor and data, in the regressor's band.

        Parameters
        ----------
        estimator : fitted NRFRegressor
        X, F, **options
            As for its ``predict``.
        kind : {"storey", "dof"}

        Returns
        -------
        ResidualMapDisplay
        """
        from ...discrepancy.residual import residual_of

        options = {"coordinates": estimator.coordinates, "dt": estimator.dt} | options
        data = estimator.model_.segments(X, F, **options)
        return cls.from_residual(residual_of(estimator.model_, data, band=estimator.band), kind)

    def plot(self, ax: Any = None) -> ResidualMapDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax, (6.4, max(2.4, 0.8 + 0.5 * len(self.table))))
        times = self.table.columns.to_numpy(dtype=float)
        step = times[1] - times[0] if len(times) > 1 else 1.0
        grid = np.append(times, times[-1] + step)
        mesh = ax.pcolormesh(grid, np.arange(len(self.table) + 1) + 0.5, self.table.to_numpy(), cmap="cividis", vmin=0)
        ax.set_yticks(np.arange(len(self.table)) + 1, self.table.index)
        ax.set_xlabel("time (s)")
        self.figure_.colorbar(mesh, ax=ax, label="residual, rms\n(% of its reference)")
        self.ax_ = ax
        return self
