"""What a model leaves of the measured forces: one step at a time, and in a free run.

The residual of balance j is the force the model lacks there,

    e_j = F_j - (m_j a_j + sum over sites of incidence * R)

so a law f that is missing at a site with incidence b leaves ``e = b f``: + in the balance of the
upper end, - in that of the lower one. Summed from the top, ``rho_i = sum_{j >= i} e_j`` is the force
missing across the cut below DOF i: of storey i alone on a plain chain, and in general of storey i,
of every link and ground link that crosses the cut, and of the DOF sites above it.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from ..common.random_state import generator
from ..data.record import Record
from ..exceptions import ChannelError, NRFError, SimulationError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.errors import free_run_of
from ..regression.input_arrays import from_arrays
from ..regression.segments import Segment, SegmentSet
from ..signals.kinematics import to_features
from .noise_level import BASE, levels_of, noisy_base, quiet_drive

# Residuals below this share of their reference are rounding.
ROUND_OFF = 1e-9


@dataclass
class Residual:
    """One-step residual of a model, record by record.

    Attributes
    ----------
    model : ChainModel
    data : SegmentSet
    filters : list of FairFilter or None
        One for each record; the residual has passed it.
    balance : list of ndarray of shape (n_valid_samples, n_dof)
        e_j, N; a column of NaN where the force on the DOF is unknown.
    sizes : DataFrame
        Rows ``"dof j"`` and ``"storey i"``; columns ``rms`` (N), ``percent`` (of the reference),
        ``reference`` (rms, N), ``of``: a balance is measured by F, or by m a where no force acts; a
        storey by the force across its cut, ``sum_{j >= i} (F_j - m_j a_j)``.
    scale : ndarray of shape (n_dof,)
        Rms of the model's force in storey j (of the reference of balance j if that is zero), N.
    """

    model: ChainModel
    data: SegmentSet
    filters: list[Any]
    balance: list[np.ndarray]
    sizes: pd.DataFrame
    scale: np.ndarray

    @property
    def n_dof(self) -> int:
        """Number of balances."""
        return self.model.n_dof

    @property
    def storey(self) -> list[np.ndarray]:
        """rho_i of each record, N, shape (n_valid_samples, n_dof); NaN if a balance above is not known."""
        return [from_top(e) for e in self.balance]

    @property
    def known(self) -> np.ndarray:
        """Balances whose force is known, shape (n_records, n_dof)."""
        return np.array([~np.isnan(e[0]) for e in self.balance])

    @property
    def is_round_off(self) -> bool:
        """Whether every balance closes to rounding."""
        size = self.sizes.iloc[: self.n_dof].dropna(subset="rms")
        return bool((size["rms"] <= ROUND_OFF * size["reference"]).all())

    def with_balance(self, balance: Sequence[np.ndarray]) -> Residual:
        """The same with other residuals of the balances, N, and their sizes."""
        left = np.concatenate([rms(balance), rms([from_top(e) for e in balance])])
        reference = self.sizes["reference"].to_numpy()
        percent = 100 * np.divide(left, reference, out=np.full(len(left), np.nan), where=reference > 0)
        sizes = self.sizes.assign(rms=left, percent=percent)
        return Residual(self.model, self.data, self.filters, list(balance), sizes, self.scale)

    def at(self, name: str) -> list[np.ndarray]:
        """Residual of one balance (``"dof 2"``) or storey (``"storey 2"``), one array for each record, N."""
        kind, _, number = name.partition(" ")
        if kind not in ("dof", "storey") or not number.isdigit() or not 1 <= int(number) <= self.n_dof:
            raise ChannelError(f"The residual has no {name!r}", f"Use 'dof 1'.. or 'storey 1'.. up to {self.n_dof}.")
        parts = self.balance if kind == "dof" else self.storey
        return [part[:, int(number) - 1] for part in parts]

    def __str__(self) -> str:
        rows = [f"{name}: {r.rms:.4g} N, {r.percent:.3g} % of {r.of}" for name, r in self.sizes.iterrows()]
        return "\n".join(rows)


def from_top(columns: np.ndarray) -> np.ndarray:
    """Sums over the DOFs from the top down to each, shape kept: column i holds ``sum_{j >= i}``."""
    return np.cumsum(columns[:, ::-1], axis=1)[:, ::-1]


def period_of(parts: Sequence[np.ndarray]) -> float:
    """Samples of a period at the rms frequency of a signal; 16 if it does not move."""
    pace = sum(float(np.sum(np.diff(p) ** 2)) for p in parts)
    size = sum(float(np.sum((p - p.mean()) ** 2)) for p in parts)
    return 2 * np.pi / max(np.sqrt(pace / size), 1e-6) if size > 0 else 16.0


def rms(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rms of every column over records that may hold columns of NaN; NaN if unknown in all."""
    squares = sum(np.nansum(p**2, axis=0) for p in parts)
    count = sum(np.isfinite(p).sum(axis=0) for p in parts)
    return np.sqrt(np.divide(squares, count, out=np.full(np.shape(squares), np.nan), where=count > 0))


def filters_of(data: SegmentSet, filters: Any = None, band: Any = None) -> list[Any]:
    """One filter for each record, from what a user gave."""
    if filters is None:
        from ..signals.zero_phase_filter import filters_of

        return filters_of(band, data)
    if band is not None:
        raise ChannelError("Both filters and band were given", "Give one of them.")
    filters = list(filters)
    if len(filters) != len(data.segments):
        raise ChannelError(
            f"{len(filters)} filters for {len(data.segments)} records", "Give one for each record, or a band."
        )
    return filters


def residual_of(model: ChainModel, data: Any, filters: Any = None, *, band: Any = None) -> Residual:
    """One-step residual of a model in a frequency band."""
    data = model.segments(data)
    filters = filters_of(data, filters, band)
    found: tuple[list[np.ndarray], ...] = ([], [], [], [])
    balances, inertias, forces, storeys = found
    own = {site: k for k, site in enumerate(model.laws)}
    pick = [own.get(model.chain.site(j)) for j in range(1, model.n_dof + 1)]
    incidence = model.chain.incidence(model.laws)
    for seg, filter, R in zip(data.segments, filters, model.site_forces(data)):
        inertia, force = seg.a[seg.valid].astype(float) * model.masses, seg.F[seg.valid].astype(float)
        storey = np.column_stack([np.zeros(len(R)) if k is None else R[:, k] for k in pick])
        parts = [force - inertia - R @ incidence.T, inertia, force, storey]
        for out, part in zip(found, parts):
            out.append(part if filter is None else filter.apply(part))
    if not np.isfinite(balances[0][0]).any() and not any(np.isfinite(e[0]).any() for e in balances):
        raise ChannelError(
            "The force is unknown on every DOF, so no balance has a residual",
            "Give F, with zeros on DOFs known to be unforced.",
        )
    sizes = _sizes(balances, inertias, forces)
    scale = rms(storeys)
    reference = sizes["reference"].to_numpy()[: model.n_dof]
    scale = np.where(scale > 0, scale, np.where(reference > 0, reference, 1.0))
    return Residual(model, data, filters, balances, sizes, scale)


def _sizes(balances: list[np.ndarray], inertias: list[np.ndarray], forces: list[np.ndarray]) -> pd.DataFrame:
    n = balances[0].shape[1]
    force = rms(forces)
    inertia = rms([np.where(np.isnan(f), np.nan, i) for i, f in zip(inertias, forces)])
    cut = rms([from_top(f - i) for f, i in zip(forces, inertias)])
    left = np.concatenate([rms(balances), rms([from_top(e) for e in balances])])
    reference = np.concatenate([np.where(force > 0, force, inertia), cut])
    of = np.concatenate([np.where(force > 0, "F", "m a"), np.repeat("storey force", n)])
    percent = 100 * np.divide(left, reference, out=np.full(2 * n, np.nan), where=reference > 0)
    names = [f"{kind} {j}" for kind in ("dof", "storey") for j in range(1, n + 1)]
    return pd.DataFrame({"rms": left, "percent": percent, "reference": reference, "of": of}, index=names)


@dataclass
class FreeRunResidual:
    """Measured minus simulated motion of a free run, record by record.

    Attributes
    ----------
    displacement, acceleration : list of ndarray of shape (n_valid_samples, n_dof)
        Relative to the base (m) and absolute (m/s^2), filtered; NaN where no free run is possible.
    sizes : DataFrame
        Rows ``"dof j"``; percent NRMSE of displacement and acceleration over all records.
    reasons : list of str
        Why a record could not be run; empty text where it could.
    """

    displacement: list[np.ndarray]
    acceleration: list[np.ndarray]
    sizes: pd.DataFrame
    reasons: list[str] = field(default_factory=list)


def free_run_residual(
    model: ChainModel, data: Any, filters: Any = None, *, band: Any = None, **options: Any
) -> FreeRunResidual:
    """Residual of the free run under the measured forces, from the state at the first sample."""
    data = model.segments(data)
    filters = filters_of(data, filters, band)
    left: tuple[list, list] = ([], [])
    measured: tuple[list, list] = ([], [])
    reasons = []
    for seg, filter in zip(data.segments, filters):
        rows = seg.valid
        pair = [np.cumsum(seg.s[rows].astype(float), axis=1), seg.a[rows].astype(float)]
        run, why = free_run(model, seg, options)
        reasons.append(why)
        for k, y in enumerate(pair):
            if run is None:
                left[k].append(np.full(y.shape, np.nan))
                measured[k].append(left[k][-1])
                continue
            parts = [y - (run.acceleration if k else run.displacement), y]
            parts = parts if filter is None else [filter.apply(p) for p in parts]
            left[k].append(parts[0])
            measured[k].append(parts[1])
    percent = [100 * rms(e) / rms(y) for e, y in zip(left, measured)]
    names = [f"dof {j}" for j in range(1, model.n_dof + 1)]
    sizes = pd.DataFrame(dict(zip(("displacement", "acceleration"), percent)), index=names)
    return FreeRunResidual(left[0], left[1], sizes, reasons)


def free_run(model: ChainModel, seg: Segment, options: dict[str, Any]) -> tuple[Record | None, str]:
    """Free run of one contiguous record from its first state, or the reason why there is none."""
    rows = seg.valid
    name = f"record {seg.name!r}"
    if seg.dt is None:
        return None, f"{name}: the sampling step is not known"
    if rows.stop - rows.start < 2:
        return None, f"{name} has a single sample"
    if np.isnan(seg.F[rows]).any():
        return None, f"{name}: the force on DOF {int(np.flatnonzero(np.isnan(seg.F[rows.start]))[0]) + 1} is unknown"
    if (model.masses <= 0).any():
        return None, f"{name}: m{int(np.argmin(model.masses)) + 1} is not positive"
    try:
        run = free_run_of(model, seg, name=seg.name, **options)
    except SimulationError as error:
        return None, f"{name}: {error.what}"
    return run, ""


# A residual within this factor of the noise floor is at the floor: the floor itself is known no better.
AT_FLOOR = 1.3
# One that is so many times the loudest draw of noise is no noise, however it correlates.
LOUD = 2.0
# One this far below it holds nothing but noise, whatever it correlates with.
BELOW_FLOOR = 0.8
# Rows in common that repeated records need.
FEWEST = 64


@dataclass
class NoiseFloor:
    """Residual that noise alone leaves.

    Attributes
    ----------
    balance, storey : ndarray of shape (n_dof,)
        Rms in balance j, and summed from the top in storey i, N; NaN where unknown.
    source : str
        Where it comes from, in words.
    draws : list of (Residual, SegmentSet)
        Residuals of noise alone, each with the noisy data that go with it; may be empty.
    """

    balance: np.ndarray
    storey: np.ndarray
    source: str
    draws: list[tuple[Residual, SegmentSet]] = field(default_factory=list)

    def at(self, name: str) -> float:
        """Rms at one balance (``"dof 2"``) or storey (``"storey 2"``), N."""
        kind, _, number = name.partition(" ")
        return float((self.balance if kind == "dof" else self.storey)[int(number) - 1])

    def covariance(self) -> np.ndarray:
        """Covariance of the noise between the balances, N^2, shape (n_dof, n_dof)."""
        if not self.draws:
            return np.diag(self.balance**2)
        parts = [e for residual, _ in self.draws for e in residual.balance]
        known = np.isfinite(self.balance)
        out = np.full((len(known), len(known)), np.nan)
        inside = np.ix_(known, known)
        parts = [p[:, known] for p in parts if np.isfinite(p[0, known]).all()]
        if parts:
            out[inside] = sum(p.T @ p for p in parts) / sum(len(p) for p in parts)
        else:
            out[inside] = np.diag(self.balance[known] ** 2)
        return out

    @classmethod
    def given(cls, levels: Any, n_dof: int) -> NoiseFloor:
        """Noise floor that the user knows."""
        if isinstance(levels, Mapping):
            wrong = [j for j in levels if j not in range(1, n_dof + 1)]
            if wrong:
                raise ChannelError(
                    f"The noise floor names balance {wrong[0]!r}", f"The chain has balances 1 to {n_dof}."
                )
            levels = [levels.get(j, np.nan) for j in range(1, n_dof + 1)]
        values = np.asarray(levels, dtype=float)
        if values.ndim and values.shape != (n_dof,):
            raise ChannelError(
                f"{values.size} noise levels for {n_dof} balances", "Give the rms of the noise in each balance, N."
            )
        values = np.broadcast_to(values, (n_dof,)).copy()
        if (values < 0).any() or np.isinf(values).any():
            raise ChannelError("A noise floor is negative or infinite", "Give the rms of the noise in each balance, N.")
        return cls(values, np.sqrt(from_top(values[None] ** 2)[0]), "given by the user")

    @classmethod
    def from_repeats(cls, residual: Residual) -> NoiseFloor:
        """Noise floor from the same test done several times."""
        every = residual.balance
        count = len(every)
        if count < 2 or len({len(e) for e in every}) > 1:
            raise ChannelError(
                f"{count} records of {sorted({len(e) for e in every})} samples are no repetitions of one test",
                "Give at least two records of equal length under the same force.",
            )
        forces = np.array([np.nan_to_num(seg.F[seg.valid].astype(float)) for seg in residual.data.segments])
        bases = [seg.ag[seg.valid] for seg in residual.data.segments if seg.ag is not None]
        drive = forces if forces.any() else np.array(bases) if len(bases) == count else forces
        common = drive.mean(axis=0)
        if drive.any() and np.sqrt(np.mean((drive - common) ** 2)) > 0.2 * np.sqrt(np.mean(common**2)):
            raise ChannelError(
                "The records were not excited alike, so their difference is not noise",
                "Align repetitions of one test sample by sample, or use NoiseFloor.from_channels.",
            )
        mean = np.mean(every, axis=0)
        factor = np.sqrt(count / (count - 1))
        deviations = [factor * (e - mean) for e in every]
        noise = Residual(residual.model, residual.data, residual.filters, deviations, residual.sizes, residual.scale)
        return cls.from_draws([(noise, residual.data)], f"{count} repeated records")

    @classmethod
    def from_channels(
        cls,
        model: ChainModel,
        records: Record | Sequence[Record],
        filters: Any = None,
        *,
        band: Any = None,
        noise: Mapping[str, float] | None = None,
        smooth: bool = True,
        regressor: Any = None,
        n_draws: int = 4,
        random_state: Any = None,
    ) -> NoiseFloor:
        """Noise floor from the channels' own contradictions."""
        records = [records] if isinstance(records, Record) else list(records)
        rng = generator(random_state)
        measured = [_Measured.of(rec, dict(noise or {})) for rec in records]
        if regressor is not None and not smooth:
            model = _fitted(regressor, _together([m.data for m in measured]))
        prepared = [_Clean.of(m, model) for m in measured]
        whole = _together([p.data for p in prepared])
        own = model if regressor is None else _fitted(regressor, whole)
        base = residual_of(own, whole, filters, band=band)
        draws = []
        for _ in range(n_draws):
            data = _together([p.draw(rng, smooth) for p in prepared])
            moved = residual_of(model if regressor is None else _fitted(regressor, data), data, base.filters)
            moved.balance = [_difference(a, b) for a, b in zip(moved.balance, base.balance)]
            draws.append((moved, data))
        return cls.from_draws(draws, "noise of the channels, as their contradictions show it")

    @classmethod
    def from_draws(cls, draws: list[tuple[Residual, SegmentSet]], source: str) -> NoiseFloor:
        """Noise floor from residuals of noise alone."""
        parts = [e for residual, _ in draws for e in residual.balance]
        return cls(rms(parts), rms([from_top(e) for e in parts]), source, draws)


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    size = min(len(a), len(b))
    return a[:size] - b[:size]


def _together(pieces: Sequence[SegmentSet]) -> SegmentSet:
    segments, at = [], 0
    for piece in pieces:
        for seg in piece.segments:
            seg.rows = slice(at, at + seg.n_samples)
            at += seg.n_samples
            segments.append(seg)
    return SegmentSet(segments, at)


def _fitted(regressor: Any, data: SegmentSet) -> ChainModel:
    """The model that an estimator finds in these data."""
    from sklearn.base import clone

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is to be said of the data was said of the measured ones
        model: ChainModel = clone(regressor).fit(data).model_
    return model


@dataclass
class _Measured:
    """A record, its motion fused, and the noise levels of its channels."""

    record: Record
    levels: dict[str, float]
    data: SegmentSet

    @classmethod
    def of(cls, record: Record, given: dict[str, float]) -> _Measured:
        from ..signals.kinematic_smoother import KinematicSmoother

        known = {k: v for k, v in given.items() if not k.startswith("F") and k not in BASE and v > 0}
        smoother = KinematicSmoother(noise=known or "estimate", band="auto")
        X, F = to_features(record, smoother)
        levels = levels_of(record, smoother.noise_) | given
        return cls(record, {k: v for k, v in levels.items() if k in record.channels()}, _segments(record, X, F))


@dataclass
class _Clean:
    """A record without noise, and the noise levels of its channels."""

    record: Record
    levels: dict[str, float]
    data: SegmentSet

    @classmethod
    def of(cls, measured: _Measured, model: ChainModel) -> _Clean:
        levels = measured.levels
        record = quiet_drive(measured.record, levels)
        seg = measured.data.segments[0]
        ag = record.base_acceleration
        run, _ = free_run(model, replace(seg, F=record.force, ag=seg.ag if ag is None else ag), {})
        motion = [seg.a.copy(), np.cumsum(seg.v, axis=1), np.cumsum(seg.s, axis=1)]
        if run is not None:
            for whole, part in zip(motion, (run.acceleration, run.velocity, run.displacement)):
                whole[seg.valid] = part
        clean = record.replace(
            coordinates="relative", **dict(zip(("acceleration", "velocity", "displacement"), motion))
        )
        return cls(clean, levels, _segments(record, *to_features(clean, False)))

    def draw(self, rng: np.random.Generator, smooth: bool) -> SegmentSet:
        """The record with fresh noise on its measured channels, treated like a measurement."""
        changes = {}
        for key, prefix in (("force", "F"), ("acceleration", "a"), ("velocity", "v"), ("displacement", "x")):
            values = np.array(getattr(self.record, key), dtype=float)
            for j in range(self.record.n_dof):
                name = f"{prefix}{j + 1}"
                if name in self.levels:
                    values[:, j] += self.levels[name] * rng.standard_normal(len(values))
                elif prefix != "F" and smooth:
                    values[:, j] = np.nan
            changes[key] = values
        changes |= noisy_base(self.record, self.levels, rng)
        noisy = self.record.replace(**changes)
        return _segments(noisy, *to_features(noisy, smooth))


def _segments(record: Record, X: Any, F: Any) -> SegmentSet:
    return from_arrays(X, F, base_acceleration=record.base_acceleration, covariates=record.covariates)


def floor_of(given: Any, work: Any, model: ChainModel, simulated: Any) -> tuple[NoiseFloor | None, str]:
    """The noise floor that a user gave or asked for, and where it comes from."""
    if isinstance(given, NoiseFloor):
        if len(given.balance) != work.n_dof:
            raise ChannelError(
                f"The noise floor has {len(given.balance)} balances, the chain {work.n_dof}",
                "Make it of records of the same chain.",
            )
        return given, given.source
    if isinstance(given, str) and given == "repeats":
        floor = NoiseFloor.from_repeats(_repeated(work, model))
        return floor, floor.source
    if isinstance(given, str) and given == "channels":
        if simulated is None:
            return None, "not known: the model has no free run"
        pieces = simulated.pieces()
        data = SegmentSet([piece for _, piece in pieces], simulated.data.n_samples)
        filters = [work.filters[work.searched[i]] for i, _ in pieces]
        source = "a free run of the model with the noise of the channels"
        return NoiseFloor.from_draws([(residual_of(model, data, filters), data)], source), source
    if isinstance(given, (Mapping, float, int, list, tuple, np.ndarray)) and not isinstance(given, bool):
        return NoiseFloor.given(given, work.n_dof), "given by the user"
    raise ChannelError(
        f"noise_floor={given!r} is unknown",
        "Choose 'channels' or 'repeats', or give the rms of the noise in each balance, N: {dof: rms}.",
    )


def _repeated(work: Any, model: ChainModel) -> Residual:
    """Residual of repeated records along the rows that the search may see in all of them."""
    used = list(work.searched)
    segments = [work.data.segments[i] for i in used]
    least = min(seg.n_samples for seg in segments)
    seen = np.all([work.seen_rows(i)[:least] for i in used], axis=0)
    runs = np.flatnonzero(np.diff(np.r_[False, seen, False].astype(int))).reshape(-1, 2)
    first, last = max(runs, key=lambda r: r[1] - r[0]) if len(runs) else (0, 0)
    if len(used) < 2 or last - first < FEWEST:
        raise ChannelError(
            f"{len(used)} record{'s' * (len(used) != 1)} with {last - first} rows in common tell no noise",
            "Give repetitions of one test, aligned sample by sample, or noise_floor='channels'.",
        )
    data = SegmentSet(segments, work.data.n_samples)
    whole = residual_of(model, data, [work.filters[i] for i in used])
    pieces = [replace(seg, valid=slice(int(first), int(last))) for seg in segments]
    cut = [e[first - seg.valid.start : last - seg.valid.start] for e, seg in zip(whole.balance, segments)]
    return replace(whole, data=SegmentSet(pieces, work.data.n_samples)).with_balance(cut)


# Points of a drawn loop: a file that opens at once, and no cycle loses its shape.
_POINTS = 1000
_PER_CYCLE = 40


@dataclass
class SiteLoop:
    """One site along a stretch of data."""

    site: str
    record: str
    t: np.ndarray
    s: np.ndarray
    v: np.ndarray
    identified: np.ndarray
    measured: np.ndarray | None = None


def loops_of(model: ChainModel, data: SegmentSet, filters: Sequence[Any] | None = None) -> list[SiteLoop]:
    """Forces of all sites that hold a law, along the strongest stretch of the data; all lines pass the filters."""
    filters = [None] * len(data.segments) if filters is None else list(filters)
    try:
        storeys = residual_of(model, data, filters).storey
    except NRFError:
        storeys = [np.full((seg.n_valid, model.n_dof), np.nan) for seg in data.segments]
    out = []
    for site, force in model.restoring_forces.items():
        if not force.laws:
            continue
        try:
            out.append(_loop(site, force, data, filters, storeys))
        except NRFError:  # a law that needs what this record does not hold is not drawn
            continue
    return out


def _loop(site: Site, force: Any, data: SegmentSet, filters: list[Any], storeys: list[np.ndarray]) -> SiteLoop:
    motions = [seg.motion(site, seg.valid) for seg in data.segments]
    which = int(np.argmax([np.abs(m.s).max() for m in motions]))
    m, filter, seg = motions[which], filters[which], data.segments[which]
    # a law that remembers starts fresh with the stretch, and needs a cycle or two to forget that
    step, rows = _window(m.s, len(m.s) // 10 if force.has_memory else 0)

    def drawn(line: np.ndarray) -> np.ndarray:
        return (line if filter is None else filter.apply(line))[rows][::step]

    R = force.along(m)
    rest = storeys[which][:, site.p - 1] if site.is_storey else np.full(len(R), np.nan)
    identified = drawn(R)
    t = np.arange(len(R), dtype=float) if m.t is None else m.t
    return SiteLoop(
        str(site),
        seg.name,
        t[rows][::step],
        drawn(m.s),
        drawn(m.v),
        identified,
        identified + rest[rows][::step] if np.isfinite(rest).all() else None,
    )


def _window(s: np.ndarray, first: int) -> tuple[int, slice]:
    """Every how many samples to draw, and a stretch around the largest motion."""
    step = int(max(1, min(period_of([s]) // _PER_CYCLE, len(s) // _POINTS)))
    width = min(len(s) - first, _POINTS * step)
    start = int(np.clip(int(np.abs(s).argmax()) - width // 2, first, len(s) - width))
    return step, slice(start, start + width)
