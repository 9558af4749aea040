"""The language of figures: axes in SI units, marks, words, and a table of the numbers.

Two renderers read it: matplotlib's sheet and plotly's page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .tables import Table, table

__all__ = [
    "CYCLE",
    "DASHES",
    "Axis",
    "Bars",
    "Figure",
    "Line",
    "Map",
    "Mark",
    "Surface",
    "Table",
    "dof_words",
    "rms",
    "table",
]

# Colours and dashes of lines that stand for things of one kind.
CYCLE = ("blue", "red", "green", "orange", "sky", "ink")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "shortdot")


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis.

    Parameters
    ----------
    label, unit : str
        In a label ``s_{2}`` is an s with index 2.
    limits : (float or None, float or None), optional
        Its range; as wide as the marks if None.
    ticks : sequence of str, optional
        Words at 0, 1, 2, ...
    log, zero : bool
        Whether it is logarithmic, and whether a line marks its zero.
    """

    label: str = ""
    unit: str = ""
    limits: tuple[float | None, float | None] | None = None
    ticks: Sequence[str] | None = None
    log: bool = False
    zero: bool = False


@dataclass(frozen=True, eq=False)
class Line:
    """A curve in the plane, or in space if it has a z.

    Parameters
    ----------
    x, y, z, error : array-like
        Points, and the half-length of their error bars.
    name, color : str
        Name in the legend; colour by name.
    width, opacity : float
    dash : str
        One of ``DASHES``; only markers are drawn if it is empty.
    marker : {"", "o", "s", "|", "ring"}
    cycle : float
        Seconds in which it swings about x = 0 where drawings move; 0 if it stands.
    """

    x: ArrayLike
    y: ArrayLike
    name: str = ""
    color: str = "blue"
    width: float = 1.1
    dash: str = "solid"
    marker: str = ""
    error: ArrayLike | None = None
    opacity: float = 1.0
    z: ArrayLike | None = None
    cycle: float = 0.0


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars at 0, 1, 2, ...; several in one figure stand side by side.

    Parameters
    ----------
    values, low, high : array-like
        Lengths, and the ends of their error bars.
    name : str
    color : str or sequence of str
        Of all, or of each.
    texts : sequence of str
        Behind lying bars.
    hatched : bool
    """

    values: ArrayLike
    name: str = ""
    color: str | Sequence[str] = "blue"
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    texts: Sequence[str] = ()
    hatched: bool = False


@dataclass(frozen=True, eq=False)
class Map:
    """Values from -limit to limit over a plane by colour.

    Parameters
    ----------
    x, y, values : array-like of shape (n, n)
    label : str
        Of the bar of colours.
    limit : float
    hatched : array-like of shape (n, n)
        Where the values are in doubt.
    doubt : str
        Why they are.
    bar : bool
        Whether the bar of colours is drawn.
    """

    x: ArrayLike
    y: ArrayLike
    values: ArrayLike
    label: str
    limit: float
    hatched: ArrayLike
    doubt: str
    bar: bool = True


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface over the grid of x (along rows) and y (along columns).

    Parameters
    ----------
    x, y, z : array-like of shape (n, n)
    name : str
    style : {"full", "faint", "net"}
    """

    x: ArrayLike
    y: ArrayLike
    z: ArrayLike
    name: str
    style: str = "full"


Mark = Line | Bars | Map | Surface


@dataclass(frozen=True, eq=False)
class Figure:
    """What one pair of axes shows, or three axes in space, and its words.

    Parameters
    ----------
    title : str
        On the page.
    marks : list of Mark
    x, y, z : Axis
        With a z the figure is drawn in space and can be turned.
    alt, caption : str
        What is seen, for readers who do not see it, and what it means.
    heading : str
        On the sheet.
    table : Table, optional
        The numbers.
    lying, wide : bool
        Whether bars lie, and whether the page gives it its own row.
    legend : {"inside", "above", "sheet"}
        Where it stands; ``"sheet"``: once for all axes.
    size : (float, float)
        On the sheet, inches.
    height : int
        On the page, pixels.
    below : sequence of Figure
        Further axes below these, on the same abscissa.

    Examples
    --------
    >>> from pysindy_nrf.report import Axis, Bars, Figure
    >>> sites = Axis(ticks=["storey 1", "storey 2"])
    >>> shares = Bars([70.0, 30.0], name="dissipated")
    >>> figure = Figure("Energy", [shares], sites, Axis("share", "%", (0, 100)))
    >>> figure.named, figure.n_bars
    (True, 1)
    """

    title: str
    marks: Sequence[Mark]
    x: Axis
    y: Axis
    z: Axis | None = None
    alt: str = ""
    caption: str = ""
    heading: str = ""
    table: Table | None = None
    lying: bool = False
    wide: bool = False
    legend: str = "inside"
    size: tuple[float, float] = (4.5, 3.4)
    height: int = 300
    below: Sequence[Figure] = ()

    @property
    def named(self) -> bool:
        """Whether it has a legend."""
        return any(getattr(mark, "name", "") for mark in self.marks)

    @property
    def axes(self) -> list[Axis]:
        """Its two or three axes."""
        return [axis for axis in (self.x, self.y, self.z) if axis is not None]

    @property
    def panels(self) -> list[Figure]:
        """This figure and those below it, from the top down."""
        return [self, *self.below]

    @property
    def n_bars(self) -> int:
        """How many sets of bars stand side by side."""
        return sum(isinstance(mark, Bars) for mark in self.marks)


def dof_words(name: object) -> str:
    """The name of a balance or an effect as it is printed: ``DOF 2`` for ``dof 2``."""
    return str(name).replace("dof", "DOF").replace("_", " ")


def rms(values: ArrayLike) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
