"""Errors before and after each effect of the closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._axes import CYCLE, axes


class BeforeAfterDisplay:
    """Held-out errors of the baseline and after each added effect.

    Parameters
    ----------
    names : sequence of str
        The baseline and each effect.
    errors : ndarray of shape (n_models, n_balances)
        Held-out balance error, percent NRMSE.
    balances : sequence of str
        Names of the columns.

    Attributes
    ----------
    ax_, figure_ : matplotlib Axes and Figure

    Examples
    --------
    >>> from pysindy_nrf.output.displays import BeforeAfterDisplay
    >>> names, balances = ["linear storeys", "cubic stiffness at storey 1"], ["DOF 1", "DOF 2"]
    >>> display = BeforeAfterDisplay(names, [[43.9, 4.3], [2.2, 4.2]], balances).plot()
    >>> display.ax_.get_ylabel(), len(display.ax_.containers)
    ('held-out balance error (% NRMSE)', 2)
    """

    def __init__(self, names: Sequence[str], errors: Any, balances: Sequence[str]) -> None:
        self.names, self.balances = list(names), list(balances)
        self.errors = np.asarray(errors, dtype=float)

    @classmethod
    def from_report(cls, report: Any) -> BeforeAfterDisplay:
        """The errors of a report of :func:`pysindy_nrf.close_loop`.

        Parameters
        ----------
        report : LoopReport

        Returns
        -------
        BeforeAfterDisplay
        """
        columns = [c for c in report.table if c == "held-out" or c.startswith("held-out dof")]
        named = ["pooled" if c == "held-out" else c.removeprefix("held-out ").replace("dof", "DOF") for c in columns]
        words = [str(i).replace("_", " ") for i in report.table.index]
        return cls([words[0], *(f"+ {w}" for w in words[1:])], report.table[columns].to_numpy(dtype=float), named)

    def plot(self, ax: Any = None) -> BeforeAfterDisplay:
        """Draw.

        Parameters
        ----------
        ax : Axes, optional

        Returns
        -------
        self
        """
        ax, self.figure_ = axes(ax)
        n, at = len(self.names), np.arange(len(self.balances))
        width = 0.8 / n
        for k, name in enumerate(self.names):
            ax.bar(at + (k - (n - 1) / 2) * width, self.errors[k], width, label=name, color=CYCLE[k % len(CYCLE)])
        ax.set_xticks(at, self.balances)
        ax.set_ylabel("held-out balance error (% NRMSE)")
        ax.set_ylim(0, 1.25 * np.nanmax(self.errors))
        ax.legend(frameon=False, fontsize="small")
        self.ax_ = ax
        return self
