"""Figures on matplotlib's axes, and the base of all displays; matplotlib is imported
when something is drawn.
"""

import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from ...common.files import atomic_write
from ...common.lazy import require
from .figure import Axis, Bars, Figure, Line, Map

# Okabe and Ito's colours: told apart by colour-blind readers, and in grey by their
# lightness.
_COLORS = {
    "ink": "#000000",
    "blue": "#0072B2",
    "orange": "#E69F00",
    "green": "#009E73",
    "sky": "#56B4E9",
    "red": "#D55E00",
    "muted": "0.5",
}
_DASHES: dict[str, Any] = {
    "": "",
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (6, 2)),
    "shortdot": (0, (1, 1)),
}
_MARKERS: dict[str, dict[str, Any]] = {
    "": {},
    "o": {"marker": "o", "markersize": 4},
    "s": {"marker": "s", "markersize": 4},
    "|": {"marker": "|", "markersize": 16, "markeredgewidth": 2},
    "ring": {
        "marker": "o",
        "markersize": 12,
        "markerfacecolor": "none",
        "markeredgewidth": 1.5,
    },
}
_MOST = 20_000  # points of a curve: a long record is a picture and not a 100 MB file


class Drawing:
    """Figures that stand beside each other; ``ax_`` (array of Axes) and ``figure_`` are
    where they were drawn.
    """

    _columns: ClassVar[int] = (
        2  # axes beside each other; 0: a single figure, and ``ax_`` is no array
    )
    ax_: Any
    figure_: Any

    def __init__(self, figures: Sequence[Figure]) -> None:
        self._figures = list(figures)

    def figures(self) -> list[Figure]:
        """What is drawn, apart from how: one entry for each pair of axes."""
        return self._figures

    def plot(self, ax: Any = None) -> Self:
        """Draw with matplotlib.

        Parameters
        ----------
        ax : Axes or array of Axes, optional
            New ones if None.
        """
        figures = self.figures()
        if ax is None:
            plt = require("matplotlib.pyplot", "plot", "Drawing")
            ax = _subplots(
                plt.figure(layout="constrained"), figures, self._columns or 1
            )
        self.ax_ = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        self.figure_ = self.ax_[0].figure
        _draw_all(figures, self.ax_)
        if not self._columns:
            self.ax_ = self.ax_[0]
        return self


def available() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def save(
    path: Path, figures: Sequence[Figure], columns: int = 1, title: str = ""
) -> list[Path]:
    """Write figures to one PNG, side by side in rows; nothing without matplotlib."""
    if not available() or not figures:
        return []
    # no pyplot: no global state, no display
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    sheet = Sheet(layout="constrained")
    FigureCanvasAgg(sheet)
    _draw_all(figures, _subplots(sheet, figures, columns))
    if title:
        sheet.suptitle(title)
    with atomic_write(path, "wb") as file:
        sheet.savefig(file, format="png", dpi=150)
    return [path]


def _subplots(sheet: Any, figures: Sequence[Figure], columns: int) -> list[Any]:
    """New axes for figures, in rows; in a single column they share their abscissa."""
    columns = min(columns, len(figures))
    rows = -(-len(figures) // columns)
    width, height = np.max([f.size for f in figures], axis=0)
    sheet.set_size_inches(
        columns * width, rows * height + (0.6 if height < 2.5 else 0.0)
    )
    out: list[Any] = []
    for k in range(len(figures)):
        out.append(
            sheet.add_subplot(
                rows, columns, k + 1, sharex=out[0] if out and columns == 1 else None
            )
        )
        if columns == 1 and k < rows - 1:
            out[-1].tick_params(labelbottom=False)
    return out


def _draw_all(figures: Sequence[Figure], axes: Sequence[Any]) -> None:
    """Draw figures on axes; a legend of the sheet is drawn once."""
    for figure, ax in zip(figures, axes):
        _draw(figure, ax)
    if figures and figures[0].legend == "sheet":
        handles = axes[0].get_legend_handles_labels()
        axes[0].figure.legend(
            *handles,
            frameon=False,
            fontsize="small",
            ncols=3,
            loc="outside upper center",
        )


def _draw(figure: Figure, ax: Any) -> None:
    """Draw one figure on its axes."""
    scales = [1e3 if axis.unit == "m" else 1.0 for axis in (figure.x, figure.y)]
    beside = [mark for mark in figure.marks if isinstance(mark, Bars)]
    for mark in figure.marks:
        if isinstance(mark, Bars):
            _bars(ax, mark, figure.lying, beside.index(mark), len(beside))
        elif isinstance(mark, Map):
            _map(ax, mark, *scales)
        elif isinstance(mark, Line):
            _line(ax, mark, *scales)
    dress(ax, "x", figure.x)
    dress(ax, "y", figure.y)
    if figure.lying:
        ax.invert_yaxis()
    if figure.heading:
        ax.set_title(
            figure.heading, loc="left" if isinstance(figure.marks[0], Map) else "center"
        )
    if figure.legend == "above" and figure.named:
        place: dict[str, Any] = {
            "loc": "lower right",
            "bbox_to_anchor": (1, 1),
            "borderaxespad": 0.2,
            "ncols": 2,
        }
        ax.legend(frameon=False, fontsize="x-small", **place)
    elif figure.legend == "inside" and (
        figure.named or ax.get_legend_handles_labels()[0]
    ):
        ax.legend(frameon=False, fontsize="small")


def dress(ax: Any, side: str, axis: Axis) -> None:
    """Label, ticks, range and scale of one axis."""
    unit = {"m": "mm"}.get(axis.unit, axis.unit)
    getattr(ax, f"set_{side}label")(
        _text(f"{axis.label} ({unit})" if unit else axis.label)
    )
    if axis.log:
        getattr(ax, f"set_{side}scale")("log")
    if axis.ticks is not None:
        getattr(ax, f"set_{side}ticks")(np.arange(len(axis.ticks)), axis.ticks)
    if axis.limits is not None:
        getattr(ax, f"set_{side}lim")(*axis.limits)
    if axis.zero:
        (ax.axhline if side == "y" else ax.axvline)(
            0, color="0.5", linewidth=0.6, zorder=0
        )


def _text(text: str) -> str:
    """Indices as formulas."""
    return re.sub(r"(\w)_\{([^}]*)\}", lambda m: f"${m[1]}_{{{m[2]}}}$", text)


def _line(ax: Any, line: Line, fx: float, fy: float) -> None:
    """Draw a curve, every k-th sample of a long one."""
    every = slice(None, None, max(1, len(line.x) // _MOST))
    x, y = (
        fx * np.asarray(line.x, dtype=float)[every],
        fy * np.asarray(line.y, dtype=float)[every],
    )
    style: dict[str, Any] = {
        "color": _COLORS[line.color],
        "linewidth": line.width,
        "linestyle": _DASHES[line.dash],
        "alpha": line.opacity,
        "label": _text(line.name) or None,
        **_MARKERS[line.marker],
    }
    if line.error is not None:
        ax.errorbar(
            x,
            y,
            yerr=fy * np.asarray(line.error, dtype=float)[every],
            capsize=3,
            **style,
        )
    else:
        ax.plot(x, y, **style)


def _bars(ax: Any, bars: Bars, lying: bool, k: int, n: int) -> None:
    """Draw the k-th of n rows of bars."""
    values = np.asarray(bars.values, dtype=float)
    width = (0.6 if lying else 0.8) / n
    at = np.arange(len(values)) + (k - (n - 1) / 2) * width
    color = (
        _COLORS[bars.color]
        if isinstance(bars.color, str)
        else [_COLORS[c] for c in bars.color]
    )
    style: dict[str, Any] = {"color": color, "label": _text(bars.name) or None}
    if lying:
        style |= {"edgecolor": "black", "linewidth": 0.5}
    if bars.hatched:
        style |= {"hatch": "////", "edgecolor": "white"}
    (ax.barh if lying else ax.bar)(at, values, width, **style)
    if bars.low is not None:
        ends = np.nan_to_num(
            np.abs(np.asarray([bars.low, bars.high], dtype=float) - values)
        )
        points = (values, at) if lying else (at, values)
        thin: dict[str, Any] = {
            "fmt": "none",
            "color": "black",
            "capsize": 2,
            "linewidth": 1,
        }
        ax.errorbar(*points, **{"xerr" if lying else "yerr": ends}, **thin)
    for text, end, place in zip(bars.texts, values, at):
        ax.annotate(
            text,
            (end, place),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
        )


def _map(ax: Any, found: Map, fx: float, fy: float) -> None:
    """Draw a map with its bar of colours; what is in doubt is hatched."""
    x, y = fx * np.asarray(found.x), fy * np.asarray(found.y)
    image = ax.pcolormesh(
        x,
        y,
        found.values,
        shading="auto",
        cmap="PuOr",
        vmin=-found.limit,
        vmax=found.limit,
    )
    if np.any(found.hatched):
        from matplotlib.patches import Patch

        doubt = ax.contourf(
            x, y, found.hatched, levels=[0.5, 1.5], colors="none", hatches=["////"]
        )
        doubt.set(edgecolor="0.6", linewidth=0.0)
        mark = Patch(facecolor="none", edgecolor="0.6", hatch="////", label=found.doubt)
        ax.legend(
            handles=[mark],
            frameon=False,
            fontsize="x-small",
            loc="lower right",
            bbox_to_anchor=(1, 0.99),
        )
    if found.bar:
        ax.figure.colorbar(image, ax=ax, label=found.label)
