"""What noise alone would leave in the balances: from repeated tests, from the channels, or given."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..common.random_state import generator
from ..data.record import Record
from ..exceptions import ChannelError, NRFError
from ..regression.chain_model import ChainModel
from ..regression.input_arrays import from_arrays
from ..regression.segments import SegmentSet
from ..signals.kinematics import to_features
from .noise_level import BASE, levels_of, noisy_base, quiet_drive
from .residual import Residual, free_run, from_top, residual_of, rms

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
        data = SegmentSet([piece for _, piece in simulated.pieces()], simulated.data.n_samples)
        filters = [work.filters[work.searched[i]] for i, _ in simulated.pieces()]
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
