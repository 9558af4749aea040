"""From what a user passes to the loop to fused records, ready to be searched."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.fft import next_fast_len

from ..chain.sites import Site
from ..equations.chain_solve import clock_of
from ..exceptions import ChannelError
from ..laws.base import ForceLaw
from ..laws.shape import Motion, Scales
from ..records.checks.channel_checks import Measured, measured
from ..records.dataset import BlockRows, Dataset, Segment, half_the_rate
from ..records.fusion.kinematic_smoother import KinematicSmoother
from ..records.fusion.kinematics import (
    base_acceleration_if_any,
    base_motion,
    to_features,
)
from ..records.input_arrays import from_arrays
from ..records.record import Record
from .constants import CLEAN, LEAST_SHARE, TENTH, WINDOWS
from .windows import period_of

# Samples on which a search decides. A gain is a ratio of powers: more samples make it
# no larger.
MOST = 10_000
# Rows that are longer are held in single precision, or formed again when they are asked
# for.
LONG = 10 * MOST


@dataclass
class Prepared:
    """Fused records."""

    records: list[Record]  # as measured
    data: Dataset  # the base motion stands among the covariates as ``ag`` and ``vg``
    noise: list[dict[str, float]] = field(
        default_factory=list
    )  # of each channel of each record, SI rms
    heldout: list[int] | None = None  # numbers of the records held out whole
    clean: bool = False  # all channels were taken as they are
    contradictions: list[Any] | None = (
        None  # faults that would reconcile the channels of one DOF, once looked for
    )
    bands: list[Any] = field(
        default_factory=list
    )  # Hz, where accelerations alone tell a motion; else None
    knots: list[dict[int, Any]] = field(
        default_factory=list
    )  # distances of the knots of each DOF, samples

    def like(self, numbers: Iterable[int]) -> Any:
        """Noise levels, bands and knots of some records."""
        return zip(*((self.noise[i], self.bands[i], self.knots[i]) for i in numbers))


def prepare(
    records: Any,
    heldout: Any = None,
    noise: Sequence[dict[str, float]] | None = None,
    bands: Sequence[Any] | None = None,
    knots: Sequence[Any] | None = None,
) -> Prepared:
    """Fuse the channels of every record, by noise levels, bands and knots of like ones
    where these are given.
    """
    mine, kept = as_records(records, "records"), as_records(heldout, "heldout")
    every = [*mine, *kept]
    n = every[0].n_dof
    segments, found, told, used, at, clean = [], [], [], [], 0, True
    given = [
        {k: v for k, v in levels.items() if v > 0}
        for levels in noise or [{}] * len(every)
    ]
    every = [_zeroed(rec) for rec in every]
    like = zip(
        every,
        given,
        bands or ["auto"] * len(every),
        knots or [None] * len(every),
        strict=True,
    )
    for rec, known, band, spacing in like:
        if rec.n_dof != n:
            cure = "Give records of one chain."
            raise ChannelError(
                f"Record {rec.name!r} has {rec.n_dof} DOFs, {n} are needed", cure
            )
        # the square of the share biases; a smaller one, as of a fit, would cost first
        # modes
        smoother = KinematicSmoother(
            noise=known or "estimate", band=band, spacing=spacing, noise_share=TENTH
        )
        X, F = to_features(
            rec, smoother, check=bands is None
        )  # else they are records made from checked ones
        told.append(smoother.band_)
        used.append(smoother.spacing_.to_dict())
        levels = {str(k): float(v) for k, v in smoother.noise_.items()}
        if _is_clean(rec, levels):
            X, F = to_features(rec, False, check=False)
        else:
            clean = False
        found.append(levels)
        piece = _segment(rec, X, F)
        piece.name, piece.rows = rec.name, slice(at, at + len(X))
        at += len(X)
        segments.append(piece)
    held = list(range(len(mine), len(every))) if kept else None
    return Prepared(
        every, Dataset(segments, at), found, held, clean, bands=told, knots=used
    )


def _zeroed(record: Record) -> Record:
    """The record with the zero of displacements that no other channel knows at rest, or
    at the mean of the motion.
    """
    if (
        record.displacement is None
        or record.acceleration is not None
        or record.velocity is not None
    ):
        return record
    changes = {}
    for key in ("displacement", "base_displacement"):
        x = getattr(record, key)
        if x is not None:
            start = x[: max(4, len(x) // 500)]
            moves = np.nanstd(start, axis=0) > LEAST_SHARE * np.nanstd(x, axis=0)
            changes[key] = x - np.where(
                moves, np.nanmean(x, axis=0), np.nanmean(start, axis=0)
            )
    return record.replace(**changes)


def measured_of(ready: Prepared) -> list[Measured]:
    """What the records of a closed loop hold."""
    seen = (
        "searched, but for a quarter that is held out"
        if ready.heldout is None
        else "searched"
    )
    roles = [
        "held out" if i in (ready.heldout or ()) else seen
        for i in range(len(ready.records))
    ]
    return [
        measured(rec, noise, role)
        for rec, noise, role in zip(ready.records, ready.noise, roles)
    ]


def _segment(record: Record, X: pd.DataFrame, F: pd.DataFrame) -> Segment:
    """The fused motion of a record beside what was measured of its base and
    covariates.
    """
    ag = base_acceleration_if_any(record)
    return from_arrays(
        X, F, base_acceleration=ag, covariates=_covariates(record)
    ).segments[0]


def as_records(records: Any, name: str) -> list[Record]:
    """A list of records, or an error."""
    if isinstance(records, Record):
        return [records]
    records = [] if records is None else records
    if isinstance(records, Sequence) and all(isinstance(r, Record) for r in records):
        if not records and name == "records":
            raise ChannelError(
                "There is no record to search", "Pass a Record or a list of them."
            )
        return list(records)
    cure = "Build them with Record(...) or Record.from_frame(df)."
    raise ChannelError(f"{name} holds something that is not a Record", cure)


def _is_clean(record: Record, noise: dict[str, float]) -> bool:
    """Whether every motion is measured, and the channels of each DOF contradict each
    other by next to nothing.
    """
    channels = record.channels()
    wanted = [f"{kind}{j}" for kind in "avx" for j in range(1, record.n_dof + 1)]
    based = ["vg", "xg"] * (record.coordinates == "absolute" and record.base_moves)
    if any(name not in channels for name in (*wanted, *based)):
        return False
    return all(
        noise.get(name, np.inf) <= CLEAN * np.nanstd(channels[name]) for name in wanted
    )


def _covariates(record: Record) -> dict[str, np.ndarray]:
    """Measured covariates, and the motion of the base as ``ag`` and ``vg``."""
    out = dict(record.covariates)
    if not record.base_moves:
        return out
    ag = base_acceleration_if_any(record)
    assert ag is not None
    if record.base_velocity is not None:
        vg = record.base_velocity
    elif record.base_displacement is not None:
        vg = base_motion(record, record)[0]
    else:
        from ..records.fusion import integrate

        vg = integrate(ag, record.dt)
    for name, line in (("ag", ag), ("vg", vg)):
        out.setdefault(name, line)
    return out


class Workspace:
    """The records of one search, with everything that does not depend on the laws.

    Folds (``search``) and what is ``held`` out count rows from the first valid one of a
    record. ``filters`` are the bands in which residuals are looked at, one for each
    record; decisions do not read them.
    """

    def __init__(
        self,
        data: Dataset,
        search: Sequence[BlockRows],
        held: Sequence[BlockRows],
        known_masses: Mapping[int, float],
    ) -> None:
        self.data = data
        self.filters: list[Any] = [None] * len(data.segments)
        self.search, self.held = list(search), list(held)
        self.known_masses = dict(known_masses)
        self.n_dof = data.n_dof
        self.searched = sorted({b.segment for b in search})
        seen = Dataset([data.segments[i] for i in self.searched], data.n_samples)
        self.forced, self.unknown = seen.forced, seen.unknown
        self._motions: dict[tuple[Site, tuple[int, ...]], Motion] = {}
        self._scales: dict[Site, Scales] = {}
        self.made: dict[Any, Any] = {}  # columns of records, whatever the model
        self.known = np.array(
            [~np.isnan(seg.F[seg.valid.start]) for seg in data.segments]
        )
        self.whole = self  # all samples, where these are excerpts of long records

    def leave_out(self, instants: Sequence[float], margin: float) -> None:
        """Judge no more on pieces in which something changes, or so near (s) that the
        search could not tell when.
        """

        def changes(b: BlockRows) -> bool:
            seg = self.data.segments[b.segment]
            t = np.asarray(seg.t, dtype=float)[seg.valid][b.rows]
            return b.segment in self.searched and any(
                t[0] - margin <= x <= t[-1] + margin for x in instants
            )

        self.held = [b for b in self.held if not (instants and changes(b))] or self.held

    def with_data(self, data: Dataset) -> Workspace:
        """The same rows of other motions (of corrected channels), as far as they are
        valid.
        """

        def same(blocks: Sequence[BlockRows]) -> list[BlockRows]:
            out = []
            for b in blocks:
                old, new = (
                    self.data.segments[b.segment].valid,
                    data.segments[b.segment].valid,
                )
                length = new.stop - new.start
                ends = (
                    int(np.clip(r + old.start - new.start, 0, length))
                    for r in (b.rows.start, b.rows.stop)
                )
                out.append(BlockRows(b.segment, slice(*ends)))
            return out

        out = copy(self)
        out.whole = out if self.whole is self else self.whole
        out.data, out.search, out.held = data, same(self.search), same(self.held)
        out._motions, out._scales, out.made = {}, {}, {}
        return out

    def motion(self, site: Site, *records: int) -> Motion:
        """Motion that a law at a site sees in one record, or in some, one after the
        other.
        """
        found = self._motions.get((site, records))
        if found is None:
            found = Motion.joined(
                [
                    seg.motion(site, seg.valid)
                    for seg in (self.data.segments[i] for i in records)
                ]
            )
            if (
                found.n_samples < LONG or len(records) > 1
            ):  # in place of longer ones excerpts are searched
                self._motions[site, records] = found
        return found

    def scales(self, site: Site) -> Scales:
        """Sizes of the motion at a site, from which shape parameters are searched; of
        the search rows and records.
        """
        if self.whole is not self:
            return self.whole.scales(site)
        if site not in self._scales:
            s, v = (float(np.sqrt(np.mean(y**2))) for y in self.along(site))
            self._scales[site] = (
                s,
                v,
                *clock_of([self.motion(site, i) for i in self.searched]),
            )
        return self._scales[site]

    def along(self, site: Site) -> list[np.ndarray]:
        """Drift and rate of a site in all rows of the search."""
        seen = {i: self.motion(site, i) for i in self.searched}
        return [
            np.concatenate([getattr(seen[b.segment], k)[b.rows] for b in self.search])
            for k in "sv"
        ]

    @property
    def fastest(self) -> float:
        """Half the lowest sampling rate of the search, Hz."""
        return half_the_rate(self.data.segments[i] for i in self.searched)

    def columns(
        self, site: Site, laws: Sequence[ForceLaw], records: Sequence[int]
    ) -> np.ndarray:
        """Columns of laws along some records, from the raw motion."""
        motion = self.motion(site, *records)
        each = [law.features(motion).T for law in laws]
        return np.vstack(each) if len(each) > 1 else each[0]

    def fixed(self, records: Sequence[int]) -> list[np.ndarray]:
        """Accelerations of some records, then forces, 2 n_dof rows of (n_valid,); what
        is unknown of them is zero.
        """
        each = [
            [*seg.a[seg.valid].T, *seg.F[seg.valid].T]
            for seg in (self.data.segments[i] for i in records)
        ]
        rows = (
            parts[0] if len(parts) == 1 else np.concatenate(parts)
            for parts in zip(*each)
        )
        return [row if np.isfinite(row).all() else np.nan_to_num(row) for row in rows]

    def runs(self, record: int) -> list[slice]:
        """Runs of search rows of a record with no held-out piece in them, counted from
        its first valid row.
        """
        runs: list[slice] = []
        for rows in (b.rows for b in self.search if b.segment == record):
            if runs and runs[-1].stop == rows.start:
                runs[-1] = slice(runs[-1].start, rows.stop)
            else:
                runs.append(rows)
        return runs

    def pieces(self, data: Dataset | None = None) -> list[tuple[int, Segment]]:
        """The data that the search may see, as contiguous segments with the numbers of
        their records.
        """
        return [
            (
                i,
                replace(
                    seg,
                    valid=slice(
                        seg.valid.start + rows.start, seg.valid.start + rows.stop
                    ),
                ),
            )
            for i, seg in enumerate((data or self.data).segments)
            for rows in self.runs(i)
        ]

    def seen_rows(self, record: int) -> np.ndarray:
        """Which samples of a record the search may look at."""
        segment = self.data.segments[record]
        seen = np.zeros(segment.n_samples, dtype=bool)
        for rows in self.runs(record):
            seen[segment.valid.start + rows.start : segment.valid.start + rows.stop] = (
                True
            )
        return seen


def excerpts(
    ready: Prepared, work: Workspace, most: float = MOST
) -> tuple[Prepared, Workspace]:
    """The records of a search; of long ones the strongest stretch of every fold, as a
    record of its own.
    """
    x = np.concatenate([work.motion(Site(1), b.segment).s[b.rows] for b in work.search])
    # Two periods in a window, as records of ten thousand samples have.
    size = (
        int(max(most, 2 * WINDOWS * period_of([x])) / len(work.search))
        if most < len(x)
        else len(x)
    )
    if 2 * size * len(work.search) > len(x) or not ready.records[0].has_clock:
        return ready, work
    blocks: list[BlockRows] = []
    records, segments, at = [], [], 0
    for b in work.search:
        seg, own = work.data.segments[b.segment], min(size, b.rows.stop - b.rows.start)
        start = seg.strongest(b.rows, own)
        lead = min(
            start, next_fast_len(own + own // 10) - own
        )  # in which laws with a memory forget
        rows = slice(seg.valid.start + start - lead, seg.valid.start + start + own)
        records.append(ready.records[b.segment].rows(rows))
        segments.append(seg.part(rows, at))
        blocks.append(BlockRows(len(blocks), slice(lead, lead + own)))
        at += segments[-1].n_samples
    noise, bands, knots = map(list, ready.like(b.segment for b in work.search))
    few = Prepared(
        records,
        Dataset(segments, at),
        noise,
        clean=ready.clean,
        bands=bands,
        knots=knots,
    )
    part = Workspace(few.data, blocks, [], work.known_masses)
    part.whole = work
    return few, part
