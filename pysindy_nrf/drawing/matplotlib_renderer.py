"""Figures on matplotlib's axes; matplotlib is imported when something is drawn."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from ..common.files import atomic_write
from ..common.lazy import require
from ..exceptions import NRFError
from .figure import Axis, Bars, Figure, Line, Map, Surface

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Sheet
    from matplotlib.figure import SubFigure
    from mpl_toolkits.mplot3d import Axes3D

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
# Keywords of matplotlib's methods, each of a type of its own.
Style = dict[str, Any]

_DASHES: dict[str, str | tuple[int, tuple[int, int]]] = {
    "": "",
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (6, 2)),
    "shortdot": (0, (1, 1)),
}
_MARKERS: dict[str, Style] = {
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
# Units in which an axis is drawn, and the factor from SI.
_DRAWN_UNITS = {"m": ("mm", 1e3)}
# Colour of the legend of a surface; colour, width and stride of the lines of nets.
_FULL_SURFACE = "#7b7b78"
_NETS = {"faint": ("0.75", 0.3, 4), "net": ("black", 0.6, 3)}
# Points of a curve: a long record becomes a picture and not a 100 MB file.
MAX_POINTS = 20_000
# Frames a second of a drawing that moves.
FRAME_RATE = 25.0
# Share of the distance between two bars that they take up.
LYING_BARS_WIDTH, UPRIGHT_BARS_WIDTH = 0.6, 0.8


class Drawing:
    """Figures that stand side by side.

    Attributes
    ----------
    ax_ : array of Axes
        Where they were drawn.
    figure_ : matplotlib Figure
    """

    # axes beside each other; 0: a single figure, and ``ax_`` is no array
    _columns: ClassVar[int] = 2
    # whether axes below each other have one abscissa
    _shared: ClassVar[bool] = True
    ax_: Axes | np.ndarray
    figure_: Sheet | SubFigure

    def __init__(self, figures: Sequence[Figure]) -> None:
        self._figures = list(figures)

    def figures(self) -> list[Figure]:
        """What is drawn, apart from how: one entry for each pair of axes."""
        return self._figures

    def plot(self, ax: Axes | Sequence[Axes] | np.ndarray | None = None) -> Self:
        """Draw with matplotlib.

        Parameters
        ----------
        ax : Axes or array of Axes, optional
            New ones if None.
        """
        figures = _panels(self.figures())
        if ax is None:
            pyplot = require("matplotlib.pyplot", "plot", "Drawing")
            sheet = pyplot.figure(layout="constrained")
            ax = _subplots(sheet, figures, self._columns or 1, self._shared)

        axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
        _draw_all(figures, list(axes))
        self.figure_ = axes[0].figure
        self.ax_ = axes if self._columns else axes[0]
        return self


class Column(Drawing):
    """Figures below each other."""

    _columns = 1


class Single(Drawing):
    """One figure; ``ax_`` is no array."""

    _columns = 0


def available() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def save(
    path: Path, figures: Sequence[Figure], columns: int = 1, title: str = ""
) -> list[Path]:
    """Write figures to one PNG, side by side in rows.

    Returns
    -------
    list of Path
        What was written: nothing without matplotlib or without figures.
    """
    if not available() or not figures:
        return []
    # no pyplot: no global state, no display
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    sheet = Sheet(layout="constrained")
    FigureCanvasAgg(sheet)
    panels = _panels(figures)
    _draw_all(panels, _subplots(sheet, panels, columns))
    if title:
        sheet.suptitle(title)
    with atomic_write(path, "wb") as file:
        sheet.savefig(file, format="png", dpi=150)
    return [path]


def animated(figure: Figure, ax: Axes) -> FuncAnimation:
    """The lines of a figure that swing, moving on the axes where they were drawn.

    A saved animation is one cycle of the slowest line long.
    """
    animation = require("matplotlib.animation", "plot", "A moving drawing")
    drawn = {line.get_label(): line for line in ax.lines}
    swinging = []
    for mark in figure.marks:
        if isinstance(mark, Line) and mark.cycle > 0:
            swinging.append((drawn[_with_indices(mark.name)], mark))
    widest = max((np.abs(mark.x).max() for _, mark in swinging), default=1.0)
    ax.set_xlim(-1.1 * widest, 1.1 * widest)

    def swing(frame: int) -> list[object]:
        for line, mark in swinging:
            phase = 2 * np.pi * frame / (FRAME_RATE * mark.cycle)
            line.set_xdata(np.cos(phase) * np.asarray(mark.x, dtype=float))
        return [line for line, _ in swinging]

    longest = max((mark.cycle for _, mark in swinging), default=1.0)
    return animation.FuncAnimation(
        ax.figure,
        swing,
        frames=itertools.count(),
        interval=1e3 / FRAME_RATE,
        save_count=max(1, round(FRAME_RATE * longest)),
        cache_frame_data=False,
    )


def _panels(figures: Sequence[Figure]) -> list[Figure]:
    """All pairs of axes, those below a figure behind it."""
    return [panel for figure in figures for panel in figure.panels]


def _subplots(
    sheet: Sheet, figures: Sequence[Figure], columns: int, shared: bool = True
) -> list[Axes]:
    """New axes for figures, in rows; in a single column they may share the abscissa."""
    columns = min(columns, len(figures))
    rows = -(-len(figures) // columns)
    width, height = np.max([figure.size for figure in figures], axis=0)
    # flat figures leave no room for the labels of the sheet
    labels = 0.6 if height < 2.5 else 0.0
    sheet.set_size_inches(columns * width, rows * height + labels)

    axes: list[Axes] = []
    for k in range(len(figures)):
        in_space = figures[k].z is not None
        shares = shared and axes and columns == 1 and not in_space
        projection = "3d" if in_space else None
        ax = sheet.add_subplot(
            rows,
            columns,
            k + 1,
            sharex=axes[0] if shares else None,
            projection=projection,
        )
        if shared and columns == 1 and k < rows - 1:
            ax.tick_params(labelbottom=False)
        axes.append(ax)
    return axes


def _draw_all(figures: Sequence[Figure], axes: Sequence[Axes]) -> None:
    """Draw figures on axes; a legend of the sheet is drawn once."""
    for figure, ax in zip(figures, axes):
        _draw(figure, ax)
        if not ax.xaxis.get_tick_params().get("labelbottom", True):
            ax.set_xlabel("")
    if figures and figures[0].legend == "sheet":
        sheet = axes[0].figure
        handles, labels = axes[0].get_legend_handles_labels()
        sheet.legend(
            handles,
            labels,
            loc="outside upper center",
            ncols=3,
            frameon=False,
            fontsize="small",
        )


def _draw(figure: Figure, ax: Axes) -> None:
    """Draw one figure on its axes."""
    if figure.z is not None:
        _draw_in_space(figure, ax)
        return
    scales = [_DRAWN_UNITS.get(axis.unit, ("", 1.0))[1] for axis in figure.axes]
    n_bars_drawn = 0
    for mark in figure.marks:
        if isinstance(mark, Bars):
            _draw_bars(ax, mark, figure, n_bars_drawn)
            n_bars_drawn += 1
        elif isinstance(mark, Map):
            _draw_map(ax, mark, scales[0], scales[1])
        elif isinstance(mark, Line):
            _draw_line(ax, mark, scales[0], scales[1])

    dress(ax, "x", figure.x)
    dress(ax, "y", figure.y)
    if figure.lying:
        ax.invert_yaxis()
    if figure.heading:
        is_map = isinstance(figure.marks[0], Map)
        ax.set_title(figure.heading, loc="left" if is_map else "center")
    _draw_legend(figure, ax)


def _draw_legend(figure: Figure, ax: Axes) -> None:
    """The legend of one figure, if it has names."""
    has_labels = bool(ax.get_legend_handles_labels()[0])
    if figure.legend == "above" and figure.named:
        ax.legend(
            frameon=False,
            fontsize="x-small",
            loc="lower right",
            bbox_to_anchor=(1, 1),
            borderaxespad=0.2,
            ncols=2,
        )
    elif figure.legend == "inside" and (figure.named or has_labels):
        ax.legend(frameon=False, fontsize="small")


def dress(ax: Axes, side: str, axis: Axis) -> None:
    """Label, ticks, range and scale of one axis (``side`` x, y or z)."""
    unit, _ = _DRAWN_UNITS.get(axis.unit, (axis.unit, 1.0))
    label = f"{axis.label} ({unit})" if unit else axis.label
    getattr(ax, f"set_{side}label")(_with_indices(label))
    if axis.log:
        getattr(ax, f"set_{side}scale")("log")
    if axis.ticks is not None:
        getattr(ax, f"set_{side}ticks")(np.arange(len(axis.ticks)), axis.ticks)
    if axis.limits is not None:
        getattr(ax, f"set_{side}lim")(*axis.limits)
    if axis.zero:
        draw_zero = ax.axhline if side == "y" else ax.axvline
        draw_zero(0, color="0.5", linewidth=0.6, zorder=0)


def _with_indices(text: str) -> str:
    """Indices such as ``s_{2}`` as formulas."""
    return re.sub(r"(\w_\{[^}]*\})", r"$\1$", text)


def _draw_line(ax: Axes, line: Line, x_scale: float, y_scale: float) -> None:
    """Draw a curve, every k-th sample of a long one."""
    abscissa = np.asarray(line.x, dtype=float)
    every = slice(None, None, max(1, len(abscissa) // MAX_POINTS))
    x = x_scale * abscissa[every]
    y = y_scale * np.asarray(line.y, dtype=float)[every]
    style: Style = {
        "color": _COLORS[line.color],
        "linewidth": line.width,
        "linestyle": _DASHES[line.dash],
        "alpha": line.opacity,
        "label": _with_indices(line.name) or None,
        **_MARKERS[line.marker],
    }
    if line.error is None:
        ax.plot(x, y, **style)
    else:
        error = y_scale * np.asarray(line.error, dtype=float)[every]
        ax.errorbar(x, y, yerr=error, capsize=3, **style)


def _draw_bars(ax: Axes, bars: Bars, figure: Figure, number: int) -> None:
    """Draw one of several sets of bars that stand beside each other."""
    values = np.asarray(bars.values, dtype=float)
    together = LYING_BARS_WIDTH if figure.lying else UPRIGHT_BARS_WIDTH
    width = together / figure.n_bars
    middle = (figure.n_bars - 1) / 2
    places = np.arange(len(values)) + (number - middle) * width

    draw = ax.barh if figure.lying else ax.bar
    draw(places, values, width, **_style_of_bars(bars, figure.lying))
    if bars.low is not None:
        bounds = np.asarray([bars.low, bars.high], dtype=float)
        ends = np.nan_to_num(np.abs(bounds - values))
        thin: Style = {
            "fmt": "none",
            "color": "black",
            "capsize": 2,
            "linewidth": 1,
        }
        if figure.lying:
            ax.errorbar(values, places, xerr=ends, **thin)
        else:
            ax.errorbar(places, values, yerr=ends, **thin)
    for text, end, place in zip(bars.texts, values, places):
        ax.annotate(
            text,
            (end, place),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
        )


def _style_of_bars(bars: Bars, lying: bool) -> Style:
    """Colours, edges and label of bars."""
    style: Style = {"label": _with_indices(bars.name) or None}
    if isinstance(bars.color, str):
        style["color"] = _COLORS[bars.color]
    else:
        style["color"] = [_COLORS[name] for name in bars.color]
    if lying:
        style |= {"edgecolor": "black", "linewidth": 0.5}
    if bars.hatched:
        style |= {"hatch": "////", "edgecolor": "white"}
    return style


def _draw_in_space(figure: Figure, ax: Axes) -> None:
    """Draw surfaces and paths over drift and rate."""
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d import Axes3D

    if not isinstance(ax, Axes3D):
        raise NRFError(
            f"{figure.title} is drawn in space",
            "Give axes with projection='3d', or none.",
        )
    scales = [_DRAWN_UNITS.get(axis.unit, ("", 1.0))[1] for axis in figure.axes]
    for mark in figure.marks:
        if isinstance(mark, Surface):
            color = _draw_surface(ax, mark, scales)
            ax.plot([], [], [], color=color, linewidth=3, label=mark.name)
        elif isinstance(mark, Line):
            lines = []
            for line, scale in zip((mark.x, mark.y, mark.z), scales):
                lines.append(scale * np.asarray(line, dtype=float))
            color = _COLORS[mark.color]
            ax.plot(*lines, color=color, linewidth=0.7 * mark.width, label=mark.name)

    for side, axis in zip("xyz", figure.axes):
        dress(ax, side, axis)
        getattr(ax, f"{side}axis").set_major_locator(MaxNLocator(5))
    ax.set_title(figure.heading)
    ax.tick_params(labelsize="small", pad=1)
    ax.tick_params(axis="z", pad=4)
    ax.zaxis.labelpad = 11
    ax.view_init(elev=24, azim=-125)
    ax.set_box_aspect(None, zoom=0.8)
    ax.legend(loc="upper left", fontsize="x-small", frameon=False)


def _draw_surface(ax: Axes3D, surface: Surface, scales: Sequence[float]) -> str:
    """Draw a surface, and give the colour of its legend."""
    grid = []
    for values, scale in zip((surface.x, surface.y, surface.z), scales):
        grid.append(scale * np.asarray(values, dtype=float))
    if surface.style == "full":
        look: Style = {"cmap": "cividis", "linewidth": 0, "alpha": 0.95}
        ax.plot_surface(*grid, rstride=1, cstride=1, **look)
        return _FULL_SURFACE
    color, width, stride = _NETS[surface.style]
    ax.plot_wireframe(
        *grid, color=color, linewidth=width, rstride=stride, cstride=stride
    )
    return color


def _draw_map(ax: Axes, field: Map, x_scale: float, y_scale: float) -> None:
    """Draw a map with its bar of colours; what is in doubt is hatched."""
    x, y = x_scale * np.asarray(field.x), y_scale * np.asarray(field.y)
    image = ax.pcolormesh(
        x,
        y,
        field.values,
        shading="auto",
        cmap="PuOr",
        vmin=-field.limit,
        vmax=field.limit,
    )
    if np.any(field.hatched):
        _draw_doubt(ax, x, y, field)
    if field.bar:
        ax.figure.colorbar(image, ax=ax, label=field.label)


def _draw_doubt(ax: Axes, x: np.ndarray, y: np.ndarray, field: Map) -> None:
    """Hatch what is in doubt, and say why."""
    from matplotlib.patches import Patch

    hatch = "////"
    levels = [0.5, 1.5]  # about the 1 of what is hatched
    doubt = ax.contourf(
        x, y, field.hatched, levels=levels, colors="none", hatches=[hatch]
    )
    doubt.set(edgecolor="0.6", linewidth=0.0)
    mark = Patch(facecolor="none", edgecolor="0.6", hatch=hatch, label=field.doubt)
    ax.legend(
        handles=[mark],
        frameon=False,
        fontsize="x-small",
        loc="lower right",
        bbox_to_anchor=(1, 0.99),
    )
