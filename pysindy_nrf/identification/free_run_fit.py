r"""The free run of a model fitted to measured channels.

Least squares of masses, coefficients and shape parameters: maximum likelihood with
noise in motion and force, :math:`\sum_f J^*(f) S^{-1}(f) R(f; \theta) = 0` (Pintelon
and Schoukens, System identification, 2012), with R and S of :mod:`.noise_spectra` and
sensitivities J by differences of runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..exceptions import NRFError
from ..records.dataset import Segment
from ..records.hold import BAND_LIMITED, HOLDS
from ..records.zero_phase_filter import Band
from .noise_spectra import NoiseModel, corrected, noise_model
from .parameter_vector import Rebuild
from .shots import Shot
from .spectra import common_band
from .whitened_runs import (
    MIN_ROWS,
    RANK_OF_STATES,
    Point,
    PriorEquations,
    Weighting,
    WhitenedRuns,
    column_lengths,
    decays_of,
    lines_of_columns,
    state_sizes,
)

# Iterations at most.
MAX_STEPS = 6
# Standard errors; the estimate has converged when a full step is shorter.
SETTLED = 0.05
# Damping at first, after a step that fails, and over that after one that holds
# (Transtrum and Sethna, 2012).
FIRST_DAMPING = 1e-4
LEAST_RAISED_DAMPING = 1e-6
DAMPING_UP = 3.0
DAMPING_DOWN = 10.0
# Share of the squared sensitivities, above which no step is better.
MAX_DAMPING = 1e9
# Largest change of a logarithm in a step.
MAX_LOGARITHMIC_STEP = 2.0
# Share of the squared error with band-limited forces that another course of them must
# stay below, else it makes no difference that matters.
CLEARLY_LESS = 0.7
# Residual that counts as one where a run is exact.
LEAST_UNIT = 1e-12
# Largest logarithm of a ratio of likelihoods; exp of more is no double.
MAX_LOGARITHM = 700.0


@dataclass(frozen=True)
class Solution:
    """Estimate, and the influence of each comb of Fourier lines on it.

    Attributes
    ----------
    u : ndarray of shape (n_parameters,)
    model : ChainModel
    influences : ndarray of shape (n_combs, n_parameters)
    record : ndarray of shape (n_combs,)
        Number of the record of each comb.
    cost : float
        Squared whitened residuals.
    jacobian : ndarray of shape (n_rows, n_parameters)
        Triangular factors of the sensitivities.
    starts : tuple of ndarray of shape (2, n_dof)
        Initial states of the shots; those of the fit unless they were estimated.
    """

    u: np.ndarray
    model: ChainModel
    influences: np.ndarray
    record: np.ndarray
    cost: float
    jacobian: np.ndarray
    starts: tuple[np.ndarray, ...]

    def standard_errors(self) -> np.ndarray:
        """Standard error of every parameter."""
        return np.sqrt((self.influences**2).sum(axis=0))


@dataclass(frozen=True)
class FreeRunError:
    """Squared errors of free runs in some rows, and the squared motion there."""

    plain: float  # channels over their rms
    weighted: float  # whitened
    motion: float  # channels over their rms

    def __add__(self, other: FreeRunError) -> FreeRunError:
        return FreeRunError(
            self.plain + other.plain,
            self.weighted + other.weighted,
            self.motion + other.motion,
        )

    @property
    def percent(self) -> float:
        """Percent NRMSE."""
        return float(100 * np.sqrt(self.plain / self.motion))


@dataclass(frozen=True)
class FreeRunFit:
    """Shots, what is free of their model, and what is known of their noise.

    Attributes
    ----------
    rebuild : Rebuild
    shots : sequence of Shot
    layout : LawLayout, optional
        Not read.
    band : tuple of float or None, optional
        Hz; lines outside, or outside a band of the records, are not used.
    prior : PriorEquations, optional
    noise : NoiseModel, optional
        Channels count alike where it is not known.
    forces : sequence of Segment or None
        By shot, the record with corrected forces, under which sensitivities are taken.
    """

    rebuild: Rebuild
    shots: Sequence[Shot]
    layout: LawLayout | None = None
    band: Band = None
    prior: PriorEquations | None = None
    noise: NoiseModel | None = None
    forces: Sequence[Segment | None] | None = None

    @cached_property
    def weighting(self) -> Weighting:
        """What whitens residuals."""
        low, high = common_band([shot.segment for shot in self.shots], self.band)
        if self.noise is not None:
            low = max(low, self.noise.signal_band[0])
            high = min(high, self.noise.signal_band[1])
        return Weighting((low, high), _rms_of_channels(self.shots), self.noise)

    @property
    def n_samples(self) -> int:
        """Samples of all shots."""
        return sum(shot.n_samples for shot in self.shots)

    @property
    def all_rows(self) -> list[slice]:
        """All rows of every shot."""
        return [slice(0, shot.n_samples) for shot in self.shots]

    def with_noise(
        self, model: ChainModel, channels: tuple[str, ...] = ()
    ) -> FreeRunFit | None:
        """The same fit with the noise that the free runs of a model show.

        Parameters
        ----------
        model : ChainModel
        channels : tuple of str
            Of the shots; velocities of all DOFs if empty.

        Returns
        -------
        FreeRunFit or None
            With corrected forces; None if there are no gaps.
        """
        layout = LawLayout(model.chain, model.laws)
        data = [shot.segment for shot in self.shots]
        runs = [shot.run(model) for shot in self.shots]
        gaps = [s.measured - s.simulated_channels(model) for s in self.shots]

        noise = noise_model(model, layout, data, runs, gaps, channels)
        if noise is None:
            return None
        forces = [corrected(seg, gap, noise) for seg, gap in zip(data, gaps)]
        return replace(self, noise=noise, forces=forces)

    def with_best_hold(self, model: ChainModel) -> FreeRunFit:
        """The same fit with the course of the forces that predicts the motion best.

        Records that say their own keep it. The forces of the others are band-limited,
        unless another course leaves clearly less.
        """
        if all(shot.segment.hold is not None for shot in self.shots):
            return self

        fits = {}
        errors = {}
        for hold in HOLDS:
            shots = [shot.with_hold(hold) for shot in self.shots]
            fits[hold] = replace(self, shots=shots)
            errors[hold] = fits[hold].error(model, self.all_rows).weighted

        best = min(HOLDS, key=errors.__getitem__)
        if errors[best] < CLEARLY_LESS * errors[BAND_LIMITED]:
            return fits[best]
        return fits[BAND_LIMITED]

    def begun_from(self, solution: Solution) -> FreeRunFit:
        """The same fit, whose shots begin from the initial states of a solution."""
        shots = [
            replace(shot, start=start)
            for shot, start in zip(self.shots, solution.starts)
        ]
        return replace(self, shots=shots)

    def solve(
        self,
        u: np.ndarray,
        rows: Sequence[slice] | None = None,
        steps: int = MAX_STEPS,
        move: bool = False,
        settled: float = SETTLED,
    ) -> Solution:
        """Estimate from some rows of every shot (Levenberg, Marquardt).

        Parameters
        ----------
        u : ndarray of shape (n_parameters,)
            First estimate.
        rows : sequence of slice, optional
            By shot; all if None.
        steps : int
            Iterations at most.
        move : bool
            Whether the initial states are estimated, too.
        settled : float
            Standard errors; a shorter step is the last one.

        Raises
        ------
        NRFError
            If the first free run diverges.
        """
        problem = WhitenedRuns(
            rebuild=self.rebuild,
            shots=self.shots,
            forces=self.forces or [None] * len(self.shots),
            weighting=self.weighting,
            prior=self.prior or PriorEquations.none(len(u)),
            rows=rows or self.all_rows,
            unit=0.0 if self.noise is None else 1.0,
        )
        point = problem.point(u, [shot.start for shot in self.shots])
        if len(problem.prior) and self.noise is None:
            # the noise is not known: what the first run misses stands for it
            unit = np.sqrt(point.cost / problem.n_rows)
            problem = replace(problem, unit=max(unit, LEAST_UNIT))
            point = problem.point(u, point.starts)

        point = self._descend(problem, point, steps, move, settled)

        return Solution(
            u=point.u,
            model=self.rebuild(point.u),
            influences=point.influences(),
            record=point.record,
            cost=self._comparable_cost(problem, point),
            jacobian=point.jacobian,
            starts=point.starts,
        )

    def _descend(
        self,
        problem: WhitenedRuns,
        point: Point,
        steps: int,
        move: bool,
        settled: float,
    ) -> Point:
        """Damped steps, each of which lowers the cost, until a full step is short."""
        # scipy.optimize.least_squares (trf, x_scale="jac", the same sensitivities) ends
        # within 0.01 standard errors of this, but in 1.4 to 20 times the time: initial
        # states become parameters, and all lines are factored at every step.
        damping = FIRST_DAMPING
        for _ in range(steps):
            # a damped step may be short far from the end, a full one is not
            full_step = point.full_step()
            expected_change = np.linalg.norm(point.jacobian @ full_step)
            deviation = np.sqrt(max(point.cost / problem.n_rows, 1e-300))
            unit = deviation if self.noise is None else min(deviation, 1.0)
            shortest = settled * unit

            better, damping = _better_point(problem, point, damping, move, shortest)
            if better is None:
                break
            point = better
            if expected_change < shortest:
                break
        return point

    def _comparable_cost(self, problem: WhitenedRuns, point: Point) -> float:
        """Squared residuals by which fits from several starts are compared."""
        of_prior = (problem.prior_rows(point.u)[:, -1] ** 2).sum()
        if self.noise is not None or not of_prior:
            return point.cost
        # the likelihood, largest over the level of the noise
        exponent = of_prior / problem.unit**2 / problem.n_rows
        return float((point.cost - of_prior) * np.exp(min(exponent, MAX_LOGARITHM)))

    def error(self, model: ChainModel, rows: Sequence[slice]) -> FreeRunError:
        """Errors of the free runs of a model, whose initial states are fitted.

        Parameters
        ----------
        model : ChainModel
        rows : sequence of slice
            Rows that are judged, by shot.
        """
        total = FreeRunError(0.0, 0.0, 0.0)
        for shot, judged in zip(self.shots, rows):
            if judged.stop - judged.start >= MIN_ROWS:
                total = total + self._error_of_shot(shot, model, judged)
        return total

    def _error_of_shot(
        self, shot: Shot, model: ChainModel, rows: slice
    ) -> FreeRunError:
        motion = shot.motion(model)
        simulated = shot.channels_of(motion)
        decays = decays_of(shot, model, shot.start, state_sizes(motion), simulated)
        of_states = np.stack(decays, axis=2)[rows]
        gap = (shot.measured - simulated)[rows]

        flat = of_states.reshape(-1, of_states.shape[2])
        length = column_lengths(flat)
        taken = np.linalg.lstsq(flat / length, gap.ravel(), rcond=RANK_OF_STATES)[0]
        gap = gap - (of_states / length) @ taken

        dt = shot.segment.step
        inside = self.weighting.inside(np.fft.rfftfreq(len(gap), dt)[1:])
        missed = lines_of_columns(gap[:, :, None], dt)[inside, :, 0]
        measured = lines_of_columns(shot.measured[rows][:, :, None], dt)[inside, :, 0]
        scale = np.mean(shot.measured**2, axis=0)
        scale[scale == 0] = 1.0
        whitened = self.weighting.whitened(gap[:, :, None], dt)
        return FreeRunError(
            plain=float((np.abs(missed) ** 2 / scale).sum()),
            weighted=float((whitened**2).sum() / 2),
            motion=float((np.abs(measured) ** 2 / scale).sum()),
        )


def _rms_of_channels(shots: Sequence[Shot]) -> np.ndarray:
    """Rms of every channel, 1 of one of zeros."""
    if not shots:
        return np.ones(1)
    weighted = np.concatenate([shot.measured * shot.weights for shot in shots])
    rms = np.sqrt(np.mean(weighted**2, axis=0))
    rms[rms == 0] = 1.0
    return rms


def _better_point(
    problem: WhitenedRuns, point: Point, damping: float, move: bool, shortest: float
) -> tuple[Point | None, float]:
    """The point after the longest step that lowers the cost, and the next damping.

    No step is tried that changes the residuals less than the shortest one. Where forces
    jump a run is no smooth function of the parameters, and no step may lower the cost.
    """
    while damping < MAX_DAMPING:
        step = point.damped_step(damping)
        better = _trial(problem, point, step, move)
        if better is not None:
            return better, damping / DAMPING_DOWN
        if np.linalg.norm(point.jacobian @ step) < shortest:
            break
        damping = max(DAMPING_UP * damping, LEAST_RAISED_DAMPING)
    return None, damping


def _trial(
    problem: WhitenedRuns, point: Point, step: np.ndarray, move: bool
) -> Point | None:
    """The point after a step; None if it is no better, too far or diverges."""
    logarithmic = problem.rebuild.logarithmic
    if np.abs(step[logarithmic]).max(initial=0.0) > MAX_LOGARITHMIC_STEP:
        return None

    u = point.u + step
    starts = point.moved_starts(step) if move else point.starts
    try:
        runs = problem.runs(u, starts)
        if not problem.cost(u, runs, point.states) < point.cost:
            return None
        return problem.point(u, starts, runs)
    except NRFError:  # the run diverges, or a shape has no such value
        return None
