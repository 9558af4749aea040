"""From anything that a user passes to ``fit`` to a data set.

Records are fused; arrays and tables are checked step by step and cut into contiguous
records. This is the only place where input becomes a :class:`Dataset`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ..common import number_of
from ..common.warn import warn_user
from ..exceptions import ChannelError, DataQualityWarning, LawError
from .channels import (
    as_matrix,
    by_record,
    contiguous,
    finite_span,
    gaps,
    rows_text,
    sample_weights,
)
from .checks.corners import without_corners
from .checks.motion_checks import motion_notes
from .dataset import Dataset, Segment, feature_names
from .extent import Extent
from .fusion import KinematicSmoother
from .fusion.kinematics import FusedRecord, Fusion, TwoWayFusion, fuse_record
from .hold import BAND_LIMITED
from .named_columns import MotionColumns, force_matrix, motion_columns, table_time
from .quality import messages
from .record import Record, row_times, seconds_of
from .zero_phase_filter import ZeroPhaseFilter

__all__ = [
    "Input",
    "InputSettings",
    "as_dataset",
    "from_arrays",
    "records_in",
    "table_time",
]

BASE_MOTION = ("ag", "vg", "xg")  # covariates that are motions of the base
# Samples between two gaps of the clock at least; along fewer no model can be run.
_SHORTEST_PIECE = 30
# Samples of a record that are multiplied at once where the order of rows is checked.
_STRETCH = 2**16
# Share of its rate with which a drift moves at least, if rows are in order.
_IN_ORDER = 0.3
# Drift over the integral of its rate, above which rows are missing between samples.
_ROWS_MISSING = 1.1

# How one record is fused.
Smoothing: TypeAlias = bool | KinematicSmoother | Fusion
# Arrays, tables, records, paths and Dask collections alike.
Data: TypeAlias = Any
Covariates: TypeAlias = Mapping[str, ArrayLike] | pd.DataFrame


@dataclass(frozen=True)
class Input:
    """What a user passes to ``fit``, ``predict`` or ``score``, untouched.

    Parameters
    ----------
    X : array-like of shape (n_samples, 3 n_dof), DataFrame, Record, list of Record or
        Dataset
    F : array-like of shape (n_samples, n_dof), optional
        Forces, N; zeros if None.
    record, time, base_acceleration, sample_weight : array-like of shape (n_samples,)
        Each optional: record ids, s, m/s^2, and weights in least squares.
    covariates : mapping of str to array-like of shape (n_samples,), optional
    """

    X: Data
    F: Data = None
    record: Data = None
    time: Data = None
    base_acceleration: Data = None
    covariates: Data = None
    sample_weight: Data = None

    def beside(self) -> dict[str, Data]:
        """What was given in addition to X, by name."""
        everything = vars(self).items()
        return {name: x for name, x in everything if name != "X" and x is not None}


@dataclass(frozen=True)
class InputSettings:
    """How input is read.

    Parameters
    ----------
    coordinates : {"relative", "absolute"}
        X holds inter-storey motion v, s, or motion xdot, x of the DOFs.
    dt : float, optional
        Sampling step of arrays without a time, s.
    n_dof : int, optional
        DOFs that are needed.
    has_memory : bool
        A law remembers the path, so rows must be in order and without gaps.
    every_row : bool
        Keep pieces that are too short to run a model along.
    smooth : bool, KinematicSmoother or function, or a sequence of one for each record
        How records are fused; see :func:`.fusion.kinematics.fuse_record`.
    joint : bool
        With ``smooth=True``: the DOFs of a record improve each other.
    both_fusions : bool
        Keep what a later fusion of each DOF by itself can use of the joint one.
    check : bool
        Look for faults of the channels of records.
    fuse : bool
        If False, records are not fused, and their motions are unknown (NaN).
    needs_clock : bool
        If False, records are read sample by sample, whatever their clock is.
    """

    coordinates: str = "relative"
    dt: float | None = None
    n_dof: int | None = None
    has_memory: bool = False
    every_row: bool = False
    smooth: Smoothing | Sequence[Smoothing] = True
    joint: bool = True
    both_fusions: bool = False
    check: bool = True
    fuse: bool = True
    needs_clock: bool = True


def as_dataset(passed: Input, settings: InputSettings = InputSettings()) -> Dataset:
    """Turn any input into a data set; a data set is returned as it is.

    Raises
    ------
    ChannelError
        If a channel, a clock or a shape cannot be used; it is named.
    LawError
        If a law remembers the path and rows are missing or in no order.
    """
    records = records_in(passed.X)
    if isinstance(passed.X, Dataset):
        data = passed.X
    elif records is not None:
        data = _from_records(records, passed, settings)
    else:
        data = _from_columns(passed, settings)
    return _weighted(data, passed.sample_weight)


def from_arrays(X: Data, F: Data = None, **options: Data) -> Dataset:
    """The same, with fields of :class:`Input` and :class:`InputSettings` as options."""
    settings = {}
    for field in fields(InputSettings):
        if field.name in options:
            settings[field.name] = options.pop(field.name)
    return as_dataset(Input(X, F, **options), InputSettings(**settings))


def records_in(X: object) -> list[Record] | None:
    """The records in what was passed as X; None if it is something else.

    Raises
    ------
    ChannelError
        If a list that begins with a record holds something else, too.
    """
    if isinstance(X, Record):
        return [X]
    if not isinstance(X, (list, tuple)) or not X or not isinstance(X[0], Record):
        return None
    for item in X:
        if not isinstance(item, Record):
            raise ChannelError(
                "X is a list of records with something else in it",
                "Give Record objects only.",
            )
    return list(X)


def lacks_motion(records: Sequence[Record]) -> bool:
    """Whether some floor has no sensor in some record."""
    for record in records:
        measured = set(record.measured)
        for j in range(1, record.n_dof + 1):
            if measured.isdisjoint((f"a{j}", f"v{j}", f"x{j}")):
                return True
    return False


def _weighted(data: Dataset, sample_weight: ArrayLike | None) -> Dataset:
    if sample_weight is None:
        return data
    weights = sample_weights(sample_weight, data.n_samples)
    segments = [
        replace(segment, weights=weights[segment.rows]) for segment in data.segments
    ]
    return replace(data, segments=segments)


# -- records ------------------------------------------------------------------------


def _from_records(
    records: list[Record], passed: Input, settings: InputSettings
) -> Dataset:
    for name in passed.beside():
        if name != "sample_weight":
            raise ChannelError(
                f"{name} was given in addition to records, which hold their own",
                f"Leave {name} out.",
            )

    fusions, fuse_apart = _fusions_of(records, settings)
    require_one_chain(records, settings.n_dof or records[0].n_dof)
    segments, as_used = [], []
    first_row = 0
    for record, fusion in zip(records, fusions, strict=True):
        timed = record if settings.needs_clock else record.by_sample()
        if settings.fuse:
            fused = fuse_record(timed, fusion, settings.check)
            segments.append(segment_of(timed, fused, first_row))
            record = without_corners(record, fused.notes)
        else:
            segments.append(_unfused(timed, first_row))
        first_row += record.n_samples
        as_used.append(record)

    return Dataset(tuple(segments), first_row, tuple(as_used), fuse_apart)


def require_one_chain(records: Sequence[Record], n_dof: int) -> None:
    """Refuse records of another number of DOFs, and rotations mixed with translations.

    Parameters
    ----------
    records : sequence of Record
    n_dof : int
        DOFs that are needed.
    """
    for record in records:
        if record.n_dof != n_dof:
            raise ChannelError(
                f"Record {record.name!r} has {record.n_dof} DOFs, {n_dof} are needed",
                "Give records of one chain.",
            )
        if record.rotates != records[0].rotates:
            kinds = {True: "rotations", False: "translations"}
            raise ChannelError(
                f"Record {record.name!r} is of {kinds[record.rotates]},"
                f" {records[0].name!r} of {kinds[records[0].rotates]}",
                "Give records of one chain; record.of_rotations() says that the"
                " channels are angles and torques.",
            )


def _unfused(record: Record, first_row: int) -> Segment:
    """A record whose motions are not known."""
    unknown = np.full(record.force.shape, np.nan)
    return Segment(
        name=record.name,
        rows=slice(first_row, first_row + record.n_samples),
        a=unknown,
        v=unknown,
        s=unknown,
        F=record.force,
        t=record.time,
        valid=slice(0, record.n_samples),
    )


def _fusions_of(
    records: list[Record], settings: InputSettings
) -> tuple[Sequence[Smoothing], Callable[[], Dataset] | None]:
    """Fusion of every record, and a function that fuses each DOF by itself."""
    smooth = settings.smooth
    if isinstance(smooth, Sequence):
        return smooth, None
    if smooth is not True:
        return [smooth] * len(records), None

    both = [TwoWayFusion() for _ in records]
    apart = [fusion.separate for fusion in both]
    if not settings.joint:
        return apart, None
    together: list[Smoothing] = [True] * len(records)
    if settings.both_fusions:
        together = [fusion.joint for fusion in both]
    again = replace(settings, smooth=apart, check=False)
    return together, partial(as_dataset, Input(records), again)


def segment_of(
    record: Record,
    fused: FusedRecord,
    first_row: int = 0,
    covariates: Mapping[str, np.ndarray] | None = None,
) -> Segment:
    """A record that was fused, as a segment.

    Parameters
    ----------
    record : Record
    fused : FusedRecord
    first_row : int
        Its row among those of all records.
    covariates : mapping of str to ndarray of shape (n_samples,), optional
        Those of the record if None. Motions of the base among them are filtered like
        the motion of the floors.
    """
    lines = record.covariates if covariates is None else covariates
    segment = Segment(
        name=record.name,
        rows=slice(first_row, first_row + len(fused.a)),
        a=fused.a,
        v=fused.v,
        s=fused.s,
        F=fused.force,
        t=fused.time,
        ag=fused.ag,
        covariates=_base_motions_in_band(lines, fused, record.fs),
        resolved=fused.resolved,
        band=fused.band,
        noise=dict(fused.noise),
        quality=record.quality + fused.notes,
        simulation_method=fused.simulation_method,
        hold=fused.hold or record.hold,
    )
    segment = _with_valid_rows(segment, feature_names(fused.n_dof), fused.motion)
    if fused.as_measured or segment.hold in (None, BAND_LIMITED):
        return segment
    return segment.with_band_limited_forces(segment.hold)


def _base_motions_in_band(
    covariates: Mapping[str, np.ndarray], fused: FusedRecord, fs: float
) -> dict[str, np.ndarray]:
    out = dict(covariates)
    if fused.band is None:
        return out

    band_pass = ZeroPhaseFilter(fused.band, fs)
    for name in BASE_MOTION:
        if name in out:
            out[name] = _filtered_inside(out[name], band_pass)
    return out


def _filtered_inside(line: np.ndarray, band_pass: ZeroPhaseFilter) -> np.ndarray:
    """A line filtered between its NaN edges; one with gaps is refused later on."""
    out = line.astype(float)
    known = np.flatnonzero(np.isfinite(line))
    if not len(known):
        return out

    rows = slice(known[0], known[-1] + 1)
    if np.isfinite(line[rows]).all():
        out[rows] = band_pass.apply(out[rows])
    return out


# -- arrays and tables --------------------------------------------------------------


def _from_columns(passed: Input, settings: InputSettings) -> Dataset:
    columns = motion_columns(passed.X, settings.coordinates, settings.n_dof)
    n_samples = len(columns.matrix)
    force = force_matrix(passed.F, columns, passed.X)
    ag = _line_if_given(passed.base_acceleration, "base_acceleration", n_samples)
    v, s = _interstorey_motion(columns, settings.coordinates, ag)
    covariates = _covariate_lines(passed.covariates, n_samples)
    pieces, time = _contiguous_pieces(passed, columns, force, settings)

    segments = []
    for name, rows in pieces:
        segment = Segment(
            name=name,
            rows=rows,
            a=columns.matrix[rows, : columns.n_dof],
            v=v[rows],
            s=s[rows],
            F=force[rows],
            t=_time_of_piece(time, rows, settings.dt),
            ag=ag if ag is None else ag[rows],
            covariates={key: line[rows] for key, line in covariates.items()},
        )
        # views of one matrix are scanned as that matrix, which is quicker
        packed = columns.matrix[rows] if settings.coordinates == "relative" else None
        segments.append(_with_valid_rows(segment, columns.names, packed))

    if settings.has_memory:
        for segment in segments:
            _require_order(segment)
    return Dataset(tuple(segments), n_samples)


def _interstorey_motion(
    columns: MotionColumns, coordinates: str, ag: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Rates and drifts of the storeys."""
    n = columns.n_dof
    v, s = columns.matrix[:, n : 2 * n], columns.matrix[:, 2 * n :]
    if coordinates == "relative":
        return v, s

    base = columns.base_motion
    if base is None:
        if ag is not None and np.nan_to_num(ag).any():
            raise ChannelError(
                "coordinates='absolute' with a moving base needs the columns xdot0 and"
                " x0",
                "Add them to X, or give the motion relative to the ground.",
            )
        base = np.zeros((len(v), 2))
    v = np.diff(v, axis=1, prepend=base[:, :1])
    s = np.diff(s, axis=1, prepend=base[:, 1:])
    return v, s


def _covariate_lines(
    covariates: Covariates | None, n_samples: int
) -> dict[str, np.ndarray]:
    if covariates is None:
        return {}
    if not isinstance(covariates, (Mapping, pd.DataFrame)):
        raise ChannelError(
            "The covariates are not a mapping",
            "Give channels by name: covariates={'voltage': u}, or a table.",
        )
    return {
        str(name): _line(line, f"covariate {name}", n_samples)
        for name, line in dict(covariates).items()
    }


def _line_if_given(
    value: ArrayLike | None, name: str, n_samples: int
) -> np.ndarray | None:
    return None if value is None else _line(value, name, n_samples)


def _line(value: ArrayLike, name: str, n_samples: int) -> np.ndarray:
    line = as_matrix(value, [name], 1, name)[:, 0].astype(np.float64)
    if len(line) != n_samples:
        raise ChannelError(
            f"{name} has {len(line)} samples, X has {n_samples}",
            "Cut both to the same clock.",
        )
    return line


# -- clocks and pieces --------------------------------------------------------------

Pieces = list[tuple[str, slice]]


def _contiguous_pieces(
    passed: Input, columns: MotionColumns, force: np.ndarray, settings: InputSettings
) -> tuple[Pieces, np.ndarray | None]:
    """Name and rows of every contiguous record, and the time of all rows."""
    n_samples = len(columns.matrix)
    pieces = by_record(passed.record, n_samples)
    if settings.has_memory:
        _require_unbroken_records(pieces)
    _refuse_alternating_ids(pieces, n_samples)

    clock = columns.time if passed.time is None else passed.time
    is_asked_for = passed.time is not None or passed.record is not None
    if clock is None or not (is_asked_for or settings.has_memory or _rises(clock)):
        _require_step(settings.dt)
        return pieces, None

    time = row_times(clock, n_samples, pieces)
    if settings.has_memory:
        _require_steady_clock(pieces, time)
    elif not Extent.of_columns([columns.matrix, force]).finite.all():
        # what a filter masked lies at the edges of the pieces
        pieces = contiguous(n_samples, passed.record, time)
    else:
        pieces = _cut_at_gaps(pieces, time, settings.every_row)
    return pieces, time


# Rows that follow each other under one id, on average; with fewer the ids alternate.
_FEWEST_ROWS_TOGETHER = 3


def _refuse_alternating_ids(pieces: Pieces, n_samples: int) -> None:
    """Refuse records whose rows alternate, sample by sample."""
    n_records = len({name for name, _ in pieces})
    if n_records < len(pieces) and n_samples < _FEWEST_ROWS_TOGETHER * len(pieces):
        raise ChannelError(
            f"The ids in record change {len(pieces) - 1} times among {n_records}"
            " records: their rows alternate",
            "Sort the rows by record, each in the order of its time.",
        )


# Share of steps back in time from which on rows were drawn at random, one by one, as
# cross-validation does; where records follow each other there are few.
_DRAWN_AT_RANDOM = 0.25


def _rises(clock: ArrayLike) -> bool:
    """Whether rows are in the order of their time; else they are used one by one."""
    seconds = seconds_of(clock, "time")
    return bool((np.diff(seconds) < 0).sum() <= _DRAWN_AT_RANDOM * len(seconds))


def _require_unbroken_records(pieces: Pieces) -> None:
    if len({name for name, _ in pieces}) < len(pieces):
        raise LawError(
            "The rows of a record do not follow each other, and a law remembers the"
            " path",
            "Sort the rows by record and time; never shuffle them.",
        )


def _require_step(dt: float | None) -> None:
    if dt is None:
        return
    is_number = isinstance(dt, (int, float, np.number)) and not isinstance(dt, bool)
    if not is_number or not 0 < number_of(dt) < np.inf:
        raise ChannelError(
            f"dt={dt!r} is not a sampling step", "Give a positive number in s."
        )


def _require_steady_clock(pieces: Pieces, time: np.ndarray) -> None:
    for name, rows in pieces:
        jumps = gaps(time[rows])
        if jumps.size:
            raise LawError(
                f"The time of {name} jumps after {rows_text(rows.start + jumps)}, and a"
                " law remembers the path",
                "Rows were left out or shuffled. Hold out whole records"
                ", or give each contiguous piece its own record id.",
            )


def _cut_at_gaps(pieces: Pieces, time: np.ndarray, every_row: bool) -> Pieces:
    """Pieces whose clock ticks evenly; rows that were drawn at random stay one piece.

    Short pieces between two gaps are left out with a warning, unless every row counts.
    """
    out: Pieces = []
    for name, rows in pieces:
        n_rows = rows.stop - rows.start
        stretches = [
            slice(rows.start + stretch.start, rows.start + stretch.stop)
            for _, stretch in contiguous(n_rows, None, time[rows])
        ]
        drawn_at_random = n_rows < _SHORTEST_PIECE * len(stretches)
        if len(stretches) == 1 or drawn_at_random:
            out.append((name, rows))
            continue

        if not every_row:
            stretches = _long_stretches(name, stretches)
        out.extend((name, stretch) for stretch in stretches)
    return out


def _long_stretches(name: str, stretches: list[slice]) -> list[slice]:
    """Stretches that are long enough; a warning names the others."""
    short = [
        stretch
        for stretch in stretches
        if stretch.stop - stretch.start < _SHORTEST_PIECE
    ]
    if not short:
        return stretches

    named = []
    for stretch in short[:6]:
        if stretch.stop - stretch.start == 1:
            named.append(f"row {stretch.start}")
        else:
            named.append(f"rows {stretch.start} to {stretch.stop - 1}")
    more = " and more" if len(short) > 6 else ""
    warn_user(
        f"{name[:1].upper()}{name[1:]}: {', '.join(named)}{more} stand alone between"
        f" gaps of the clock. Pieces of fewer than {_SHORTEST_PIECE} samples are left"
        " out; fill the gaps to keep them.",
        DataQualityWarning,
    )
    return [stretch for stretch in stretches if stretch not in short]


def _time_of_piece(
    time: np.ndarray | None, rows: slice, dt: float | None
) -> np.ndarray | None:
    """Time of the rows, or counted from the start of the piece by ``dt``."""
    if time is not None:
        return time[rows]
    if dt is None:
        return None
    return np.arange(rows.stop - rows.start) * float(dt)


# -- rows that can be used ----------------------------------------------------------


def _with_valid_rows(
    segment: Segment, names: Sequence[str], packed: np.ndarray | None = None
) -> Segment:
    """The segment with the rows inside its NaN edges; every channel is checked.

    ``packed`` holds all motions as one matrix, if there is one.
    """
    n = segment.n_dof
    motions = [segment.a, segment.v, segment.s] if packed is None else [packed]
    extent = Extent.of_columns([*motions, segment.F])
    beside = dict(segment.covariates)
    if segment.ag is not None:
        beside["base_acceleration"] = segment.ag

    all_finite = all(np.isfinite(line).all() for line in beside.values())
    if segment.n_samples and extent.is_complete(3 * n) and all_finite:
        every_row = slice(0, segment.n_samples)
        return replace(segment, valid=every_row, known_extent=extent)

    named = _named_lines(segment, names)
    where = "" if segment.name == "record" else f"record {segment.name!r}"
    rows = finite_span(list(named.values()), list(named), where)
    if rows.stop - rows.start < 1:
        raise ChannelError(
            f"{where or 'X'}: no row is finite in every channel",
            f"Check the edges of {names[n]}, {names[2 * n]} and the forces.",
        )
    return replace(segment, valid=rows)


def _named_lines(segment: Segment, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Every channel that must be finite; a force that is NaN throughout is unknown."""
    lines = dict(zip(names, (*segment.a.T, *segment.v.T, *segment.s.T)))
    for j, force in enumerate(segment.F.T, start=1):
        if not np.isnan(force).all():
            lines[f"F{j}"] = force
    if segment.ag is not None:
        lines["base_acceleration"] = segment.ag
    for name, line in segment.covariates.items():
        lines[f"covariate {name}"] = line
    return lines


def _require_order(segment: Segment) -> None:
    """Refuse shuffled rows: in order, every drift moves the way its rate points."""
    if segment.n_valid < 8:
        return
    for j in range(segment.n_dof):
        together, drift_power, rate_power = _drift_against_rate(segment, j)
        scale = (drift_power * rate_power) ** 0.5
        if segment.dt is not None:
            integral = 0.5 * segment.dt * rate_power
            too_far = together > _ROWS_MISSING * integral
            if too_far and together > _IN_ORDER * scale:
                raise LawError(
                    f"The drift s{j + 1} moves {together / integral:.3g} times as far"
                    f" as its rate v{j + 1} allows in a step of {segment.dt:.4g} s,"
                    " and a law remembers the path",
                    "Rows are missing (a shuffled split takes them out), or dt or the"
                    " units are wrong.",
                )
        if scale > 0 and together < _IN_ORDER * scale:
            step, rate = _steps(segment, j, segment.valid)
            opposed = segment.valid.start + np.flatnonzero(step * rate < 0)
            raise LawError(
                f"The drift s{j + 1} does not move the way its rate v{j + 1} points"
                f" ({rows_text(opposed)}), and a law remembers the path",
                "The rows are shuffled, or a channel is wrong; keep the samples of a"
                " record in order.",
            )


def _drift_against_rate(segment: Segment, j: int) -> tuple[float, float, float]:
    """Sums of step times rate, of step squared and of rate squared."""
    together = drift_power = rate_power = 0.0
    last = segment.valid.stop
    for first in range(segment.valid.start, last - 1, _STRETCH):
        rows = slice(first, min(first + _STRETCH + 1, last))
        step, rate = _steps(segment, j, rows)
        together += step @ rate
        drift_power += step @ step
        rate_power += rate @ rate
    return together, drift_power, rate_power


def _steps(segment: Segment, j: int, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Steps of a drift, and twice the mean rate between the same samples."""
    rate = segment.v[rows, j].astype(float)
    return np.diff(segment.s[rows, j].astype(float)), rate[1:] + rate[:-1]


# -- motions that were passed as they are -------------------------------------------


def with_motion_checks(data: Dataset) -> Dataset:
    """The data set with notes on motions that do not fit each other, and a warning.

    The longest record is looked at. Records are checked before their fusion instead.
    """
    longest = int(np.argmax([segment.n_valid for segment in data.segments]))
    segment = data.segments[longest]
    rows = segment.valid
    ag = None if segment.ag is None else segment.ag[rows]
    notes = motion_notes(
        segment.a[rows], segment.v[rows], segment.s[rows], ag, segment.dt
    )
    if not notes:
        return data

    warn_user(f"X: {'; '.join(messages(notes))}.", DataQualityWarning)
    named = [replace(note, record=segment.name) for note in notes]
    segments = list(data.segments)
    segments[longest] = replace(segment, quality=segment.quality + tuple(named))
    return replace(data, segments=segments)
