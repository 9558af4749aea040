"""What a search handles: proposals, accepted effects, the current state, findings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from ..chain.sites import Site
from ..laws.base import ForceLaw
from ..laws.shape import Shape, ShapeScale
from .constants import LEAST_GAIN, TENTH, WINDOWS
from .prepare import Prepared, Workspace
from .ruler import Gain, Trial

# Points of a scan along each axis by the number of shape parameters.
GRID = {1: 9, 2: 5, 3: 4}
# Evaluations of a refinement for each shape parameter; after how many it ends if it has
# less than a share of the best gain. Of 46 refinements that came near the best
# (battery, 52 cases of seed 2901; measured sets) the least had 0.58.
_EVALUATIONS, _FEW, BEHIND = 25, 8, 0.4


@dataclass(frozen=True)
class Proposal:
    """A law with free shape parameters at a site, or the same law at several sites."""

    law: ForceLaw
    sites: tuple[Site, ...]

    @property
    def name(self) -> str:
        """Law and sites in words."""
        return f"{self.law.name} at {', '.join(map(str, self.sites))}"


@dataclass(frozen=True)
class Effect:
    """An accepted law at a site; ``template`` has its shape parameters free.

    A fault of a sensor that no other channel of its DOF witnesses has no sure name: a
    bias of the fit looks alike.
    """

    law: ForceLaw
    site: Site
    template: ForceLaw
    witnessed: bool = True

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor."""
        return self.site.kind == "sensor"


@dataclass(frozen=True)
class State:
    """The current model: its effects, how it stands on the ruler, and the records,
    freed of faults.
    """

    trial: Trial
    effects: tuple[Effect, ...] = ()
    ready: Prepared | None = None


@dataclass
class Finding:
    """A proposal with shape parameters, on top of a state, and its gain over it."""

    proposal: Proposal
    laws: tuple[ForceLaw, ...]
    state: State
    screen: float
    gain: Gain | None = None
    after: State | None = None
    beyond_errors: Gain | None = (
        None  # over the same state, both freed of the errors that channels may have
    )
    chance: float | None = (
        # dB that the search gains where nothing is missing, if that speaks against it
        None
    )
    witnessed: bool = (
        False  # a fault of a sensor that another channel of its DOF contradicts
    )

    @property
    def size(self) -> tuple[int, int]:
        """Number of all parameters, and of those that are no coefficients."""
        coefficients, shapes = len(self.laws[0].terms()), len(self.laws[0].shapes)
        return len(self.laws) * (coefficients + shapes), len(self.laws) * shapes

    @property
    def is_fault(self) -> bool:
        """Whether it is the fault of a sensor."""
        return self.proposal.sites[0].kind == "sensor"

    @property
    def family(self) -> str:
        """Family of the law."""
        return self.proposal.law.family


class Axes:
    """Shape parameters of a law that have no value, in the coordinates of the search,
    at one or several sites.

    At several sites the law has the same point, in multiples of the motion of each.
    """

    def __init__(self, law: ForceLaw, work: Workspace, sites: Sequence[Site]) -> None:
        self.law, self.work = law, work
        self.shapes: list[Shape] = [p for p in law.shapes if law.shape[p.name] is None]
        self.scales = [
            ShapeScale(self.shapes, [work.scales(s)] * len(self.shapes), work.fastest)
            for s in sites
        ]
        self.low, self.high = self.scales[0].low, self.scales[0].high
        first = self.shapes[0] if len(self.shapes) == 1 else None
        self.of_frequency, self.instant = (
            first is not None and first.is_frequency,
            first is not None and first.instant,
        )
        # points along each axis; an instant is told to within a window
        self.count = WINDOWS if self.instant else GRID[min(len(self.shapes) or 1, 3)]

    def at(self, u: np.ndarray) -> tuple[ForceLaw, ...]:
        """The laws at a point of the search, one for each site."""
        u = np.clip(u, self.low, self.high)
        each = (scale.values(u - self.low + scale.low) for scale in self.scales)
        return tuple(
            self.law.with_values(
                shape={p.name: float(x) for p, x in zip(self.shapes, v)}
            )
            for v in each
        )

    def point(self, law: ForceLaw) -> np.ndarray:
        """The point of the search at which the law stands at the first site."""
        return self.scales[0].point(
            np.array([law.shape[p.name] for p in self.shapes], dtype=float)
        )

    def grid(self, lines: Sequence[float] = ()) -> list[np.ndarray]:
        """Points of the scan; spectral lines of the residual for a frequency.

        A third parameter starts at the lower end of its range, where its law is
        simplest.
        """
        if not self.shapes:
            return [np.zeros(0)]
        if self.of_frequency:
            points = self.scales[0].point(np.array(lines, dtype=float), 0)
            return [np.array([u]) for u in points if self.low[0] <= u <= self.high[0]]
        shares = [
            (np.arange(self.count) + 0.5) / self.count if i < 2 else [0.0]
            for i in range(len(self.shapes))
        ]
        return [
            self.low + np.array(p) * (self.high - self.low) for p in product(*shares)
        ]

    def refined(
        self,
        gain: Callable[[tuple[ForceLaw, ...]], float],
        start: np.ndarray,
        reach: float,
        least: float = -np.inf,
    ) -> np.ndarray:
        """The point of the largest gain near a start, roughly where it is less than
        ``least``.

        ``reach`` is a share of the spacing of the scan.
        """
        if not self.shapes:
            return start
        spacing = 0.002 if self.of_frequency else (self.high - self.low) / self.count
        if (
            self.instant
        ):  # the gain is narrow about an instant, and flat where it is held out
            near = np.clip(
                start + spacing * np.linspace(-1.5, 1.5, 31)[:, None],
                self.low,
                self.high,
            )
            start, spacing = max(near, key=lambda u: gain(self.at(u))), 0.1 * spacing
        step = reach * spacing * np.ones(len(start))
        away = np.where(start + step > self.high, -step, step)
        tried: list[float] = []

        def lost(u: np.ndarray) -> float:
            if len(tried) >= _FEW * len(start) and max(tried) < least:
                return 1e6  # no more is tried
            tried.append(gain(self.at(u)))
            return -max(tried[-1], -1e6)

        best = minimize(
            lost,
            start,
            method="Nelder-Mead",
            bounds=list(zip(self.low, self.high)),
            options={
                "initial_simplex": np.vstack([start, start + np.diag(away)]),
                "xatol": 1e-4,
                "fatol": 1e-4,
                "maxfev": _EVALUATIONS * len(start),
            },
        )
        found = np.clip(best.x, self.low, self.high)
        middle = np.mean(self.told(found), axis=0) if self.instant else found
        return (
            middle if gain(self.at(middle)) >= -best.fun - TENTH * LEAST_GAIN else found
        )

    def told(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends between which an instant lies: a window away, or two from a piece there
        that is not searched (taper).
        """
        work, record = self.work, self.work.searched[0]
        runs, seg, window = (
            work.runs(record),
            work.data.segments[record],
            (self.high - self.low) / self.count,
        )
        for one, other in zip(runs[:-1], runs[1:]):
            rows = [seg.valid.start + row for row in (one.stop, other.start)]
            low, high = (self.scales[0].point(np.asarray(seg.t)[[row]]) for row in rows)
            if low - window / 2 <= u <= high + window / 2:
                return low - 2 * window, high + 2 * window
        return u - window, u + window
