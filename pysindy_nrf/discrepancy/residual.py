"""What a model leaves of the measured forces, what noise alone would leave, and the
force of every site for drawing.

The residual of balance j is the force the model lacks there,

    e_j = F_j - (m_j a_j + sum over sites of incidence * R)

so a law f that is missing at a site with incidence b leaves ``e = b f``: + in the
balance of the upper end, - in that of the lower one. Summed from the top, ``rho_i =
sum_{j >= i} e_j`` is the force missing across the cut below DOF i: of storey i alone on
a plain chain, and in general of storey i, of every link and ground link that crosses
the cut, and of the DOF sites above it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from ..chain.model import ChainModel
from ..chain.sites import Site
from ..equations.errors import free_run_of
from ..exceptions import ChannelError, NRFError
from ..records.dataset import BlockRows, Dataset, Segment
from ..records.fusion.kinematics import base_acceleration_if_any
from ..records.fusion.noise_levels import levels_of, noisy_base, quiet_drive
from ..records.record import Record
from .prepare import Prepared, Workspace, prepare
from .ruler import Ruler, Trial
from .windows import Windows, period_of

# Samples looked at: enough to see any effect, and little beside the search.
ENOUGH = 10_000
# Points of a drawn loop: a file that opens at once, and no cycle loses its shape.
_CYCLES, _PER_CYCLE = 6, 40  # of a loop that is drawn: more hide each other
_MOTIONS = ("acceleration", "velocity", "displacement")


@dataclass
class Residual:
    """One-step residual of a model, record by record."""

    model: ChainModel
    data: Dataset
    filters: list[Any]  # one for each record; the residual has passed it
    balance: list[
        np.ndarray
        # e_j, N, shape (n_valid_samples, n_dof); a column of NaN where the force is
        # unknown
    ]
    # Rows "dof j" and "storey i"; columns "reference" (rms, N) and "of": a balance is
    # measured by F, or by m a where no force acts; a storey by the force across its
    # cut, sum_{j >= i} (F_j - m_j a_j).
    reference: pd.DataFrame
    # rms of the model's force in storey j (of the reference of balance j if that is
    # zero), N
    scale: np.ndarray
    columns: dict[Any, Any] = field(
        default_factory=dict
    )  # of the motion, for every model

    @property
    def n_dof(self) -> int:
        """Number of balances."""
        return self.model.n_dof

    @cached_property
    def storey(self) -> list[np.ndarray]:
        """rho_i of each record, N, shape (n_valid_samples, n_dof); NaN if a balance
        above is not known.
        """
        return [from_top(e) for e in self.balance]

    @property
    def known(self) -> np.ndarray:
        """Balances whose force is known, shape (n_records, n_dof)."""
        return np.array([~np.isnan(e[0]) for e in self.balance])

    @cached_property
    def sizes(self) -> pd.DataFrame:
        """The references with ``rms`` (N) and ``percent`` of every balance and
        storey.
        """
        left = np.concatenate([rms(self.balance), rms(self.storey)])
        size = self.reference["reference"].to_numpy()
        percent = 100 * np.divide(
            left, size, out=np.full(len(left), np.nan), where=size > 0
        )
        return self.reference.assign(rms=left, percent=percent)[
            ["rms", "percent", "reference", "of"]
        ]

    def at(self, name: str) -> list[np.ndarray]:
        """Residual of one balance (``"dof 2"``) or storey (``"storey 2"``), one array
        for each record, N.
        """
        kind, _, number = name.partition(" ")
        return [
            part[:, int(number) - 1]
            for part in (self.balance if kind == "dof" else self.storey)
        ]


def from_top(columns: np.ndarray) -> np.ndarray:
    """Sums over the DOFs from the top down to each, shape kept: column i holds ``sum_{j
    >= i}``.
    """
    return np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rms of every column over records that may hold columns of NaN; NaN if unknown in
    all.
    """
    squares = sum(np.nansum(p**2, axis=0) for p in parts)
    count = sum(np.isfinite(p).sum(axis=0) for p in parts)
    return np.sqrt(
        np.divide(
            squares, count, out=np.full(np.shape(squares), np.nan), where=count > 0
        )
    )


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


def residual_of(
    model: ChainModel,
    data: Any,
    filters: Sequence[Any] | None = None,
    forces: Sequence[np.ndarray] | None = None,
) -> Residual:
    """One-step residual of a model through filters; forces of its sites are its own
    unless they are given.
    """
    data = model.segments(data)
    filters = [None] * len(data.segments) if filters is None else list(filters)
    forces = model.site_forces(data) if forces is None else forces
    found: tuple[list[np.ndarray], ...] = ([], [], [], [])
    own = {site: k for k, site in enumerate(model.laws)}
    pick = [own.get(model.chain.site(j)) for j in range(1, model.n_dof + 1)]
    incidence = model.chain.incidence(model.laws)
    for seg, filter, R in zip(data.segments, filters, forces, strict=True):
        inertia, force = (
            seg.a[seg.valid].astype(float) * model.masses,
            seg.F[seg.valid].astype(float),
        )
        storey = np.column_stack(
            [np.zeros(len(R)) if k is None else R[:, k] for k in pick]
        )
        for out, part in zip(
            found, (force - inertia - R @ incidence.T, inertia, force, storey)
        ):
            out.append(part if filter is None else filter.apply(part))
    balance, inertias, applied, storeys = found
    if not any(np.isfinite(e[0]).any() for e in balance):
        cure = "Give F, with zeros on DOFs known to be unforced."
        raise ChannelError(
            "The force is unknown on every DOF, so no balance has a residual", cure
        )
    size = rms(applied)
    inertia = rms([np.where(np.isnan(f), np.nan, i) for i, f in zip(inertias, applied)])
    cut = rms([from_top(f - i) for f, i in zip(applied, inertias)])
    reference = pd.DataFrame(
        {
            "reference": np.concatenate([np.where(size > 0, size, inertia), cut]),
            "of": np.concatenate(
                [np.where(size > 0, "F", "m a"), np.repeat("storey force", model.n_dof)]
            ),
        },
        index=[
            f"{kind} {j}"
            for kind in ("dof", "storey")
            for j in range(1, model.n_dof + 1)
        ],
    )
    scale, other = rms(storeys), reference["reference"].to_numpy()[: model.n_dof]
    scale = np.where(scale > 0, scale, np.where(other > 0, other, 1.0))
    return Residual(model, data, filters, balance, reference, scale)


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


@dataclass
class SiteLoop:
    """Force of one site along a stretch of data, thinned for drawing."""

    site: str
    record: str
    t: np.ndarray
    s: np.ndarray
    v: np.ndarray
    identified: np.ndarray
    measured: np.ndarray | None = None


def loops_of(
    model: ChainModel, data: Dataset, filters: Sequence[Any] | None = None
) -> list[SiteLoop]:
    """Forces of all sites that hold a law, along the strongest stretch of the data; all
    lines pass the filters.
    """
    filters = [None] * len(data.segments) if filters is None else list(filters)
    try:
        storeys = residual_of(model, data, filters).storey
    except NRFError:
        storeys = [np.full((seg.n_valid, model.n_dof), np.nan) for seg in data.segments]
    out = []
    for site, force in model.restoring_forces.items():
        with suppress(
            NRFError
        ):  # a law that needs what this record does not hold is not drawn
            out += [_loop(site, force, data, filters, storeys)] if force.laws else []
    return out


def _loop(
    site: Site,
    force: Any,
    data: Dataset,
    filters: list[Any],
    storeys: list[np.ndarray],
) -> SiteLoop:
    motions = [seg.motion(site, seg.valid) for seg in data.segments]
    which = int(np.argmax([np.abs(m.s).max() for m in motions]))
    m, filter, seg = motions[which], filters[which], data.segments[which]
    # a law that remembers starts fresh with the stretch, and needs a cycle or two to
    # forget that
    first = len(m.s) // 10 if force.has_memory else 0
    period = period_of([m.s])
    step, width = (
        int(max(1, period // _PER_CYCLE)),
        min(len(m.s) - first, int(_CYCLES * period) + 1),
    )
    start = int(
        np.clip(int(np.abs(m.s).argmax()) - width // 2, first, len(m.s) - width)
    )
    rows = slice(start, start + width, step)

    def drawn(line: np.ndarray) -> np.ndarray:
        return (line if filter is None else filter.apply(line))[rows]

    R = force.along(m)
    t = np.arange(len(R), dtype=float) if m.t is None else m.t
    identified, measured = drawn(R), None
    if site.is_storey and np.isfinite(storeys[which][:, site.p - 1]).all():
        measured = identified + storeys[which][rows, site.p - 1]
    return SiteLoop(
        str(site), seg.name, t[rows], drawn(m.s), drawn(m.v), identified, measured
    )
