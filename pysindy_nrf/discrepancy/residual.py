"""What a model leaves of the forces on the search data, and what noise alone leaves."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..chain.model import ChainModel
from ..diagnosis.residual import Residual, from_top, residual_of, rms
from ..equations.errors import free_run_of
from ..exceptions import NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from ..records.fusion.kinematics import base_acceleration_if_any
from ..records.fusion.noise_levels import levels_of, noisy_base, quiet_drive
from ..records.record import Record
from .prepare import Prepared, Workspace, prepare
from .ruler import Ruler, Trial
from .windows import Windows

# Samples looked at: enough to see any effect, and little beside the search.
ENOUGH = 10_000
_MOTIONS = ("acceleration", "velocity", "displacement")


def searched(work: Workspace, most: int = ENOUGH) -> tuple[Dataset, list[Any]]:
    """The part of the data that the search may see, cut to so many samples, and the
    filter of each record.
    """
    parts = work.pieces()
    share = min(1.0, most / max(sum(piece.n_valid for _, piece in parts), 1))
    longest = {i: max(piece.n_valid for k, piece in parts if k == i) for i, _ in parts}
    kept = [(i, piece) for i, piece in parts if 4 * piece.n_valid >= longest[i]]
    pieces = [
        replace(
            piece,
            valid=slice(
                piece.valid.start,
                piece.valid.start + int(np.ceil(share * piece.n_valid)),
            ),
        )
        for _, piece in kept
    ]
    return Dataset(pieces, work.data.n_samples), [work.filters[i] for i, _ in kept]


def searched_residual(work: Workspace, model: ChainModel) -> Residual:
    """Residual on the search data; laws that remember the path follow it from the start
    of the record.
    """
    data, filters = searched(work)
    if not model.has_memory:
        return replace(residual_of(model, data, filters), columns=work.made)
    whole = {
        id(seg.s): (seg, R)
        for seg, R in zip(work.data.segments, model.site_forces(work.data))
    }
    forces = []
    for piece in data.segments:
        seg, R = whole[id(piece.s)]
        start = piece.valid.start - seg.valid.start
        forces.append(R[start : start + piece.n_valid])
    return replace(residual_of(model, data, filters, forces=forces), columns=work.made)


@dataclass
class NoiseFloor:
    """Residual that noise alone leaves: rms in balance j, and summed from the top in
    storey i, N; NaN where unknown.
    """

    balance: np.ndarray
    storey: np.ndarray
    draws: list[Residual] = field(
        default_factory=list
    )  # residuals of noise alone; may be empty
    motions: dict[Any, list[Any]] = field(
        default_factory=dict
    )  # and what detection makes of them

    def at(self, name: str) -> float:
        """Rms at one balance (``"dof 2"``) or storey (``"storey 2"``), N."""
        kind, _, number = name.partition(" ")
        return float((self.balance if kind == "dof" else self.storey)[int(number) - 1])

    def covariance(self) -> np.ndarray:
        """Covariance of the noise between the balances, N^2, shape (n_dof, n_dof)."""
        out = np.diag(self.balance**2)
        known = np.isfinite(self.balance)
        parts = [
            p[:, known]
            for r in self.draws
            for p in r.balance
            if np.isfinite(p[0, known]).all()
        ]
        if parts:
            out[np.ix_(known, known)] = sum(p.T @ p for p in parts) / sum(
                len(p) for p in parts
            )
        return out

    @classmethod
    def from_draws(cls, draws: list[Residual]) -> NoiseFloor:
        """Noise floor from residuals of noise alone."""
        parts = [e for residual in draws for e in residual.balance]
        return cls(rms(parts), rms([from_top(e) for e in parts]), draws)


def floor_of(model: ChainModel, noise: Workspace | None) -> NoiseFloor | None:
    """What noise alone leaves of the forces, from records of noise; None where the
    model has no free run.
    """
    return (
        None
        if noise is None
        else NoiseFloor.from_draws([residual_of(model, *searched(noise))])
    )


def simulated(
    ready: Prepared, trial: Trial, rng: Any, draws: int = 1
) -> Iterator[tuple[Prepared, Ruler]]:
    """Records, and the rulers on them, that the model of a trial, freed of the bias of
    noise, would have produced.

    The bias is found by the bootstrap itself (Efron and Tibshirani 1993, chapter 10):
    what the fit makes of records that the model produced, less the model. There is no
    draw where the model has no free run.
    """
    held = (
        (ready.records[i], ready.noise[i], trial.ruler.work.seen_rows(i))
        for i in trial.ruler.work.searched
    )
    noise = [levels_of(*one) for one in held]
    quiet = [
        quiet_drive(ready.records[i], levels)
        for i, levels in zip(trial.ruler.work.searched, noise)
    ]
    first = _produced(ready, trial, trial.model(), rng, noise, quiet)
    if first is None:
        return
    try:
        again = Trial(first[1], trial.base, trial.laws)
    except NRFError:
        yield first
        return
    unbiased = trial.model(
        2 * trial.masses[0] - again.masses[0], 2 * trial.theta[0] - again.theta[0]
    )
    made = (_produced(ready, trial, unbiased, rng, noise, quiet) for _ in range(draws))
    yield next(made) or first
    yield from filter(None, made)


def _produced(
    ready: Prepared,
    trial: Trial,
    model: ChainModel,
    rng: np.random.Generator,
    noise: list[dict],
    quiet: list[Record],
) -> tuple[Prepared, Ruler] | None:
    """Records of a free run with noise, of an element without mass the measured motion
    and its force; None if none.
    """
    work = trial.ruler.work
    if model.masses.any() and (model.masses <= 0).any():
        return None
    fakes = []
    try:
        for i, levels, drive in zip(work.searched, noise, quiet):
            fakes.append(
                _record(
                    ready.records[i], drive, work.data.segments[i], model, levels, rng
                )
            )
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # what is to be said of the channels was said of the measured ones
            made = prepare(fakes, None, *ready.like(work.searched))
    except NRFError:
        return None
    data, blocks = made.data, []
    for number, i in enumerate(work.searched):
        valid = data.segments[number].valid
        later = (
            work.data.segments[i].valid.start - valid.start
        )  # blocks count from the first valid row
        for b in (b for b in work.search if b.segment == i):
            ends = (
                min(max(row + later, 0), valid.stop - valid.start)
                for row in (b.rows.start, b.rows.stop)
            )
            blocks.append(BlockRows(number, slice(*ends)))
    fake = Workspace(data, blocks, [], work.known_masses)
    fake.filters = [work.filters[i] for i in work.searched]
    windows = trial.ruler.windows
    other = Windows(data, blocks, windows.length, windows.edges, windows.centred)
    return made, Ruler(
        fake, other, trial.ruler.informative, trial.ruler.clear, strict=False
    )


def _record(
    record: Record,
    quiet: Record,
    segment: Segment,
    model: ChainModel,
    noise: dict[str, float],
    rng: Any,
) -> Record:
    """The record the model would have produced, with fresh noise on the channels that
    were measured.
    """
    scatter = rng.standard_normal(record.force.shape) * [
        noise.get(f"F{j + 1}", 0.0) for j in range(record.n_dof)
    ]
    if not model.masses.any():
        force = np.array(record.force, dtype=float)
        force[segment.valid] = model.balance_forces(
            Dataset([segment], segment.n_samples)
        )[0]
        return record.replace(force=force + scatter)
    rows = _measured_rows(record)
    rest = np.zeros(record.n_dof)
    start = None if rows == segment.valid else (rest, rest)  # fusion left out the ends
    driven = replace(
        segment, F=np.nan_to_num(quiet.force), ag=base_acceleration_if_any(quiet)
    )
    # a force that is linear between samples has lost a tenth of itself at a fifth of
    # the sampling rate
    run = free_run_of(model, driven, rows, record.dt, start, hold="cubic")
    changes: dict[str, Any] = {}
    for key, prefix in zip(_MOTIONS, "avx"):
        measured = getattr(record, key)
        if measured is None:
            continue
        own = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            own[:, j] += noise.get(f"{prefix}{j + 1}", 0.0) * rng.standard_normal(
                len(own)
            )
            if np.isnan(measured[:, j]).all():
                own[:, j] = np.nan
        changes[key] = np.full(measured.shape, np.nan)
        changes[key][rows] = own
    changes |= noisy_base(quiet, noise, rng)
    changes["force"] = quiet.force + scatter
    return quiet.replace(coordinates="relative", **changes)


def _measured_rows(record: Record) -> slice:
    """From the first to the last row in which all channels of the motion have a
    value.
    """
    known = np.ones(record.n_samples, dtype=bool)
    for key in _MOTIONS:
        measured = getattr(record, key)
        if measured is not None:
            used = ~np.isnan(measured).all(axis=0)
            known &= np.isfinite(measured[:, used]).all(axis=1)
    inside = np.flatnonzero(known)
    return slice(int(inside[0]), int(inside[-1]) + 1)
