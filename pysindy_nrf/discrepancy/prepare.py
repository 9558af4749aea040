"""From what a user passes to the loop to fused records, ready to be searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ..data.record import Record
from ..exceptions import ChannelError
from ..regression.input_arrays import from_arrays
from ..regression.segments import Segment, SegmentSet
from ..signals.channel_checks import Measured, measured
from ..signals.kinematic_smoother import KinematicSmoother
from ..signals.kinematics import base_acceleration_if_any, base_motion, to_features

# Noise of every channel, as a share of its rms, below which the channels are taken as they are.
CLEAN = 0.004
# Share of its rms by which a displacement may scatter at the start of a record that begins at rest.
MOVES = 0.05


@dataclass
class Prepared:
    """Fused records.

    Attributes
    ----------
    records : list of Record
        As measured.
    data : SegmentSet
        Fused; the base motion stands among the covariates as ``ag`` and ``vg``.
    noise : list of dict
        Estimated noise of each channel of each record, SI rms.
    bands : list of (float, float) or None
        Of each record: the band, Hz, in which accelerations alone tell its motion; None where displacements are
        measured.
    given : list of dict
        Noise of channels that was known; of the others, and where the list is empty of all, it is estimated.
    heldout : list of int or None
        Numbers of the records held out whole.
    clean : bool
        Whether all channels were taken as they are.
    contradictions : list or None
        Faults that would reconcile the channels of one DOF, once they were looked for.
    refused : dict of (str, str) to float
        Such faults (law, site) that explained nothing, and the model's error at that time, percent.
    """

    records: list[Record]
    data: SegmentSet
    noise: list[dict[str, float]] = field(default_factory=list)
    heldout: list[int] | None = None
    clean: bool = False
    contradictions: list[Any] | None = None
    refused: dict[tuple[str, str], float] = field(default_factory=dict)
    given: list[dict[str, float]] = field(default_factory=list)
    bands: list[Any] = field(default_factory=list)

    @property
    def band(self) -> tuple[float | None, float | None] | None:
        """The part that all of these bands share, Hz; None where displacements are measured in all records."""
        known = [band for band in self.bands if band is not None]
        if not known:
            return None
        lows, highs = ([band[k] for band in known if band[k] is not None] for k in (0, 1))
        return max(lows, default=None), min(highs, default=None)

    @cached_property
    def apart(self) -> SegmentSet:
        """The same motions with the DOFs fused one by one."""
        if self.clean:
            return self.data
        pieces, given = [], self.given or [{}] * len(self.records)
        bands = self.bands or [None] * len(self.records)
        for number, (rec, whole, known, band) in enumerate(zip(self.records, self.data.segments, given, bands)):
            if number in (self.heldout or ()):
                pieces.append(whole)
                continue
            smoother = KinematicSmoother(noise=known or "estimate", band=band, joint=False)
            one = _segment(rec, *to_features(rec, smoother))
            pieces.append(replace(whole, a=one.a, v=one.v, s=one.s))
        return SegmentSet(pieces, self.data.n_samples)


def prepare(
    records: Any,
    heldout: Any = None,
    noise: Sequence[dict[str, float]] | None = None,
    bands: Sequence[Any] | None = None,
) -> Prepared:
    """Fuse the channels of every record."""
    mine, kept = as_records(records, "records"), as_records(heldout, "heldout")
    if not mine:
        raise ChannelError("There is no record to search", "Pass a Record or a list of them.")
    every = [*mine, *kept]
    n = every[0].n_dof
    segments, found, told, at, clean = [], [], [], 0, True
    given = [{k: v for k, v in levels.items() if v > 0} for levels in noise or [{}] * len(every)]
    every = [_zeroed(rec) for rec in every]
    for rec, known, band in zip(every, given, bands or ["auto"] * len(every), strict=True):
        if rec.n_dof != n:
            raise ChannelError(
                f"Record {rec.name!r} has {rec.n_dof} DOFs, {n} are needed", "Give records of one chain."
            )
        smoother = KinematicSmoother(noise=known or "estimate", band=band)
        X, F = to_features(rec, smoother)
        told.append(smoother.band_)
        levels = {str(k): float(v) for k, v in smoother.noise_.items()}
        if _is_clean(rec, levels):
            X, F = to_features(rec, False)
        else:
            clean = False
        found.append(levels)
        piece = _segment(rec, X, F)
        piece.name, piece.rows = rec.name, slice(at, at + len(X))
        at += len(X)
        segments.append(piece)
    held = list(range(len(mine), len(every))) if kept else None
    return Prepared(every, SegmentSet(segments, at), found, held, clean, given=given, bands=told)


def _zeroed(record: Record) -> Record:
    """The record with the zero of displacements that no other channel knows at rest, or at the mean of the motion."""
    if record.displacement is None or record.acceleration is not None or record.velocity is not None:
        return record
    changes = {}
    for key in ("displacement", "base_displacement"):
        x = getattr(record, key)
        if x is not None:
            start = x[: max(4, len(x) // 500)]
            moves = np.nanstd(start, axis=0) > MOVES * np.nanstd(x, axis=0)
            changes[key] = x - np.where(moves, np.nanmean(x, axis=0), np.nanmean(start, axis=0))
    return record.replace(**changes)


def measured_of(ready: Prepared) -> list[Measured]:
    """What the records of a closed loop hold."""
    held = ready.heldout
    roles = ["searched, but for a quarter that is held out" if held is None else "searched" for _ in ready.records]
    for i in held or ():
        roles[i] = "held out"
    return [measured(rec, noise, role) for rec, noise, role in zip(ready.records, ready.noise, roles)]


def _segment(record: Record, X: pd.DataFrame, F: pd.DataFrame) -> Segment:
    """The fused motion of a record beside what was measured of its base and covariates."""
    ag = base_acceleration_if_any(record)
    return from_arrays(X, F, base_acceleration=ag, covariates=_covariates(record)).segments[0]


def as_records(records: Any, name: str) -> list[Record]:
    """A list of records, or an error."""
    if records is None:
        return []
    if isinstance(records, Record):
        return [records]
    if isinstance(records, Sequence) and all(isinstance(r, Record) for r in records):
        return list(records)
    raise ChannelError(
        f"{name} holds something that is not a Record", "Build them with Record(...) or Record.from_frame(df)."
    )


def _is_clean(record: Record, noise: dict[str, float]) -> bool:
    """Whether every motion is measured, and the channels of each DOF contradict each other by next to nothing."""
    channels = record.channels()
    wanted = [f"{kind}{j}" for kind in "avx" for j in range(1, record.n_dof + 1)]
    if any(name not in channels for name in wanted):
        return False
    return all(noise.get(name, np.inf) <= CLEAN * np.nanstd(channels[name]) for name in wanted)


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
        from ..signals import integrate

        vg = integrate(ag, record.dt)
    for name, line in (("ag", ag), ("vg", vg)):
        out.setdefault(name, line)
    return out
