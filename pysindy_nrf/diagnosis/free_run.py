"""Free runs of a model over its records: the model alone under the measured forces."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..common.unit_system import TRANSLATION, UnitSystem
from ..equations.errors import squares_of
from ..equations.free_runs import EitherRun, free_run_by_either
from ..exceptions import NRFError
from ..records.dataset import Dataset, Segment
from ..records.record import Record
from ..records.zero_phase_filter import ZeroPhaseFilter

Channel = Literal["displacement", "acceleration"]


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Free runs of a model, and how far they miss the measured motion.

    Parameters
    ----------
    table : DataFrame
        Percent NRMSE by record (rows) and DOF (columns); empty without a run.
    runs : list of (Segment, Record)
        The motion that was measured, and that of the model.
    why_not : str
        Why a run is missing.
    failed : bool
        Whether a run was tried and came to no end.
    by_newmark : bool
        Whether the default method failed and Newmark's computed a run.
    diverges_by_default : bool
        Whether it failed because the motion grew beyond all measure.
    units : UnitSystem
        Of the model.
    spread : float
        Percent of the measured motion by which models of halves of the data deviate
        from the model, as errors of the parameters move its run; NaN if not tried.
    """

    table: pd.DataFrame
    runs: list[tuple[Segment, Record]] = field(default_factory=list)
    why_not: str = ""
    failed: bool = False
    by_newmark: bool = False
    diverges_by_default: bool = False
    units: UnitSystem = TRANSLATION
    spread: float = float("nan")

    @property
    def error(self) -> float:
        """Percent NRMSE of all records and DOFs; NaN without a run."""
        if self.table.empty:
            return float("nan")
        return float(np.sqrt(np.mean(np.square(self.table.to_numpy()))))


def free_runs(
    model: ChainModel,
    data: Dataset,
    filters: Sequence[ZeroPhaseFilter | None] | None = None,
    dt: float | None = None,
    beside: Sequence[ChainModel] = (),
) -> FreeRuns:
    """Run a model alone under the measured force of every record.

    Parameters
    ----------
    model : ChainModel
    data : Dataset
        Each run starts from the first measured state of a record.
    filters : sequence of ZeroPhaseFilter or None, optional
        Of each record; measured and free motion pass it before they are compared.
    dt : float, optional
        Sampling step, s, where the records do not know theirs.
    beside : sequence of ChainModel
        Models of halves of the data, which run as well.

    Returns
    -------
    FreeRuns
    """
    if (model.masses <= 0).any():
        why_not = "a mass is not positive, as that of an element by itself"
        return FreeRuns(pd.DataFrame(), why_not=why_not)

    runs: list[tuple[Segment, Record]] = []
    tried: list[EitherRun] = []
    errors: dict[str, np.ndarray] = {}
    spreads: list[float] = []
    why_not, failed = "", False
    for segment, band in zip(data.segments, filters or [None] * len(data.segments)):
        obstacle = _obstacle(segment, dt)
        if obstacle:
            why_not = obstacle
            continue
        try:
            either = free_run_by_either(model, segment, segment.valid, dt)
        except NRFError as error:
            why_not, failed = str(error), True
            continue

        missed, moved = _squares(either.record, segment, band)
        tried.append(either)
        runs.append((segment, either.record))
        errors[_free_name(segment.name, errors)] = 100.0 * np.sqrt(missed / moved)
        spreads.append(_spread(beside, either.record, segment, band, dt))

    columns = [f"x{j + 1}" for j in range(model.n_dof)]
    table = pd.DataFrame.from_dict(errors, orient="index", columns=columns)
    by_newmark = any(either.by_newmark for either in tried)
    diverges = any(either.diverges for either in tried)
    spread = max(spreads, default=float("nan"))
    return FreeRuns(
        table, runs, why_not, failed, by_newmark, diverges, model.units, spread
    )


def _squares(
    run: Record, segment: Segment, band: ZeroPhaseFilter | None
) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares by DOF of a run's error and of the measured motion."""
    if not _accelerations_alone(segment):
        return squares_of(run, segment, segment.valid, band)
    measured = segment.a[segment.valid].astype(float)
    error = np.asarray(run.acceleration, dtype=float) - measured
    if band is not None:
        error, measured = band.apply(error), band.apply(measured)
    return (error**2).sum(axis=0), (measured**2).sum(axis=0)


def _accelerations_alone(segment: Segment) -> bool:
    """Whether accelerations are compared: integrated displacements drift."""
    kinds = {channel[:1] for channel in segment.noise}
    return "a" in kinds and not kinds & {"v", "x"}


def _spread(
    beside: Sequence[ChainModel],
    run: Record,
    segment: Segment,
    band: ZeroPhaseFilter | None,
    dt: float | None,
) -> float:
    """Percent of a run along a record by which those of other models part from it."""
    rows = segment.valid
    channel: Channel = "displacement"
    if _accelerations_alone(segment):
        channel = "acceleration"
    return spread_of(
        run,
        beside,
        lambda model: free_run_by_either(model, segment, rows, dt).record,
        channel,
        band,
    )


def spread_of(
    run: Record,
    beside: Sequence[ChainModel],
    run_beside: Callable[[ChainModel], Record],
    channel: Channel = "displacement",
    band: ZeroPhaseFilter | None = None,
) -> float:
    """Percent of the motion of a free run by which those of other models part from it.

    Parameters
    ----------
    run : Record
    beside : sequence of ChainModel
    run_beside : callable
        Makes the run of a model under the same forces.
    channel : {"displacement", "acceleration"}
        The motion that is compared.
    band : ZeroPhaseFilter, optional
        The motions pass it first.

    Returns
    -------
    float
        Root of the mean square over models and DOFs; infinite where a model has no
        such run, NaN without models.
    """
    if not beside:
        return float("nan")
    motion = np.asarray(getattr(run, channel), dtype=float)
    size = np.square(_passed(motion, band)).sum(axis=0)

    shares = []
    for model in beside:
        try:
            parted = run_beside(model)
        except NRFError:
            return float("inf")
        change = np.asarray(getattr(parted, channel), dtype=float) - motion
        shares.append(np.square(_passed(change, band)).sum(axis=0) / size)
    return float(100.0 * np.sqrt(np.mean(shares)))


def _passed(values: np.ndarray, band: ZeroPhaseFilter | None) -> np.ndarray:
    return values if band is None else band.apply(values)


def _obstacle(segment: Segment, dt: float | None) -> str:
    """Why no run along a record is possible; empty if it is."""
    if segment.dt is None and dt is None:
        return "the sampling step is not known"
    if np.isnan(segment.F[segment.valid]).any():
        return f"a force of {segment.name} is unknown"
    return ""


def _free_name(name: str, taken: Container[str]) -> str:
    """The name of a record, with a number where another has the same."""
    label, number = name, 2
    while label in taken:
        label, number = f"{name} ({number})", number + 1
    return label
