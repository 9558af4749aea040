"""From what a user passes to ``fit`` to contiguous records of drifts, rates,
accelerations and forces.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChannelError, DataQualityWarning, LawError
from .channels import as_matrix, by_record, contiguous, finite_span, gaps, rows_text
from .checks.channel_checks import motion_doubts
from .dataset import Dataset, Extent, Segment, feature_names
from .fusion.kinematics import TwoWayFusion, base_acceleration_if_any, to_features
from .record import Record, row_times
from .zero_phase_filter import ZeroPhaseFilter

_STRETCH = 2**16  # samples looked at at a time
BASE_MOTION = ("ag", "vg", "xg")  # covariates that are motions of the base
_PIECE = 30  # samples between two gaps at least; fewer are too few to run a model along


def holds_records(X: Any) -> bool:
    """Whether a Record or a list of them was given."""
    return isinstance(X, Record) or (
        isinstance(X, (list, tuple)) and len(X) > 0 and isinstance(X[0], Record)
    )


def fused_together(X: Any) -> bool:
    """Whether a table of motions was made so that its DOFs improve each other."""
    return bool(getattr(X, "attrs", {}).get("joint_fusion"))


def as_measured(X: Any) -> bool:
    """Whether X is records, or what ``Record.to_features`` made of one."""
    return holds_records(X) or "joint_fusion" in getattr(X, "attrs", {})


def doubted(data: Dataset, X: Any) -> Dataset:
    """The same data with what looks wrong with motions that were passed as they are,
    which a warning says too.
    """
    if isinstance(X, Dataset) or as_measured(X):
        return data  # fused motions were looked at before the fusion
    at = int(np.argmax([seg.n_valid for seg in data.segments]))
    seg = data.segments[at]
    rows = seg.valid
    ag = None if seg.ag is None else seg.ag[rows]
    if found := motion_doubts(seg.a[rows], seg.v[rows], seg.s[rows], ag, seg.dt):
        warnings.warn(f"X: {'; '.join(found)}.", DataQualityWarning, stacklevel=4)
        data.segments[at] = replace(seg, doubts=(*seg.doubts, *found))
    return data


def both_ways(X: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options by which the DOFs of Records are fused together, and one by one by what
    that found, if it was done.
    """
    records = ([X] if isinstance(X, Record) else X) if holds_records(X) else []
    if not records:
        return {}, {}
    fusions = [TwoWayFusion() for _ in records]
    together = {"smooth": [fusion.joint for fusion in fusions]}
    return together, {"smooth": [fusion.separate for fusion in fusions]}


def from_arrays(
    X: Any,
    F: Any = None,
    *,
    record: Any = None,
    time: Any = None,
    base_acceleration: Any = None,
    covariates: Mapping[str, Any] | None = None,
    coordinates: str = "relative",
    dt: float | None = None,
    n_dof: int | None = None,
    has_memory: bool = False,
    smooth: Any = True,
    every_row: bool = False,
    check: bool = True,
) -> Dataset:
    """Check what the user passed and cut it into contiguous records."""
    if isinstance(X, Dataset):
        return X
    if holds_records(X):
        X = [X] if isinstance(X, Record) else X
        if not all(isinstance(rec, Record) for rec in X):
            raise ChannelError(
                "X is a list of records with something else in it",
                "Give Record objects only.",
            )
        beside = dict(
            F=F,
            record=record,
            time=time,
            base_acceleration=base_acceleration,
            covariates=covariates,
        )
        return _from_records(
            X,
            [k for k, value in beside.items() if value is not None],
            n_dof,
            smooth,
            check,
        )
    base_v = base_s = None
    if hasattr(X, "columns"):
        x, base_v, base_s, named_time, n = _from_frame(X, coordinates, n_dof)
        time = named_time if time is None else time
    else:
        x = as_matrix(X, _array_names(X, coordinates), what="columns of X")
        if x.shape[1] == 0:
            cure = f"Give {', '.join(feature_names(n_dof or 1, coordinates)[:9])}."
            raise ChannelError(
                f"X has 0 feature(s) (shape={x.shape}) while a minimum of 1 is"
                " required",
                cure,
            )
        if x.shape[1] % 3 or (n_dof and x.shape[1] != 3 * n_dof):
            wanted = feature_names(n_dof or max(1, x.shape[1] // 3), coordinates)
            need = f"{3 * n_dof} are needed" if n_dof else "a multiple of 3 is needed"
            cure = (
                "Give accelerations, inter-storey velocities and drifts of all DOFs:"
                f" {', '.join(wanted[:9])}."
            )
            raise ChannelError(
                f"X has {x.shape[1]} columns (n_features = {x.shape[1]}), {need}", cure
            )
        n = x.shape[1] // 3
    names = feature_names(n, coordinates)
    a, v, s = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
    size = len(x)
    if size == 0:
        raise ChannelError(
            "X has no samples (0 rows)",
            "Give at least as many samples as a balance has unknowns.",
        )
    force = (
        np.zeros((size, n))
        if F is None
        else as_matrix(_ordered_forces(F, n, X), "F", n, "forces F")
    )
    if len(force) != size:
        raise ChannelError(
            f"F has {len(force)} samples, X has {size}", "Cut both to the same clock."
        )
    ag = (
        None
        if base_acceleration is None
        else _line(base_acceleration, "base_acceleration", size)
    )
    if coordinates == "absolute":
        if base_v is None and ag is not None and np.nan_to_num(ag).any():
            cure = "Add them to X, or give the motion relative to the ground."
            raise ChannelError(
                "coordinates='absolute' with a moving base needs the columns xdot0"
                " and x0",
                cure,
            )
        v = np.diff(v, axis=1, prepend=0.0 if base_v is None else base_v)
        s = np.diff(s, axis=1, prepend=0.0 if base_s is None else base_s)
    if not isinstance(covariates, (Mapping, pd.DataFrame, type(None))):
        cure = "Give channels by name: covariates={'voltage': u}, or a table."
        raise ChannelError("The covariates are not a mapping", cure)
    given = {} if covariates is None else dict(covariates)
    extra = {str(k): _line(c, f"covariate {k}", size) for k, c in given.items()}
    pieces = by_record(record, size)
    if has_memory and len({name for name, _ in pieces}) < len(pieces):
        what = (
            "The rows of a record do not follow each other, and a law remembers the"
            " path"
        )
        raise LawError(what, "Sort the rows by record and time; never shuffle them.")
    is_step = (
        isinstance(dt, (int, float, np.number))
        and not isinstance(dt, bool)
        and np.isfinite(dt)
        and dt > 0
    )
    if time is None and dt is not None and not is_step:
        raise ChannelError(
            f"dt={dt!r} is not a sampling step", "Give a positive number in s."
        )
    seconds = None if time is None else row_times(time, size, pieces)
    if seconds is not None and has_memory:
        for name, rows in pieces:
            if (where := gaps(seconds[rows])).size:
                raise LawError(
                    f"The time of {name} jumps after {rows_text(rows.start + where)},"
                    " and a law remembers the path",
                    "Rows were left out or shuffled. Hold out whole records"
                    ", or give each contiguous piece its own record id.",
                )
    elif seconds is not None:
        # what a filter masked lies at the edges of the pieces
        masked = not Extent.of([x, force]).finite.all()
        pieces = (
            contiguous(size, record, seconds)
            if masked
            else _cut_at_gaps(pieces, seconds, every_row)
        )
    segments = []
    for name, rows in pieces:
        even = (
            None
            if seconds is not None or dt is None
            else np.arange(rows.stop - rows.start) * float(dt)
        )
        segment = Segment(
            name,
            rows,
            a[rows],
            v[rows],
            s[rows],
            force[rows],
            even if seconds is None else seconds[rows],
            None if ag is None else ag[rows],
            {k: c[rows] for k, c in extra.items()},
            resolved=getattr(X, "attrs", {}).get("resolved"),
            band=getattr(X, "attrs", {}).get("band"),
            doubts=tuple(getattr(X, "attrs", {}).get("doubts", ())),
            noise=getattr(X, "attrs", {}).get("noise", {}),
        )
        segments.append(
            _trimmed(
                _base_in_band(segment),
                names,
                x[rows] if coordinates == "relative" else None,
            )
        )
    if has_memory:
        for segment in segments:
            _require_order(segment)
    return Dataset(segments, size)


def _from_records(
    X: Sequence[Record], beside: list[str], n_dof: int | None, smooth: Any, check: bool
) -> Dataset:
    if beside:
        raise ChannelError(
            f"{beside[0]} was given beside records, which hold their own",
            f"Leave {beside[0]} out.",
        )
    segments, at = [], 0
    for rec, own in zip(
        X, smooth if isinstance(smooth, list) else [smooth] * len(X), strict=True
    ):
        if rec.n_dof != (n_dof or X[0].n_dof):
            what = (
                f"Record {rec.name!r} has {rec.n_dof} DOFs, {n_dof or X[0].n_dof} are"
                " needed"
            )
            raise ChannelError(what, "Give records of one chain.")
        x, force = to_features(rec, own, check)
        n, values = rec.n_dof, x.to_numpy()
        ag = base_acceleration_if_any(rec)
        segment = Segment(
            rec.name,
            slice(at, at + len(x)),
            values[:, :n],
            values[:, n : 2 * n],
            values[:, 2 * n :],
            force.to_numpy(),
            rec.time,
            ag,
            dict(rec.covariates),
            resolved=x.attrs.get("resolved"),
            band=x.attrs.get("band"),
            doubts=tuple(x.attrs.get("doubts", ())),
            noise=x.attrs.get("noise", {}),
        )
        segments.append(_trimmed(_base_in_band(segment), feature_names(n)))
        at += len(x)
    return Dataset(segments, at)


def _from_frame(
    frame: pd.DataFrame, coordinates: str, n_dof: int | None
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, Any, int]:
    """Matrix of the columns, rate and drift of the base, time, number of DOFs."""
    names = [str(c) for c in frame.columns]
    if twice := sorted({c for c in names if names.count(c) > 1}):
        raise ChannelError(
            f"Column {twice[0]!r} is in X more than once", "Rename or drop one."
        )
    rate, drift = ("v", "s") if coordinates == "relative" else ("xdot", "x")
    present = {
        rate + c[1:] if c[:1] == "v" and c[1:].isdigit() else c: c for c in names
    }
    n = n_dof or sum(
        1 for c in present if c[:1] == "a" and c[1:].isdigit() and c != "a0"
    )
    base = {"xdot0", "x0"} if coordinates == "absolute" else set()
    wanted = feature_names(max(n, 1), coordinates)
    missing = [c for c in wanted if c not in present]
    unknown = [
        c
        for c in present
        if c not in wanted and c not in base and c not in ("t", "time")
    ]
    if missing or unknown:
        has = f"has the unknown column{'s' if len(unknown) > 1 else ''}"
        pieces = [
            f"{word} {', '.join(some[:6])}"
            for word, some in (("lacks", missing), (has, unknown))
            if some
        ]
        cure = (
            f"Name the columns a1.., {rate}1.., {drift}1..; covariates and base"
            " acceleration are passed beside X."
        )
        raise ChannelError(f"X {' and '.join(pieces)}", cure)
    columns = [present[c] for c in wanted]
    values = as_matrix(
        frame if columns == list(frame.columns) else frame[columns], wanted, what="X"
    )
    bases = [
        as_matrix(frame[present[c]], [c], 1)[:, :1] if c in present else None
        for c in ("xdot0", "x0")
    ]
    if (bases[0] is None) != (bases[1] is None) and base:
        raise ChannelError(
            "X has only one of the columns xdot0 and x0",
            "Give both, or neither for a base at rest.",
        )
    return values, bases[0], bases[1], table_time(frame), n


def table_time(X: Any) -> Any:
    """Time of the rows of a table, from a column or the index; None if it has none."""
    if not hasattr(X, "columns"):
        return None
    named = next((c for c in ("t", "time") if c in X.columns), None)
    if named is not None:
        return X[named].to_numpy()
    if X.index.dtype.kind in "mM":
        return X.index
    return X.index.to_numpy() if X.index.name in ("t", "time") else None


def _array_names(X: Any, coordinates: str) -> list[str] | str:
    try:
        shape = np.shape(np.asarray(X))
    except ValueError:  # ragged lists
        return "column "
    plain = len(shape) == 2 and shape[1] and shape[1] % 3 == 0
    return feature_names(shape[1] // 3, coordinates) if plain else "column "


def _ordered_forces(F: Any, n: int, X: Any) -> Any:
    """Forces of a table in the order F1..Fn, after checking that its rows are those of
    X.
    """
    if not hasattr(F, "columns"):
        return F
    if (
        hasattr(X, "columns")
        and len(X) == len(F)
        and not X.index.equals(F.index)
        and not X.index.symmetric_difference(F.index).size
    ):
        raise ChannelError(
            "The rows of X and F have the same labels in another order",
            "Sort both the same way.",
        )
    names, wanted = [str(c) for c in F.columns], [f"F{j}" for j in range(1, n + 1)]
    if set(names) <= set(wanted) and len(set(names)) == len(
        names
    ):  # as in files: no column, no force
        F = F.set_axis(names, axis=1)
        return F if names == wanted else F.reindex(columns=wanted, fill_value=0.0)
    if names == [str(i) for i in range(n)] or len(names) == n == 1:
        return F
    cure = f"Name them {', '.join(wanted)}, or pass F.to_numpy() in that order."
    raise ChannelError(f"F has the columns {', '.join(names[:9])}", cure)


def _line(value: Any, name: str, size: int) -> np.ndarray:
    line = as_matrix(value, [name], 1, name)[:, 0].astype(np.float64)
    if len(line) != size:
        raise ChannelError(
            f"{name} has {len(line)} samples, X has {size}",
            "Cut both to the same clock.",
        )
    return line


def _cut_at_gaps(
    pieces: Sequence[tuple[str, slice]], seconds: np.ndarray, every_row: bool
) -> list[tuple[str, slice]]:
    """Pieces whose clock ticks evenly, short ones left out with a warning; rows drawn
    at random stay one piece.
    """
    out: list[tuple[str, slice]] = []
    for name, rows in pieces:
        size = rows.stop - rows.start
        parts = [
            slice(rows.start + p.start, rows.start + p.stop)
            for _, p in contiguous(size, None, seconds[rows])
        ]
        if len(parts) == 1 or size < _PIECE * len(parts):
            parts = [rows]
        elif not every_row and (
            short := [p for p in parts if p.stop - p.start < _PIECE]
        ):
            which = [
                (
                    f"row {p.start}"
                    if p.stop - p.start == 1
                    else f"rows {p.start} to {p.stop - 1}"
                )
                for p in short
            ]
            more = " and more" if len(which) > 6 else ""
            warnings.warn(
                f"{name[:1].upper()}{name[1:]}: {', '.join(which[:6])}{more} stand"
                f" alone between gaps of the clock. Pieces of fewer than {_PIECE}"
                " samples are left out; fill the gaps to keep them.",
                DataQualityWarning,
                stacklevel=5,
            )
            parts = [p for p in parts if p not in short]
        out += [(name, part) for part in parts]
    return out


def _base_in_band(segment: Segment) -> Segment:
    """The record with the motion of its base put through the band of its floors."""
    if segment.band is None or segment.dt is None:
        return segment
    filter = ZeroPhaseFilter(segment.band, 1.0 / segment.dt)

    def banded(line: np.ndarray) -> np.ndarray:
        inside = np.flatnonzero(np.isfinite(line))
        out = line.astype(float)
        if (
            len(inside) and np.isfinite(line[inside[0] : inside[-1] + 1]).all()
        ):  # a gap is named further on
            rows = slice(inside[0], inside[-1] + 1)
            out[rows] = filter.apply(out[rows])
        return out

    moves = {
        k: banded(line) if k in BASE_MOTION else line
        for k, line in segment.covariates.items()
    }
    return replace(
        segment, ag=None if segment.ag is None else banded(segment.ag), covariates=moves
    )


def _trimmed(
    segment: Segment, names: Sequence[str], packed: np.ndarray | None = None
) -> Segment:
    """Find the rows inside the NaN edges, and check every channel."""
    n = segment.n_dof
    extent = Extent.of(
        [
            *([segment.a, segment.v, segment.s] if packed is None else [packed]),
            segment.F,
        ]
    )
    lines = [
        line for line in (segment.ag, *segment.covariates.values()) if line is not None
    ]
    if (
        segment.n_samples
        and extent.is_whole(3 * n)
        and all(np.isfinite(line).all() for line in lines)
    ):
        segment.valid = slice(0, segment.n_samples)
        segment._extent = segment.valid, extent
        return segment
    forces = {
        f"F{j + 1}": f for j, f in enumerate(segment.F.T) if not np.isnan(f).all()
    }
    base = {} if segment.ag is None else {"base_acceleration": segment.ag}
    beside = (
        forces
        | base
        | {f"covariate {key}": line for key, line in segment.covariates.items()}
    )
    lines = [*segment.a.T, *segment.v.T, *segment.s.T, *beside.values()]
    where = "" if segment.name == "record" else f"record {segment.name!r}"
    segment.valid = finite_span(lines, [*names, *beside], where)
    if segment.n_valid < 1:
        cure = f"Check the edges of {names[n]}, {names[2 * n]} and the forces."
        raise ChannelError(f"{where or 'X'}: no row is finite in every channel", cure)
    return segment


def _steps(segment: Segment, j: int, rows: slice) -> tuple[np.ndarray, np.ndarray]:
    """Steps of a drift, and twice the mean rate between the same samples."""
    pace = segment.v[rows, j].astype(float)
    return np.diff(segment.s[rows, j].astype(float)), pace[1:] + pace[:-1]


def _require_order(segment: Segment) -> None:
    """Refuse shuffled rows: in order, every drift moves the way its rate points."""
    rows = segment.valid
    if rows.stop - rows.start < 8:
        return
    for j in range(segment.n_dof):
        along = ways = paces = 0.0
        for begin in range(rows.start, rows.stop - 1, _STRETCH):
            step, pace = _steps(
                segment, j, slice(begin, min(begin + _STRETCH + 1, rows.stop))
            )
            along, ways, paces = (
                along + step @ pace,
                ways + step @ step,
                paces + pace @ pace,
            )
        scale = (ways * paces) ** 0.5
        dt = segment.dt
        if dt is not None and along > 1.1 * 0.5 * dt * paces and along > 0.3 * scale:
            raise LawError(
                f"The drift s{j + 1} moves {along / (0.5 * dt * paces):.3g} times as"
                f" far as its rate v{j + 1} allows in a step of {dt:.4g} s, and a law"
                " remembers the path",
                "Rows are missing (a shuffled split takes them out), or dt or the units"
                " are wrong.",
            )
        if scale > 0 and along < 0.3 * scale:
            step, pace = _steps(segment, j, rows)
            where = rows_text(rows.start + np.flatnonzero(step * pace < 0))
            raise LawError(
                f"The drift s{j + 1} does not move the way its rate v{j + 1} points"
                f" ({where}), and a law remembers the path",
                "The rows are shuffled, or a channel is wrong; keep the samples of a"
                " record in order.",
            )
