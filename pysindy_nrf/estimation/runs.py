"""The motion that a model makes by itself, in the place of the measured one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.segments import Segment
from ..signals.zero_phase_filter import FairFilter
from ..simulation.api import classical_run

STEADY = 1e-3  # damping ratio that every mode of an instrument has at least
COARSE = 0.25  # radians of the fastest mode in a sample above which one step of order 4 is not enough


def steady(model: ChainModel) -> ChainModel:
    """The model, damped in proportion to its stiffness where an estimated mode would grow or not decay."""
    M, C, K = model.matrices()
    values = _eigenvalues(M, C, K)
    if values is None or (-values.real >= STEADY * np.abs(values)).all():
        return model
    slowest = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(M, K))).min())
    if slowest == 0:
        return model
    laws = {}
    for site, held in model.laws.items():
        linear = model.restoring_forces[str(site)].linear_part()
        added = max(0.0, 2 * STEADY * abs(linear["k"]) / slowest - linear["c"])
        laws[site] = tuple(held)
        for i, law in enumerate(held):
            at = [k for k, term in enumerate(law.terms()) if term.label == "v"]
            if at:
                changed = law.values.copy()
                changed[at[0]] += added
                laws[site] = (*held[:i], law.with_values(coefficients=changed), *held[i + 1 :])
                break
    return ChainModel(model.masses, laws, model.chain, model.visited, model.info)


def _eigenvalues(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> np.ndarray | None:
    """Eigenvalues of the free linear structure, 1/s; None where it has none."""
    n = len(M)
    try:
        right = np.linalg.solve(M, np.hstack([K, C]))
        return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-right[:, :n], -right[:, n:]]]))
    except np.linalg.LinAlgError:  # no mass, or coefficients that are not finite
        return None


def fits_one_step(model: ChainModel, dt: float) -> bool:
    """Whether one classical Runge-Kutta step a sample of dt (s) integrates the model without shifting its modes."""
    if model.has_memory:
        return False
    # a step lowers a frequency w by (w dt)^4 / 120 of itself: 3e-5 at COARSE, but a thousandth at 0.6
    values = _eigenvalues(*model.matrices())
    return values is not None and bool(np.abs(values).max() * dt <= COARSE)


def run_of(
    model: ChainModel,
    segment: Segment,
    delay: int = 0,
    limited: bool = False,
    start: tuple | None = None,
    hold: str = "cubic",
) -> Segment:
    """Motion of a model under a record's forces, ``delay`` samples late, low-passed as the measured one if limited."""
    rows, dt = segment.valid, segment.step
    integrator = classical_run if fits_one_step(model, dt) else ChainModel.simulate
    record = free_run_of(model, segment, start=start, integrator=integrator, rtol=1e-5, hold=hold)
    shift = np.maximum(np.arange(rows.stop - rows.start) - delay, 0)
    smooth = None
    if limited and segment.resolved is not None and segment.resolved < 0.45 / dt:
        smooth = FairFilter((None, segment.resolved), 1.0 / dt)

    def place(values: np.ndarray) -> np.ndarray:
        """Into the rows of the record, NaN outside."""
        out = np.full((segment.n_samples, segment.n_dof), np.nan)
        out[rows] = (values if smooth is None else smooth.apply(values))[shift]
        return out

    a, v, x = (np.asarray(y) for y in (record.acceleration, record.velocity, record.displacement))
    v, s = (np.diff(y, axis=1, prepend=0.0) for y in (v, x))
    return replace(segment, a=place(a), v=place(v), s=place(s))


def likeness_of(segments: Sequence[Segment], runs: Sequence[Segment]) -> float:
    """Correlation of simulated and measured accelerations, every DOF with equal weight."""
    both = own = other = 0.0
    for segment, run in zip(segments, runs):
        a, b = segment.a[segment.valid].astype(float), run.a[run.valid]
        scale = np.mean(a**2, axis=0)
        scale[scale == 0] = 1.0
        both, own, other = both + (a * b / scale).sum(), own + (a * a / scale).sum(), other + (b * b / scale).sum()
    with np.errstate(invalid="ignore", over="ignore"):
        likeness = both / np.sqrt(own * other)
    return float(likeness) if np.isfinite(likeness) else 0.0
