r"""Output-error refinement: the free run itself is fitted to the measured motion.

.. math:: \min_\theta \sum_t \sum_c \left(\frac{A_c (y_c(t) - \hat y_c(t; \theta))}{\sigma_c}\right)^2

where A_c whitens the residual of the starting model (an autoregression): noise of the force rings in
the structure's own frequencies, and unwhitened least squares fits that ringing. The free run :math:`\hat y` goes
under the measured force, each record one shot whose initial condition is found with the parameters. It is started from
instrumental variables and kept only if it predicts the last part of the records, which it did not see,
better than they do.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..exceptions import BiasWarning, SimulationError
from ..model import ChainModel
from ..segments import Segment, SegmentSet
from .iv import free_run_of

TRAINED = 0.75  # share of each record that the refinement sees before it is judged on the rest
EVALUATIONS = 12
ORDER = 60  # past residuals that predict the present one
_LOST = 1e3


@dataclass
class OutputErrorResult:
    """What the refinement did.

    Attributes
    ----------
    model : ChainModel
    kept : bool
        Whether the refined model is better on the judged part than the one it started from.
    error_before, error_after : float
        Free-run error on the judged part, percent NRMSE of all motions.
    """

    model: ChainModel
    kept: bool
    error_before: float
    error_after: float


@dataclass
class Shot:
    """One record and where its free run starts.

    Attributes
    ----------
    segment : Segment
        What is fitted.
    filter : FairFilter or None
    start : ndarray of shape (2, n_dof)
        Displacement and velocity relative to the base.
    judged : slice
        Valid rows, counted from the first, in which the error is taken.
    """

    segment: Segment
    filter: Any
    start: np.ndarray
    judged: slice = field(default_factory=lambda: slice(None))

    @cached_property
    def motion(self) -> np.ndarray:
        """Measured a, xdot, x of the DOFs, shape (n_valid_rows, 3 n_dof)."""
        return self._of(self.segment)

    def gap(self, model: ChainModel, start: np.ndarray | None = None) -> np.ndarray:
        """Free run less measured motion in the judged rows."""
        run = free_run_of(model, self.segment, start=tuple(self.start if start is None else start))
        return (self._of(run) - self.motion)[self.judged]

    def _of(self, segment: Segment) -> np.ndarray:
        rows = segment.valid
        # of the DOFs, not of the storeys: the noise of neighbouring drifts is not independent
        motion = np.hstack([segment.a[rows], *(np.cumsum(y[rows], axis=1) for y in (segment.v, segment.s))]).astype(
            float
        )
        return motion if self.filter is None else self.filter.apply(motion)


def output_error(
    start: ChainModel,
    data: SegmentSet,
    filters: Sequence[Any],
    known_masses: Mapping[int, float],
    raw: SegmentSet | None = None,
) -> OutputErrorResult:
    """Refine masses and coefficients on the free run.

    Parameters
    ----------
    start : ChainModel
        From instrumental variables.
    data : SegmentSet
        Fused motions; they give the first guess of the initial conditions.
    filters : sequence of FairFilter or None
    known_masses : mapping of int to float
        These are held.
    raw : SegmentSet, optional
        The channels as measured, on the same rows: white noise, which suits least squares better.

    Returns
    -------
    OutputErrorResult
    """
    shots, early, late = [], [], []
    for fused, seg, filter in zip(data.segments, (raw or data).segments, filters):
        if np.isnan(seg.F[seg.valid.start]).any():
            continue
        first = np.array([np.cumsum(y[seg.valid.start].astype(float)) for y in (fused.s, fused.v)])
        cut = int(TRAINED * (seg.valid.stop - seg.valid.start))
        shots.append(Shot(seg, filter, first))
        early.append(Shot(replace(seg, valid=slice(seg.valid.start, seg.valid.start + cut)), filter, first))
        late.append(Shot(seg, filter, first, slice(cut, None)))
    before = _error(start, late) if shots else np.inf
    if not np.isfinite(before):
        why = "a free run diverges" if shots else "the force on some DOF is unknown in every record"
        warnings.warn(
            f"estimation='simulation' kept the instrumental-variable estimate: {why}.", BiasWarning, stacklevel=5
        )
        return OutputErrorResult(start, False, before, before)
    refined = _refined(start, early, known_masses)
    after = _error(refined, late)
    if not after < before:
        return OutputErrorResult(start, False, before, after)
    return OutputErrorResult(_refined(refined, shots, known_masses, start), True, before, after)


def _refined(
    start: ChainModel, shots: list[Shot], known: Mapping[int, float], coloured: ChainModel | None = None
) -> ChainModel:
    """Levenberg-Marquardt on parameters and initial conditions together.

    The residual is whitened as that of ``coloured`` (of ``start`` if None), which holds the force noise's ringing.
    """
    from scipy.optimize import least_squares
    from scipy.signal import lfilter

    x0, rebuild = _vector(start, known)
    gaps = [shot.gap(coloured or start) for shot in shots]
    colour = [_prediction(np.concatenate([g[:, c] for g in gaps])) for c in range(gaps[0].shape[1])]

    def whitened(gap: np.ndarray) -> np.ndarray:
        return np.column_stack([lfilter(colour[c], 1.0, gap[:, c]) for c in range(gap.shape[1])])

    gaps = [whitened(g) for g in gaps]
    sizes = [np.sqrt(np.mean(shot.motion**2, axis=0)) for shot in shots]
    noise = [np.maximum(np.sqrt(np.mean(g**2, axis=0)), 1e-9 * s + 1e-300) for g, s in zip(gaps, sizes)]
    n = start.n_dof
    units = [np.array([s[2 * n :], s[n : 2 * n]]) + 1e-300 for s in sizes]  # of the initial conditions
    size = sum(g.size for g in gaps)
    p = len(x0)

    def residual(q: np.ndarray) -> np.ndarray:
        model, ends = rebuild(x0 * q[:p]), np.split(q[p:], len(shots))
        try:
            out = [
                whitened(shot.gap(model, shot.start + unit * end.reshape(2, n))) / level
                for shot, unit, end, level in zip(shots, units, ends, noise)
            ]
        except SimulationError:
            return np.full(size, _LOST)
        return np.concatenate([r.ravel() for r in out])

    q = np.concatenate([np.ones(p), np.zeros(2 * n * len(shots))])
    best = least_squares(
        residual, q, method="trf", x_scale="jac", diff_step=1e-5, max_nfev=EVALUATIONS, ftol=1e-8, xtol=1e-10,
    )  # fmt: skip
    return rebuild(x0 * best.x[:p])


def _prediction(gap: np.ndarray, order: int = ORDER) -> np.ndarray:
    """Filter from a channel's residual to what its own past does not predict (autoregression, Yule-Walker)."""
    from scipy.linalg import solve_toeplitz
    from scipy.signal import correlate

    order = min(order, len(gap) // 10)
    if order < 1 or not gap.any():
        return np.ones(1)
    r = correlate(gap, gap, method="fft")[len(gap) - 1 :][: order + 1] / (gap @ gap)
    r[0] *= 1 + 1e-9
    return np.concatenate([[1.0], -solve_toeplitz(r[:-1], r[1:])])


def _vector(model: ChainModel, known: Mapping[int, float]):
    """Free parameters as a vector, and the way back. Terms that are zero stay zero."""
    free = [j for j in range(model.n_dof) if j + 1 not in known]
    held = [
        (site, i, k)
        for site, laws in model.laws.items()
        for i, law in enumerate(laws)
        for k, c in enumerate(law.coefficients)
        if c
    ]
    x0 = np.array([*model.masses[free], *(model.laws[s][i].coefficients[k] for s, i, k in held)])

    def rebuild(x: np.ndarray) -> ChainModel:
        masses = model.masses.copy()
        masses[free] = x[: len(free)]
        values = {s: [law.coefficients.copy() for law in laws] for s, laws in model.laws.items()}
        for (site, i, k), value in zip(held, x[len(free) :]):
            values[site][i][k] = value
        laws = {
            s: tuple(law.with_values(coefficients=c) for law, c in zip(model.laws[s], values[s])) for s in model.laws
        }
        return ChainModel(masses, laws, model.chain, model.visited, model.info)

    return x0, rebuild


def _error(model: ChainModel, shots: list[Shot]) -> float:
    """Percent NRMSE of all motions in the judged rows; infinite where a run diverges."""
    top = bottom = 0.0
    for shot in shots:
        try:
            gap = shot.gap(model)
        except SimulationError:
            return np.inf
        size = np.mean(shot.motion**2, axis=0)
        size[size == 0] = 1.0
        top, bottom = top + (gap**2 / size).sum(), bottom + (shot.motion[shot.judged] ** 2 / size).sum()
    return float(100 * np.sqrt(top / bottom)) if np.isfinite(top) else np.inf
