"""How much of the residual a force at each site could explain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from ._axes import BLACK, BLUE, SKY, axes


class LocalisationDisplay:
    """Bars of the share that each site explains, with bands.

    Parameters
    ----------
    table : DataFrame
        As of :func:`pysindy_nrf.discrepancy.localisation.localise`.
    most : int
        Sites shown.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.output.displays import LocalisationDisplay
    >>> rows = {"share": [96.0, 40.0], "low": [90.0, 20.0], "high": [99.0, 60.0], "balances": ["+1", "-1 +2"]}
    >>> display = LocalisationDisplay(pd.DataFrame(rows, index=["storey 1", "storey 2"])).plot()
    >>> display.ax_.get_yticklabels()[0].get_text()
    'storey 1  (+1)'
    """

    def __init__(self, table: pd.DataFrame, most: int = 10) -> None:
        self.table, self.most = table, most

    @classmethod
    def from_residual(cls, residual: Any, **options: Any) -> LocalisationDisplay:
        """Localise and keep the table.

        Parameters
        ----------
        residual : pysindy_nrf.discrepancy.residual.Residual
        **options
            Of :func:`~pysindy_nrf.discrepancy.localisation.localise`.

        Returns
        -------
        LocalisationDisplay
        """
        from ...discrepancy.localisation import localise

        return cls(localise(residual, **options))

    def plot(self, ax: Any = None) -> LocalisationDisplay:
        """Draw, best on top.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        table = self.table[self.table["share"].notna()].iloc[: self.most]
        ax, self.figure_ = axes(ax, (5.0, 1.0 + 0.3 * len(table)))
        y = np.arange(len(table))
        share = table["share"].to_numpy()
        band = np.abs(np.clip([table["low"].to_numpy(), table["high"].to_numpy()], 0, 100) - share)
        colors = [BLUE if k == 0 else SKY for k in y]
        ax.barh(y, share, color=colors, edgecolor=BLACK, linewidth=0.5, height=0.6, label="share")
        ax.errorbar(
            share, y, xerr=np.nan_to_num(band), fmt="none", color=BLACK, capsize=2, linewidth=1, label="about 95 %"
        )
        ax.set_yticks(y, [f"{site}  ({signs})" for site, signs in zip(table.index, table["balances"])])
        ax.invert_yaxis()
        ax.set_xlim(0, 105)
        ax.set_xlabel("share of the residual a force there explains (%)")
        ax.legend(loc="lower right")
        self.ax_ = ax
        return self
