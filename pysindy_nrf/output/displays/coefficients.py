"""Coefficients of every model side by side."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from ...common.extras import require
from ._axes import BLACK, CYCLE


class CoefficientsDisplay:
    """What plain SINDy and this package make of every storey: one panel a storey, one group of bars a term.

    Parameters
    ----------
    shares : DataFrame
        As :func:`pysindy_nrf.selection.comparison.term_shares` returns.

    Attributes
    ----------
    ax_ : ndarray of Axes
    figure_ : Figure

    Examples
    --------
    >>> import pandas as pd
    >>> from pysindy_nrf.output.displays import CoefficientsDisplay
    >>> index = pd.MultiIndex.from_tuples([("storey 1", "v"), ("storey 1", "s")])
    >>> shares = pd.DataFrame({"truth": [0.1, 0.9], "SINDy": [0.3, 0.6]}, index=index)
    >>> len(CoefficientsDisplay(shares).plot().ax_)
    1
    """

    def __init__(self, shares: pd.DataFrame) -> None:
        self.shares = shares

    @classmethod
    def from_comparison(cls, comparison: Any) -> CoefficientsDisplay:
        """The coefficients of :func:`pysindy_nrf.selection.comparison.compare`.

        Parameters
        ----------
        comparison : Comparison

        Returns
        -------
        CoefficientsDisplay
        """
        return cls(comparison.coefficients)

    def plot(self, ax: Any = None) -> CoefficientsDisplay:
        """Draw.

        Parameters
        ----------
        ax : sequence of Axes, optional
            One for each storey.

        Returns
        -------
        self
        """
        sites = list(dict.fromkeys(self.shares.index.get_level_values(0)))
        if ax is None:
            plt = require("matplotlib.pyplot", "plot", "Drawing")
            self.figure_, ax = plt.subplots(
                len(sites), 1, figsize=(8.5, 2.1 * len(sites) + 0.6), squeeze=False, sharex=True, layout="constrained"
            )
        self.ax_ = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        self.figure_ = self.ax_[0].figure
        models = list(self.shares.columns)
        width = 0.85 / len(models)
        paint = _styles(models)
        for panel, site in zip(self.ax_, sites):
            part = self.shares.loc[site]
            at = np.arange(len(part))
            for k, model in enumerate(models):
                panel.bar(
                    at + (k - (len(models) - 1) / 2) * width, part[model], width, label=model, **paint[model]
                )
            panel.axhline(0, color=BLACK, linewidth=0.6)
            panel.set_ylabel(f"{site}\nshare of its force")
            # bars beyond twice the storey's force (columns that nearly cancel) are cut, and say so by reaching the edge
            panel.set_ylim(*np.clip([1.1 * part.min(axis=None), 1.1 * part.max(axis=None)], -2.0, 2.0))
            panel.set_xticks(at, [_typeset(str(term)) for term in part.index])
        self.ax_[-1].set_xlabel("term: coefficient times its rms; other: what the terms of this storey cannot hold")
        self.figure_.legend(
            *self.ax_[0].get_legend_handles_labels(),
            frameon=False,
            fontsize="small",
            ncols=3,
            loc="outside upper center",
        )
        return self


def _typeset(term: str) -> str:
    """Powers of v and s as a formula; other words as they are."""
    return f"${term.replace(' ', chr(92) + ',')}$" if re.fullmatch(r"[vs](\^\d+)?( [vs](\^\d+)?)*", term) else term


def _styles(models: list[str]) -> dict[str, dict[str, str]]:
    """A colour for each model; hatched once the colours are used up."""
    colours = [c for c in CYCLE if c != BLACK]
    out: dict[str, dict[str, str]] = {}
    for model in models:
        k = len(out) - ("truth" in out)
        plain = {"facecolor": BLACK} if model == "truth" else {"facecolor": colours[k % len(colours)]}
        out[model] = plain | ({"hatch": "////", "edgecolor": "white"} if k >= len(colours) else {})
    return out
