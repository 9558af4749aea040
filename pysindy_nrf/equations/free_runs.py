"""Free runs of a model along measured records, and their errors."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Unpack

import numpy as np

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..exceptions import DivergenceError, NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter
from ..simulation.api import RunOptions, simulate

# Times the largest measured displacement beyond which a run diverges.
DIVERGED = 100.0
# Shorter blocks have no free run.
SHORTEST_RUN = 8


class RunSettings(RunOptions, total=False):
    """Options of a free run, and its method."""

    method: str


def free_run_of(
    model: ChainModel,
    segment: Segment,
    rows: slice | None = None,
    dt: float | None = None,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    integrator: Callable[..., Record] = simulate,
    **options: Unpack[RunSettings],
) -> Record:
    """The model alone under the forces and base motion of some rows of a record.

    It starts from the measured state of the first row, or from ``start``:
    displacements (m) and velocities (m/s) relative to the base. Laws start from the
    states that the measured motion before gives them. Between the samples the forces
    take the course of the record, unless ``hold`` says another.
    """
    options.setdefault("hold", segment.course)
    chosen = segment.valid if rows is None else rows
    options.setdefault("states", states_in(model, segment, chosen.start))
    if start is None:
        x0 = np.cumsum(segment.s[chosen.start].astype(float))
        v0 = np.cumsum(segment.v[chosen.start].astype(float))
    else:
        x0, v0 = start
    # on the clock that the laws read
    t0 = 0.0 if segment.t is None else float(segment.t[chosen.start])
    covariates = {name: line[chosen] for name, line in segment.covariates.items()}
    return integrator(
        model,
        segment.driving_force[chosen],
        segment.step if dt is None else dt,
        x0=x0,
        v0=v0,
        t0=t0,
        base_acceleration=None if segment.ag is None else segment.ag[chosen],
        covariates=covariates or None,
        **options,
    )


def states_in(
    model: ChainModel, segment: Segment, row: int
) -> dict[tuple[Site, int], np.ndarray]:
    """States of laws with memory in a row, after the measured motion before it.

    They are zero in the first row of the record.
    """
    states = {}
    rows = slice(segment.first_row, row + 1)
    for site, group in model.laws.items():
        for number, law in enumerate(group):
            if law.has_memory:
                state = np.zeros(law.n_states)
                if row > segment.first_row:
                    law.features(segment.motion(site, rows), state)
                states[site, number] = state
    return states


class EitherRun(NamedTuple):
    """A free run, and how the default method fared.

    Attributes
    ----------
    record : Record
    by_newmark : bool
        Whether Newmark's method computed it, because the default one failed.
    diverges : bool
        Whether the default one failed because the motion grew beyond its limit.
    """

    record: Record
    by_newmark: bool = False
    diverges: bool = False


def free_run_by_either(
    model: ChainModel, segment: Segment, rows: slice, dt: float | None = None
) -> EitherRun:
    """The free run, by Newmark's method where that of variable steps fails.

    It also fails where it exceeds a hundred times the measured motion. A record that
    was computed by Newmark's method is followed by it.
    """
    x = np.cumsum(segment.s[rows], axis=1)
    limit = DIVERGED * float(np.abs(x).max()) or 1e100
    method = segment.simulation_method
    diverges = False
    try:
        run = free_run_of(model, segment, rows, dt, limit=limit, method=method)
        if np.isfinite(np.asarray(run.displacement, dtype=float)).all():
            return EitherRun(run)
    except DivergenceError:
        diverges = True
    except NRFError:
        # it takes too many steps, say
        pass
    run = free_run_of(model, segment, rows, dt, method="newmark")
    return EitherRun(run, by_newmark=True, diverges=diverges)


def squares_of(
    run: Record, segment: Segment, rows: slice, filter: ZeroPhaseFilter | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares by DOF of a run's error and of the measured displacement."""
    x = np.cumsum(segment.s[rows], axis=1)
    error = run.displacement - x
    if filter is not None:
        error, x = filter.apply(error), filter.apply(x)
    return (error**2).sum(axis=0), (x**2).sum(axis=0)


def free_run_error(
    model: ChainModel,
    data: Dataset,
    filters: Sequence[ZeroPhaseFilter | None],
    blocks: Sequence[BlockRows],
) -> float:
    """Error of the displacements of free runs over some blocks, percent NRMSE.

    NaN where there is no run.
    """
    if (model.masses <= 0).any():
        return float("nan")

    errors = np.zeros(model.n_dof)
    motions = np.zeros(model.n_dof)
    for block in blocks:
        segment = data.segments[block.segment]
        first = segment.valid.start
        rows = slice(first + block.rows.start, first + block.rows.stop)
        run = _run_over(model, segment, rows)
        if run is None:
            return float("nan")
        error, motion = squares_of(run, segment, rows, filters[block.segment])
        errors += error
        motions += motion
    if not (motions > 0).all():
        return float("nan")
    return float(100.0 * np.sqrt(np.mean(errors / motions)))


def _run_over(model: ChainModel, segment: Segment, rows: slice) -> Record | None:
    """A free run over some rows, or None."""
    too_short = rows.stop - rows.start < SHORTEST_RUN
    if segment.dt is None or too_short or np.isnan(segment.F[rows.start]).any():
        return None
    try:
        return free_run_of(model, segment, rows, method=segment.simulation_method)
    except NRFError:
        return None
