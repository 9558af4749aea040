"""Variable projection over laws x sites x shape parameters.

Linear coefficients are eliminated on Gram matrices; shape parameters are scanned, then refined by
a bounded simplex. Everything here sees search blocks only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from scipy.optimize import minimize

from ..exceptions import NRFError
from ..laws.base import ForceLaw, Shape
from ..sites import Site
from .admissible import admissible
from .catalogue import Candidate
from .workspace import Stage, Trial

# Points of the scan along each of the first two axes, by the number of shape parameters; a further
# parameter starts a quarter of the way up its range and is left to the refinement.
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
    """

    candidate: Candidate
    law: ForceLaw
    screen: float
    drop: tuple[tuple[Site, int], ...] = ()
    folds: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def site(self) -> Site:
        """Where it acts."""
        return self.candidate.site

    @property
    def n_parameters(self) -> int:
        """Coefficients and shape parameters."""
        return len(self.law.terms()) + len(self.law.shapes)

    @property
    def error(self) -> float:
        """Median over the search blocks, percent."""
        return float(np.median(self.folds))

    def trial(self, stage: Stage) -> Trial:
        """The current laws with this one."""
        return stage.trial(self.site, self.law, self.drop)


class _Axes:
    """Shape parameters of a law in the coordinates of the search: logarithms where the scale is one."""

    def __init__(self, law: ForceLaw, scales: tuple[float, float, float]) -> None:
        self.law = law
        self.shapes: list[Shape] = [p for p in law.shapes if law.shape[p.name] is None]
        bounds = np.array([p.bounds(*scales) for p in self.shapes]).reshape(-1, 2)
        self.log = np.array([p.log for p in self.shapes], dtype=bool)
        self.low, self.high = (
            (np.where(self.log, np.log(np.where(self.log, b, 1.0)), b) for b in bounds.T)
            if len(bounds)
            else (np.zeros(0),) * 2
        )

    def at(self, u: np.ndarray) -> ForceLaw:
        """The law with shape parameters at a point of the search."""
        u = np.clip(u, self.low, self.high)
        values = np.where(self.log, np.exp(np.where(self.log, u, 0.0)), u)
        return self.law.with_values(shape={p.name: float(x) for p, x in zip(self.shapes, values)})

    def grid(self, lines: Sequence[float] = ()) -> Iterable[np.ndarray]:
        """Points of the scan; spectral lines of the residual for a frequency."""
        if not self.shapes:
            return [np.zeros(0)]
        if len(self.shapes) == 1 and self.shapes[0].name == "frequency":
            return [np.array([np.log(f)]) for f in lines if np.log(f) >= self.low[0]]
        count = _GRID.get(len(self.shapes), 4)
        shares = [(np.arange(count) + 0.5) / count if i < 2 else [0.25] for i in range(len(self.shapes))]
        return [self.low + np.array(p) * (self.high - self.low) for p in product(*shares)]

    def step(self, lines: bool) -> np.ndarray:
        """Spacing of the scan."""
        if lines:
            return np.full(1, 0.002)
        return (self.high - self.low) / _GRID.get(len(self.shapes), 4)


def replaced(stage: Stage, candidate: Candidate, accepted: Sequence[tuple[Site, str]]) -> tuple[tuple[Site, int], ...]:
    """Accepted laws that share a column with a candidate at its site: it takes their place.

    Parameters
    ----------
    stage : Stage
    candidate : Candidate
    accepted : sequence of (Site, str)
        Sites and names of the laws the loop has added.

    Returns
    -------
    tuple of (Site, int)
    """
    labels = {t.label for t in candidate.law.terms()}
    return tuple(
        (candidate.site, i)
        for i, law in enumerate(stage.laws.get(candidate.site, ()))
        if (candidate.site, law.name) in accepted
        and (labels & {t.label for t in law.terms()} or law.family == candidate.law.family)
    )


def spectral_lines(residual: np.ndarray, dt: float, most: int = 3) -> list[float]:
    """Frequencies at which a residual has its highest peaks, Hz, by the periodogram of a Hann window.

    Parameters
    ----------
    residual : ndarray of shape (n_samples,)
    dt : float
        s.
    most : int

    Returns
    -------
    list of float
    """
    from scipy.signal import find_peaks

    n = len(residual)
    size = 4 * n
    power = np.abs(np.fft.rfft(residual * np.hanning(n), size)) ** 2
    peaks, _ = find_peaks(power, distance=8)
    best = peaks[np.argsort(-power[peaks])][:most]
    return [float(k / (size * dt)) for k in best if k > 0]


def screen(
    stage: Stage,
    candidates: Iterable[Candidate],
    accepted: Sequence[tuple[Site, str]] = (),
    lines: dict[Site, list[float]] | None = None,
    progress=None,
) -> list[Finding]:
    """Scan every candidate over the grid of its shape parameters.

    Parameters
    ----------
    stage : Stage
    candidates : iterable of Candidate
    accepted : sequence of (Site, str)
    lines : dict of Site to list of float, optional
        Spectral lines of the residual of each DOF, Hz.
    progress : callable, optional
        Called once for each candidate.

    Returns
    -------
    list of Finding
        The best point of each candidate that can be identified, best first.
    """
    candidates = list(candidates)
    simple = [c for c in candidates if len(c.law.free_shape) <= _SIMPLE]
    found = _scan(stage, simple, accepted, lines, progress)
    now = stage.trial().search_error()
    best = min((f.screen for f in found), default=now)
    near = {f.site for f in found if f.screen <= _NEAR * best} if best < now * 0.95 else {c.site for c in candidates}
    rich = [c for c in candidates if len(c.law.free_shape) > _SIMPLE]
    found += _scan(stage, [c for c in rich if c.site in near], accepted, lines, progress)
    return sorted(found, key=lambda f: f.screen)


def _scan(stage: Stage, candidates: Iterable[Candidate], accepted, lines, progress) -> list[Finding]:
    found = []
    for candidate in candidates:
        if progress is not None:
            progress()
        axes = _Axes(candidate.law, stage.work.scales(candidate.site))
        drop = replaced(stage, candidate, accepted)
        best: Finding | None = None
        for point in axes.grid((lines or {}).get(candidate.site, ())):
            law = axes.at(point)
            error = _cost(stage, candidate.site, law, drop)
            if np.isfinite(error) and (best is None or error < best.screen):
                best = Finding(candidate, law, error, drop)
        if best is not None:
            found.append(best)
    return found


def _cost(stage: Stage, site: Site, law: ForceLaw, drop: Sequence[tuple[Site, int]]) -> float:
    """Pooled error of the laws with a candidate, percent; infinite where it cannot be told or cannot be."""
    try:
        trial = stage.trial(site, law, drop)
        error, solution = trial.search_fit()
    except NRFError:
        return np.inf
    width = len(law.terms())
    where = trial.layout.slices[site]
    mine = slice(where.stop - width, where.stop)
    squares = trial.grams[: len(stage.work.search), range(mine.start, mine.stop), range(mine.start, mine.stop)].sum(
        axis=0
    )
    if not np.isfinite(error) or not admissible(law, solution.coefficients[site][-width:], np.sqrt(squares)):
        return np.inf
    return error


def refine(stage: Stage, finding: Finding, evaluations: int | None = None) -> Finding:
    """Refine the shape parameters of a candidate.

    Parameters
    ----------
    stage : Stage
    finding : Finding
    evaluations : int, optional
        At most so many trials.

    Returns
    -------
    Finding
    """
    axes = _Axes(finding.candidate.law, stage.work.scales(finding.site))
    if not axes.shapes:
        return finding
    values = np.array([finding.law.shape[p.name] for p in axes.shapes], dtype=float)
    start = np.where(axes.log, np.log(np.where(axes.log, values, 1.0)), values)
    step = 0.5 * axes.step(axes.shapes[0].name == "frequency")

    def cost(u: np.ndarray) -> float:
        return min(_cost(stage, finding.site, axes.at(u), finding.drop), 1e6)

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
    if best.fun < finding.screen:
        return Finding(finding.candidate, axes.at(best.x), float(best.fun), finding.drop)
    return finding


def validate(stage: Stage, finding: Finding) -> Finding:
    """Judge a candidate on each search block after fitting to the others.

    Parameters
    ----------
    stage : Stage
    finding : Finding

    Returns
    -------
    Finding
        With ``folds``; infinite where a block cannot be judged.
    """
    try:
        folds = finding.trial(stage).fold_errors()
    except NRFError:
        folds = np.full(len(stage.work.search), np.inf)
    return Finding(finding.candidate, finding.law, finding.screen, finding.drop, folds)
