"""Modes of the linear part: their shapes, and the structure as it moves in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from ...diagnosis.modes import modal_assurance
from ...drawing.figure import CYCLE, DASHES, Axis, Figure, Line

# Modes that are drawn; more lines hide each other.
DRAWN_MODES = 6
# Seconds that one cycle of the fastest mode takes on the page, long enough for eyes to
# follow it. All modes of a figure are slowed down by the same factor.
FASTEST_CYCLE = 0.8


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode as it is drawn.

    Parameters
    ----------
    number : int
    frequency, damping : float
        Hz, and share of critical.
    shape : ndarray of shape (n_dof + 1,)
        Displacement of the base and of each DOF; the largest is 1.
    cycle : float
        Seconds of one cycle as it is drawn; 0 for a mode that does not oscillate.
    before : Mode, optional
        The same mode in an earlier test.
    likeness : float
        MAC of both shapes; NaN without an earlier test.
    """

    number: int
    frequency: float
    damping: float
    shape: np.ndarray
    cycle: float
    before: Mode | None = None
    likeness: float = float("nan")

    @property
    def words(self) -> str:
        """Frequency and damping; those of both tests if there are two."""
        now = f"{self.frequency:.4g} Hz, damping {100 * self.damping:.2g} %"
        if self.before is None:
            return now
        return f"Before: {self.before.words}. After: {now}. MAC {self.likeness:.3f}."

    def column(self, height: float, reach: float) -> str:
        """Path of a column from the base upwards, as SVG writes it.

        It stands upright at every floor. The storeys are ``height`` high, and the
        largest deflection is ``reach``.
        """
        floors = np.round(reach * self.shape, 1)
        half = height / 2
        curves: list[str] = []
        for step in np.diff(floors):
            ends = f"{step:.3g}-{half:g} {step:.3g}-{height:g}"
            curves.append(f"s{ends}" if curves else f"c0-{half:g} {ends}")
        return f"M0 0{''.join(curves)}"

    @property
    def alt(self) -> str:
        """The shape in words."""
        entries = ", ".join(f"{entry:.2f}" for entry in self.shape[1:])
        return f"Shape of mode {self.number} from DOF 1 upwards: {entries}"


@dataclass(frozen=True, eq=False)
class MovingModes:
    """The structure as it moves in each of its modes.

    Parameters
    ----------
    title : str
    modes : sequence of Mode
        Of one structure, by rising frequency.
    """

    title: str
    modes: Sequence[Mode]

    @property
    def caption(self) -> str:
        """How the drawing is to be read."""
        slowed = [m.cycle * m.frequency for m in self.modes if m.cycle > 0]
        parts = ["The largest deflection of each mode is drawn at the same size."]
        if slowed:
            parts.append(f"The motion is drawn {slowed[0]:.2g} times slower.")
        if any(mode.before is not None for mode in self.modes):
            parts.append("Orange and dashed: the test before.")
        return " ".join(parts)


def modes_of(modes: pd.DataFrame) -> list[Mode]:
    """The modes that are drawn, those of the lowest frequencies.

    Parameters
    ----------
    modes : DataFrame
        As returned by :meth:`ChainModel.modes`.
    """
    drawn = modes.head(DRAWN_MODES)
    fastest = float(drawn["frequency"].max())
    listed = []
    for number, row in enumerate(drawn.itertuples(index=False), 1):
        frequency, damping, *shape = row
        cycle = FASTEST_CYCLE * fastest / frequency if frequency > 0 else 0.0
        with_base = np.array([0.0, *shape])
        listed.append(Mode(number, frequency, damping, with_base, cycle))
    return listed


def modes_of_two_tests(before: pd.DataFrame, after: pd.DataFrame) -> list[Mode]:
    """Modes after a change, each with that of the same number before it.

    Parameters
    ----------
    before, after : DataFrame
        As returned by :meth:`ChainModel.modes`.
    """
    likeness = np.diag(modal_assurance(before, after))
    pairs = []
    for first, second, alike in zip(modes_of(before), modes_of(after), likeness):
        # the sign of a shape is free
        sign = 1.0 if first.shape @ second.shape >= 0 else -1.0
        same_side = replace(first, shape=sign * first.shape)
        pairs.append(replace(second, before=same_side, likeness=float(alike)))
    return pairs


def modes_figure(modes: pd.DataFrame) -> Figure:
    """Shapes of the first modes of the linear part, floor over displacement.

    Parameters
    ----------
    modes : DataFrame
        As returned by :meth:`ChainModel.modes`.
    """
    drawn = modes_of(modes)
    marks = []
    for mode, color, dash in zip(drawn, CYCLE, DASHES):
        floors = np.arange(len(mode.shape))
        line = Line(
            mode.shape, floors, mode.words, color, 1.5, dash, "o", cycle=mode.cycle
        )
        marks.append(line)

    n_dof = len(drawn[0].shape) - 1
    frequencies = [f"mode {m.number} at {m.frequency:.4g} Hz" for m in drawn]
    return Figure(
        "Mode shapes of the linear part",
        marks,
        Axis("mode shape (largest entry 1)", zero=True),
        Axis(ticks=["base", *(f"DOF {dof}" for dof in range(1, n_dof + 1))]),
        alt=f"Shapes of the modes, largest entry 1: {'; '.join(frequencies)}.",
        legend="above",
        height=120 + 58 * n_dof,
    )
