"""Variable projection over laws x sites x shape parameters.

Linear coefficients are eliminated on Gram matrices; shape parameters are scanned, all points of a law
at once, then refined by a bounded simplex. Everything here sees search blocks only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ..exceptions import NRFError
from ..laws.base import ForceLaw
from ..laws.shape import Shape, ShapeScale
from ..mechanics.sites import Site
from .catalogue import Candidate
from .stage import Stage
from .workspace import Workspace

# Points of the scan along each of the first two axes, by the number of shape parameters; a further
# parameter starts at the lower end of its range, where its law is simplest, and is left to the refinement.
_GRID = {1: 9, 2: 5, 3: 4}
_EVALUATIONS = {1: 24, 2: 60, 3: 110}
# A law with more shape parameters than this is only tried where a simpler one comes near the best.
_SIMPLE = 2
_NEAR = 1.3


@dataclass
class Finding:
    """A candidate with its shape parameters, and how well it does.

    Attributes
    ----------
    candidate : Candidate
    law : ForceLaw
        With shape parameters.
    screen : float
        Pooled balance error on the search blocks it was fitted to, percent.
    drop : tuple of (Site, int)
        Laws of the current model that it replaces.
    folds : ndarray of shape (n_blocks,)
        Pooled balance error on each search block after fitting to the others, percent.
    n_freed : int
        Coefficients and shape parameters of the laws that it replaces.
    around : mapping of Site to tuple of ForceLaw, optional
        The current laws with their shape parameters estimated again beside this one.
    """

    candidate: Candidate
    law: ForceLaw
    screen: float
    drop: tuple[tuple[Site, int], ...] = ()
    folds: np.ndarray = field(default_factory=lambda: np.zeros(0))
    n_freed: int = 0
    around: Mapping[Site, tuple[ForceLaw, ...]] | None = None

    @property
    def site(self) -> Site:
        """Where it acts."""
        return self.candidate.site

    @property
    def n_parameters(self) -> int:
        """Coefficients and shape parameters."""
        return parameters_of(self.law)

    @property
    def n_added(self) -> int:
        """How many more of them the model has with it."""
        return self.n_parameters - self.n_freed

    @property
    def error(self) -> float:
        """Median over the search blocks, percent."""
        return float(np.median(self.folds))

    def under(self, stage: Stage) -> Stage:
        """The current laws as they stand beside this one."""
        return stage if self.around is None else Stage(stage.work, stage.chain, self.around)

    def on(self, stage: Stage) -> Stage:
        """The current laws with this one."""
        return self.under(stage).with_law(self.site, self.law, self.drop)


def parameters_of(law: ForceLaw) -> int:
    """Number of coefficients and shape parameters of a law."""
    return len(law.terms()) + len(law.shapes)


class Axes:
    """Shape parameters of a law that have no value, in the coordinates of the search."""

    def __init__(self, law: ForceLaw, work: Workspace, site: Site) -> None:
        self.law = law
        self.shapes: list[Shape] = [p for p in law.shapes if law.shape[p.name] is None]
        self.scale = ShapeScale(self.shapes, [work.scales(site)] * len(self.shapes), work.fastest)
        self.log, self.low, self.high = self.scale.log, self.scale.low, self.scale.high

    @property
    def ends(self) -> tuple[float, float]:
        """Bounds of the first shape parameter."""
        return float(self.low[0]), float(self.high[0])

    def values(self, u: np.ndarray) -> np.ndarray:
        """Shape parameters at a point of the search, SI units."""
        return self.scale.values(u)

    def point(self, law: ForceLaw) -> np.ndarray:
        """The point of the search at which a law stands."""
        return self.scale.point(np.array([law.shape[p.name] for p in self.shapes], dtype=float))

    def at(self, u: np.ndarray) -> ForceLaw:
        """The law with shape parameters at a point of the search."""
        values = self.values(np.clip(u, self.low, self.high))
        return self.law.with_values(shape={p.name: float(x) for p, x in zip(self.shapes, values)})

    def grid(self, lines: Sequence[float] = ()) -> Iterable[np.ndarray]:
        """Points of the scan; spectral lines of the residual for a frequency."""
        if not self.shapes:
            return [np.zeros(0)]
        if len(self.shapes) == 1 and self.shapes[0].is_frequency:
            points = self.scale.point(np.array(lines, dtype=float), 0)
            return [np.array([u]) for u in points if self.low[0] <= u <= self.high[0]]
        count = _GRID.get(len(self.shapes), 4)
        shares = [(np.arange(count) + 0.5) / count if i < 2 else [0.0] for i in range(len(self.shapes))]
        return [self.low + np.array(p) * (self.high - self.low) for p in product(*shares)]

    def step(self, lines: bool) -> np.ndarray:
        """Spacing of the scan."""
        if lines:
            return np.full(1, 0.002)
        return (self.high - self.low) / _GRID.get(len(self.shapes), 4)


def replaced(stage: Stage, candidate: Candidate, accepted: Sequence[tuple[Site, str]]) -> tuple[tuple[Site, int], ...]:
    """Accepted laws that share a column with a candidate at its site, or explain the same: it takes their place."""
    left = Counter(name for site, name in accepted if site == candidate.site)
    out = []
    for i, law in reversed(list(enumerate(stage.laws.get(candidate.site, ())))):
        if not left[law.name]:
            continue
        left[law.name] -= 1
        if _share_a_label(law, candidate.law) or (law.family == candidate.law.family and not candidate.law.superposes):
            out.append((candidate.site, i))
    return tuple(reversed(out))


def beside(stage: Stage, candidate: Candidate, drop: Sequence[tuple[Site, int]]) -> tuple[tuple[Site, int], ...]:
    """Those of the laws whose place a candidate could take that cannot stand beside it."""
    return tuple((site, i) for site, i in drop if excludes(stage.laws[site][i], candidate.law))


def excludes(one: ForceLaw, other: ForceLaw) -> bool:
    """Whether two laws cannot stand beside each other at one site."""
    if one.contains(other) or other.contains(one):
        return True
    return _share_a_label(one, other) and not (one.name == other.name and one.shapes)


def _share_a_label(one: ForceLaw, other: ForceLaw) -> bool:
    return not {t.label for t in one.terms()}.isdisjoint(t.label for t in other.terms())


def screen(
    stage: Stage,
    candidates: Iterable[Candidate],
    accepted: Sequence[tuple[Site, str]] = (),
    lines: dict[Site, list[float]] | None = None,
    progress: Callable[[], Any] | None = None,
    both: bool = False,
) -> list[Finding]:
    """Scan every candidate over the grid of its shape parameters."""
    candidates = list(candidates)
    simple = [c for c in candidates if len(c.law.free_shape) <= _SIMPLE]
    found = _scan(stage, simple, accepted, lines, progress, both)
    now = stage.trial().search_error()
    best = min((f.screen for f in found), default=now)
    near = {f.site for f in found if f.screen <= _NEAR * best} if best < now * 0.95 else {c.site for c in candidates}
    rich = [c for c in candidates if len(c.law.free_shape) > _SIMPLE]
    found += _scan(stage, [c for c in rich if c.site in near], accepted, lines, progress, both)
    return sorted(found, key=lambda f: f.screen)


def grid_of(stage: Stage, candidate: Candidate, lines: Sequence[float] = ()) -> list[ForceLaw]:
    """The law of a candidate with the values of its shape parameters that a scan tries."""
    axes = Axes(candidate.law, stage.work, candidate.site)
    return [axes.at(u) for u in axes.grid(lines)]


def _scan(
    stage: Stage,
    candidates: Iterable[Candidate],
    accepted: Sequence[tuple[Site, str]],
    lines: dict[Site, list[float]] | None,
    progress: Callable[[], Any] | None,
    both: bool,
) -> list[Finding]:
    found = []
    for candidate in candidates:
        if progress is not None:
            progress()
        drop = replaced(stage, candidate, accepted)
        points = grid_of(stage, candidate, (lines or {}).get(candidate.site, ()))
        if not points:
            continue
        for out in dict.fromkeys([drop, beside(stage, candidate, drop)] if both else [drop]):
            try:
                errors = stage.slot(candidate.site, candidate.law, out).errors(points, keep=True)
            except NRFError:
                continue
            best = int(np.argmin(errors))
            if np.isfinite(errors[best]):
                freed = sum(parameters_of(stage.laws[site][i]) for site, i in out)
                found.append(Finding(candidate, points[best], float(errors[best]), out, n_freed=freed))
    return found


def refine(stage: Stage, finding: Finding, evaluations: int | None = None, reach: float = 0.5) -> Finding:
    """Refine the shape parameters of a candidate."""
    axes = Axes(finding.candidate.law, stage.work, finding.site)
    if not axes.shapes:
        return finding
    start = axes.point(finding.law)
    step = reach * axes.step(axes.shapes[0].is_frequency)
    slot = finding.under(stage).slot(finding.site, finding.candidate.law, finding.drop)

    def cost(u: np.ndarray) -> float:
        return min(float(slot.errors([axes.at(u)])[0]), 1e6)

    away = np.where(start + step > axes.high, -step, step)
    simplex = np.vstack([start, start + np.diag(away)])
    most = evaluations or _EVALUATIONS.get(len(start), 160)
    best = minimize(
        cost,
        start,
        method="Nelder-Mead",
        bounds=list(zip(axes.low, axes.high)),
        options={"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-9, "maxfev": most},
    )
    point, error = (best.x, float(best.fun)) if best.fun < finding.screen else (start, finding.screen)
    if len(point) == 1:
        point = np.array([np.mean(plateau(lambda u: cost(np.array([u])), float(point[0]), *axes.ends))])
    elif point is start:
        return finding
    return replace(finding, law=axes.at(point), screen=error, folds=np.zeros(0))


def plateau(
    cost: Callable[[float], float], best: float, low: float, high: float, slack: float = 1e-9
) -> tuple[float, float]:
    """Between which values a shape parameter can be moved without a change of the error."""
    enough = cost(best) * (1 + slack)
    ends = []
    for bound in (low, high):
        inside, outside, step = best, bound, 1e-3 * (bound - best)
        while step and abs(step) < abs(bound - best):
            if cost(best + step) > enough:
                outside = best + step
                break
            inside, step = best + step, 2.0 * step
        else:
            if cost(bound) <= enough:
                inside = bound
        for _ in range(8 if inside != best or slack > 1e-6 else 0):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if cost(middle) <= enough else (inside, middle)
        ends.append(inside)
    return ends[0], ends[1]


def validate(stage: Stage, finding: Finding) -> Finding:
    """Judge a candidate on each search block after fitting to the others."""
    try:
        folds = finding.under(stage).slot(finding.site, finding.candidate.law, finding.drop).folds(finding.law)
    except NRFError:
        folds = np.full(len(stage.work.search), np.inf)
    return replace(finding, folds=folds)
