"""A figure apart from how it is drawn: axes in SI units, marks, words, and the table of
its numbers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

CYCLE = ("blue", "red", "green", "orange", "sky", "ink")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "shortdot")


@dataclass(eq=False)
class Table:
    """Rows of values below a head, with a caption."""

    caption: str
    head: list[str]
    rows: list[list[Any]]


def table(
    caption: str,
    frame: pd.DataFrame,
    names: Mapping[str, str] | None = None,
    index: str | None = None,
) -> Table:
    """Table of a frame, its columns renamed; the index comes first under the heading
    ``index``, if that is given.
    """
    rows = [
        list(row) if index is not None else list(row[1:])
        for row in frame.itertuples(name=None)
    ]
    head = [(names or {}).get(str(c), str(c)) for c in frame.columns]
    return Table(caption, [index, *head] if index is not None else head, rows)


@dataclass(eq=False)
class Axis:
    """Label, SI unit and range of an axis; ``ticks`` are the words at 0, 1, 2, ...;
    ``s_{2}`` is an s with index 2.
    """

    label: str = ""
    unit: str = ""
    limits: tuple[float | None, float | None] | None = None
    ticks: Sequence[str] | None = None
    log: bool = False
    zero: bool = False


@dataclass(eq=False)
class Line:
    """Curve, in the plane or in space; without a dash only its markers ("o", "s", "|"
    or "ring").
    """

    x: Any
    y: Any
    name: str = ""
    color: str = "blue"
    width: float = 1.1
    dash: str = "solid"
    marker: str = ""
    error: Any = None
    opacity: float = 1.0
    z: Any = None


@dataclass(eq=False)
class Bars:
    """Bars at 0, 1, 2, ...; several in one figure stand beside each other; texts stand
    behind lying bars.
    """

    values: Any
    name: str = ""
    color: str | Sequence[str] = "blue"
    low: Any = None
    high: Any = None
    texts: Sequence[str] = ()
    hatched: bool = False


@dataclass(eq=False)
class Map:
    """Values from -limit to limit over a plane by colour; hatched where they are in
    doubt, and why.
    """

    x: Any
    y: Any
    values: Any
    label: str
    limit: float
    hatched: Any
    doubt: str
    bar: bool = True


@dataclass(eq=False)
class Surface:
    """Surface over the grid of x (along rows) and y (along columns): "full", "faint" or
    a "net".
    """

    x: Any
    y: Any
    z: Any
    name: str
    style: str = "full"


Mark = Line | Bars | Map | Surface


@dataclass(eq=False)
class Figure:
    """What one pair (or triple) of axes shows, and its words."""

    title: str
    marks: list[Mark]
    x: Axis
    y: Axis
    z: Axis | None = None  # if given, it is drawn in space and can be turned
    alt: str = ""
    caption: str = ""
    heading: str = ""
    table: Table | None = None
    lying: bool = False
    wide: bool = False
    legend: str = "inside"
    size: tuple[float, float] = (4.5, 3.4)
    height: int = 300

    @property
    def named(self) -> bool:
        """Whether it has a legend."""
        return any(getattr(mark, "name", "") for mark in self.marks)


def dof_words(name: Any) -> str:
    """Name of a balance or an effect as it is printed: ``DOF 2`` for ``dof 2``, no
    underscores.
    """
    return str(name).replace("dof", "DOF").replace("_", " ")


def rms(x: Any) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))
