"""A null reference: the same search on data that hold no effect but the same noise."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import welch

from ..data.record import Record
from ..exceptions import NRFError
from ..mechanics.sites import Site
from ..regression.chain_model import ChainModel
from ..regression.chain_solve import Solution, model_of
from ..regression.errors import free_run_of
from ..regression.segments import BlockRows, Segment, SegmentSet
from ..signals.kinematics import base_acceleration_if_any
from .away_from_rest import leaving_rest
from .gate import FLOOR, gain_of
from .noise_floor import AT_FLOOR
from .noise_level import levels_of, lower_tail, noisy_base, quiet_drive
from .prepare import Prepared, prepare
from .search import Finding, refine, screen, validate
from .sensors import SensorFinding, null_gain
from .spectral_lines import lines_for
from .stage import Stage, Trial
from .workspace import Workspace

# Share of a mass or a force by which noise may make it wrong before that matters.
UNBIASED = 0.005
# Gain that noise can lend to the fault of a sensor which no other channel contradicts.
_OF_A_SENSOR = 0.5
# Surrogates that leave so many times what the measured records leave are not like them: another course of the forces
# between their samples is then tried.
_TOO_LOUD = 1.2
# And so many times: then they do not tell what noise leaves.
_UNLIKE = 1.5
_MOTIONS = ("acceleration", "velocity", "displacement")


def surrogate(
    record: Record,
    segment: Segment,
    model: ChainModel,
    noise: dict[str, float],
    rng: np.random.Generator,
    hold: str = "linear",
) -> Record:
    """The record the model would have produced, with fresh noise on the channels that were measured."""
    rows = _measured_rows(record)
    rest = np.zeros(record.n_dof)
    start = None if rows == segment.valid else (rest, rest)  # fusion left out the ends
    quiet = quiet_drive(record, noise)
    driven = replace(segment, F=np.nan_to_num(quiet.force), ag=base_acceleration_if_any(quiet))
    run = free_run_of(model, driven, rows, record.dt, start, hold=hold)
    changes: dict[str, Any] = {}
    for key, prefix in zip(_MOTIONS, "avx"):
        measured = getattr(record, key)
        if measured is None:
            continue
        own = np.array(getattr(run, key), dtype=float)
        for j in range(record.n_dof):
            level = noise.get(f"{prefix}{j + 1}", 0.0)
            own[:, j] += level * rng.standard_normal(len(own))
            if np.isnan(measured[:, j]).all():
                own[:, j] = np.nan
        changes[key] = np.full(measured.shape, np.nan)
        changes[key][rows] = own
    changes |= noisy_base(quiet, noise, rng)
    changes["force"] = quiet.force + rng.standard_normal(record.force.shape) * [
        noise.get(f"F{j + 1}", 0.0) for j in range(record.n_dof)
    ]
    return quiet.replace(coordinates="relative", **changes)


def _measured_rows(record: Record) -> slice:
    """From the first to the last row in which all channels of the motion have a value."""
    known = np.ones(record.n_samples, dtype=bool)
    for key in _MOTIONS:
        measured = getattr(record, key)
        if measured is not None:
            used = ~np.isnan(measured).all(axis=0)
            known &= np.isfinite(measured[:, used]).all(axis=1)
    inside = np.flatnonzero(known)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def force_noise(residual: np.ndarray, force: np.ndarray, fs: float, band: tuple | None = None) -> np.ndarray:
    """Noise of the forces: the white part of what the balances of the forced DOFs leave."""
    forced = np.nan_to_num(force).any(axis=0)
    size = min(256, len(residual))
    f, power = welch(residual, fs, nperseg=size, axis=0)
    low, high = band or (None, None)
    inside = (f >= (low or 0.0)) & (f <= (high or fs / 2))
    inside[[0, -1]] = False
    if not inside.any():
        return np.zeros(residual.shape[1])
    level = np.percentile(power[inside], 10, axis=0) / lower_tail(0.1, 2 * len(residual) // size - 1)
    return np.where(forced, np.minimum(np.sqrt(level * fs / 2), residual.std(axis=0)), 0.0)


def _finite(stages: Iterable[Stage]) -> list[Stage]:
    """Those that can be judged: the run of an unstable model says nothing."""
    return [stage for stage in stages if np.isfinite(stage.slot().folds()).all()]


class _Made(NamedTuple):
    """Surrogates, by how much noise makes the model wrong in two ways, what the surrogates were simulated with."""

    stages: list[Stage]
    bias: float = 0.0
    error: float = 0.0
    truth: Solution | None = None


class Null:
    """What the search would see if a model were the whole truth: its own free run with fresh noise.

    Parameters
    ----------
    ready : Prepared
        The measured records.
    stage : Stage
        The model.
    rng : numpy Generator
    count : int
        Surrogates.
    of : collection of Site, optional
        Sites whose forces count where it is asked how wrong noise makes the model; all if None.
    away : float, optional
        Share of the rms rate below which samples take no part in the fit of the model and of its surrogates, see
        :func:`pysindy_nrf.discrepancy.away_from_rest.leaving_rest`.
    hasty : bool
        Run no surrogates, and ask for no second opinion in their place.
    """

    def __init__(
        self,
        ready: Prepared,
        stage: Stage,
        rng: np.random.Generator,
        count: int,
        of: Collection[Site] | None = None,
        away: float | None = None,
        hasty: bool = False,
    ) -> None:
        self.ready, self.stage, self.rng, self.of, self.away = ready, stage, rng, of, away
        self.count, self.hasty = 0 if hasty else count, hasty

    def fitted(self, stage: Stage) -> Stage:
        """The model, or a surrogate of it, on the samples to which it is fitted."""
        return stage if self.away is None else leaving_rest(stage, self.away)

    def _solved(self, stage: Stage) -> Solution:
        return self.fitted(stage).trial().solve(range(len(stage.work.search)))

    @property
    def stages(self) -> list[Stage]:
        """The same laws on surrogate records; empty where no free run is possible."""
        return self._made.stages

    @property
    def bias(self) -> float:
        """By how much noise makes the model wrong: the largest share of a mass or of a site's terms; 0 if unknown."""
        return self._made.bias

    @property
    def error(self) -> float:
        """The same of masses and of the forces themselves, in the mean of the surrogates."""
        return self._made.error

    @property
    def truth(self) -> Solution | None:
        """Masses and coefficients that the surrogates were simulated with; None where there are none."""
        return self._made.truth

    @cached_property
    def _made(self) -> _Made:
        made = self._surrogates("linear")
        if made.stages and self._left(made.stages) > _TOO_LOUD * max(self._left([self.stage]), FLOOR):
            other = self._surrogates("cubic")
            if other.stages and self._left(other.stages) < self._left(made.stages):
                return other
        return made

    @staticmethod
    def _left(stages: list[Stage]) -> float:
        """Median validation error of some stages, percent."""
        return float(np.median([np.median(stage.trial().fold_errors()) for stage in stages]))

    def _surrogates(self, hold: str) -> _Made:
        try:
            trial = self.stage.trial()
            found = self._solved(self.stage)
            model = model_of(trial.layout, found)
            first = _finite(self._one(model, hold) for _ in range(self.count)) if (model.masses > 0).all() else []
        except (NRFError, np.linalg.LinAlgError):
            return _Made([])
        return self._like_the_truth(trial, found, first, hold) if first else _Made([])

    def _like_the_truth(self, trial: Trial, found: Solution, first: list[Stage], hold: str) -> _Made:
        """Surrogates of what the model would be if noise had not made it wrong, and how wrong it made it."""
        try:
            every = [self._solved(s) for s in first]
        except (NRFError, np.linalg.LinAlgError):
            return _Made(first, truth=found)
        shifts = [self._shift(trial, found, e) for e in every]
        bias = max(shifts)
        error = float(np.mean([self._shift(trial, found, e, whole=True) for e in every]))
        masses, coefficients = dict(found.masses), dict(found.coefficients)
        for j, m in found.masses.items():
            masses[j] = 2 * m - float(np.mean([e.masses[j] for e in every]))
        for site, c in found.coefficients.items():
            coefficients[site] = 2 * c - np.mean([e.coefficients[site] for e in every], axis=0)
        if bias < UNBIASED or min(masses.values()) <= 0:
            return _Made(first, bias, error, found)
        truth = replace(found, masses=masses, coefficients=coefficients)
        try:
            model = model_of(trial.layout, truth)
            second = _finite(self._one(model, hold) for _ in first)
        except (NRFError, np.linalg.LinAlgError):  # that one has no free run
            second = []
        return _Made(second, bias, error, truth) if second else _Made(first, bias, error, found)

    def _shift(self, trial: Trial, found: Solution, other: Solution, whole: bool = False) -> float:
        """Largest difference of two solutions, as a share of a mass or of a site's terms, or of its whole force."""
        gram = self.stage.grams.sum(axis=0)
        shares = [abs(other.masses[j] - m) / m for j, m in found.masses.items()]
        for site, c in found.coefficients.items():
            if self.of is not None and site not in self.of:
                continue
            rows = trial.layout.slices[site]
            weight = gram[rows, rows] if whole else np.diag(np.diag(gram)[rows])
            gap = other.coefficients[site] - c
            size = float(c @ weight @ c)
            shares.append(float(np.sqrt(max(gap @ weight @ gap, 0.0) / size)) if size > 0 else 0.0)
        return max(shares)

    def _one(self, model: ChainModel, hold: str) -> Stage:
        ready, work = self.ready, self.stage.work
        fakes = []
        for i in work.searched:
            noise = levels_of(ready.records[i], ready.noise[i], work.seen_rows(i))
            for name, level in self._force_noise(model, i).items():  # the force alone may tell less, or nothing
                noise[name] = min(noise.get(name, 0.0) or np.inf, level)
            fakes.append(surrogate(ready.records[i], work.data.segments[i], model, noise, self.rng, hold))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is to be said of the channels was said of the measured ones
            levels, bands = ([known[i] for i in work.searched] for known in (ready.noise, ready.bands))
            data = prepare(fakes, noise=levels, bands=bands).data
        blocks = []
        for number, i in enumerate(work.searched):
            valid = data.segments[number].valid
            later = work.data.segments[i].valid.start - valid.start  # blocks count from the first valid row
            for b in (b for b in work.search if b.segment == i):
                ends = (min(max(row + later, 0), valid.stop - valid.start) for row in (b.rows.start, b.rows.stop))
                blocks.append(BlockRows(number, slice(*ends)))
        filters = [work.filters[i] for i in work.searched]
        fake = Workspace(data, filters, blocks, [], work.known_masses, work.strategy)
        return Stage(fake, self.stage.chain, self.stage.laws)

    def _force_noise(self, model: ChainModel, i: int) -> dict[str, float]:
        work, seg = self.stage.work, self.stage.work.data.segments[i]
        if seg.dt is None:
            return {}
        force = seg.F[seg.valid].astype(float)
        left = model.balance_forces(SegmentSet([seg], work.data.n_samples))[0] - np.nan_to_num(force)
        rows = max((b.rows for b in work.search if b.segment == i), key=lambda r: r.stop - r.start)
        filter = work.filters[i]
        left = work.filtered(i, left.T)[:, rows].T
        levels = force_noise(left, force[rows], 1 / seg.dt, None if filter is None else filter.band)
        return {f"F{j + 1}": float(level) for j, level in enumerate(levels)}

    @property
    def floor(self) -> float:
        """Median validation error that noise alone leaves, percent; NaN if unknown."""
        left = self._left(self.stages) if self.stages else np.inf
        alike = left <= _UNLIKE * max(self._left([self.stage]), FLOOR)
        return left if left < 100.0 and alike else float("nan")

    @property
    def reached(self) -> bool:
        """Whether the model is no worse on the measured records than where noise is all that it misses."""
        noise = [float(np.median(stage.trial().fold_errors())) for stage in self.stages]
        return bool(noise) and float(np.median(self.stage.trial().fold_errors())) <= AT_FLOOR * max(noise)

    def gain(self, finding: Finding) -> float:
        """Largest gain of a candidate where it does not act; zero if unknown."""
        own = isinstance(finding, SensorFinding) and not finding.witness and self.reached
        gains = [_OF_A_SENSOR if own else 0.0]
        for stage in self.stages:
            try:
                if isinstance(finding, SensorFinding):
                    gains.append(null_gain(stage, finding))
                    continue
                before = stage.trial().fold_errors()
                instead = [(site, stage.laws[site][i].name) for site, i in finding.drop]
                best = screen(stage, [finding.candidate], instead, lines_for(stage, finding.candidate))
                tried = validate(stage, refine(stage, best[0], 20)) if best else None
                gains.append(gain_of(before, tried.folds) if tried is not None and np.median(before) > FLOOR else 0.0)
            except NRFError:
                continue
        return max(gains)
