"""Axes, colours and marks common to all displays."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.extras import require

# Okabe and Ito's colours: told apart by colour-blind readers, and in grey by their lightness.
BLACK, BLUE, ORANGE, GREEN, SKY, RED = "#000000", "#0072B2", "#E69F00", "#009E73", "#56B4E9", "#D55E00"
CYCLE = (BLUE, RED, GREEN, ORANGE, SKY, BLACK)
STYLES = ("-", "--", ":", "-.", (0, (6, 2)), (0, (1, 1)))
_MOST = 20_000


def axes(ax: Any, figsize: tuple[float, float] = (4.5, 3.4), projection: str | None = None) -> tuple[Any, Any]:
    """The axes given, or new ones, and their figure."""
    if ax is None:
        plt = require("matplotlib.pyplot", "plot", "Drawing")
        figure = plt.figure(figsize=figsize, layout="constrained")
        ax = figure.add_subplot(projection=projection)
    return ax, ax.figure


def stacked(ax: Any, rows: int, figsize: tuple[float, float]) -> tuple[Any, Any]:
    """Axes given, or new ones above each other that share their abscissa."""
    if ax is None:
        plt = require("matplotlib.pyplot", "plot", "Drawing")
        figure, ax = plt.subplots(rows, 1, sharex=True, squeeze=False, figsize=figsize, layout="constrained")
    ax = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    return ax, ax[0].figure


def thin(*lines: Any) -> list[np.ndarray]:
    """Every k-th sample, so that a long record is a picture and not a 100 MB file."""
    arrays = [np.asarray(line, dtype=float) for line in lines]
    step = max(1, len(arrays[0]) // _MOST)
    return [array[::step] for array in arrays]


def number(site: Any) -> str:
    """The index that stands behind s, v and R: ``2`` for storey 2."""
    text = str(site)
    return text.split()[-1] if text.startswith("storey") else text
