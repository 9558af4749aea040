"""Free runs against measured channels as a whitened least-squares problem.

Residuals are Fourier lines of what the run misses, divided by the root of their
covariance. The effect of an error in the initial state of a shot is projected out of
residuals and sensitivities (variable projection).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..chain.model import ChainModel
from ..records.dataset import Segment
from .free_runs import Motion
from .noise_spectra import NoiseModel
from .parameter_vector import Rebuild
from .shots import Shot
from .spectra import fourier_lines

# Combs of Fourier lines of all data, whose contributions to the gradient give the
# standard errors. Lines are independent except for their neighbours, and every comb
# contains every resonance; pieces of time are correlated for as long as the structure
# rings.
N_COMBS = 64
# Shorter parts of a shot are left out.
MIN_ROWS = 64
# Step of the differences for sensitivities, as a share of a parameter or of the rms
# motion.
DIFFERENCE = 1e-6
# Share of the largest singular value below which a direction of the initial state does
# not move the channels, and stays as it is.
RANK_OF_STATES = 3e-5


def column_lengths(columns: np.ndarray) -> np.ndarray:
    """Length of each column, 1 of one of zeros."""
    length = np.linalg.norm(columns, axis=0)
    return np.where(length == 0, 1.0, length)


@dataclass(frozen=True)
class Weighting:
    """What whitens the Fourier lines of the channels.

    Attributes
    ----------
    band : tuple of float
        Hz; lines outside are not used.
    level : ndarray of shape (n_channels,)
        Rms of every channel, by which lines are divided where the noise is unknown.
    noise : NoiseModel, optional
    """

    band: tuple[float, float]
    level: np.ndarray
    noise: NoiseModel | None = None

    def inside(self, f: np.ndarray) -> np.ndarray:
        """Mask of the frequencies in the band."""
        return (f >= self.band[0]) & (f <= self.band[1])

    def whitened(self, columns: np.ndarray, dt: float) -> np.ndarray:
        """Lines of (n_rows, n_channels, k) columns over the root of their covariance.

        Returns
        -------
        ndarray of shape (n_lines, 2 n_channels, k)
            Real parts of all channels, then imaginary parts.
        """
        f = np.fft.rfftfreq(len(columns), dt)[1:]
        inside = self.inside(f)
        lines = lines_of_columns(columns, dt)[inside]

        if self.noise is None:
            lines /= self.level[:, None] * np.sqrt(dt)
        else:
            for rows, _, S in self.noise.covariances(f[inside]):
                scale = np.sqrt(np.einsum("ijj->ij", S).real)[:, :, None]
                root = np.linalg.cholesky(S / scale / scale.transpose(0, 2, 1))
                lines[rows] = np.linalg.solve(root, lines[rows] / scale)
        return np.sqrt(2.0) * np.concatenate([lines.real, lines.imag], axis=1)


def lines_of_columns(values: np.ndarray, dt: float) -> np.ndarray:
    """Fourier lines of columns (n_rows, n_channels, k), a line a row."""
    n_rows, n_channels, k = values.shape
    lines = fourier_lines(values.reshape(n_rows, n_channels * k), dt)
    return lines.reshape(-1, n_channels, k)


@dataclass(frozen=True)
class PriorEquations:
    """Prior knowledge A p = b of parameters, each row over its standard deviation."""

    A: np.ndarray
    b: np.ndarray

    def __len__(self) -> int:
        return len(self.b)

    @classmethod
    def none(cls, n_parameters: int) -> PriorEquations:
        """No equations."""
        return cls(np.empty((0, n_parameters)), np.empty(0))

    def linearised(self, rebuild: Rebuild, u: np.ndarray) -> np.ndarray:
        """Sensitivities and residuals, (n_equations, n_parameters + 1)."""
        residual = self.b - self.A @ rebuild.values(u)
        return np.column_stack([self.A * rebuild.slopes(u), residual])


@dataclass(frozen=True)
class Point:
    """The problem linearised at a vector of parameters, as triangular factors.

    Attributes
    ----------
    u : ndarray of shape (n_parameters,)
    starts : tuple of ndarray of shape (2, n_dof)
        Initial states of the shots.
    residuals, jacobian : ndarray of shape (n_rows,) and (n_rows, n_parameters)
        Factors whose squares and products are those of all whitened lines.
    scores : ndarray of shape (n_combs, n_parameters)
        Contribution of each comb of lines to the gradient.
    record : ndarray of shape (n_combs,)
        Number of the record of each comb.
    states : mapping of int to StateChange
        By shot.
    """

    u: np.ndarray
    starts: tuple[np.ndarray, ...]
    residuals: np.ndarray
    jacobian: np.ndarray
    scores: np.ndarray
    record: np.ndarray
    states: Mapping[int, StateChange]

    @property
    def cost(self) -> float:
        """Squared whitened residuals."""
        return float(self.residuals @ self.residuals)

    def full_step(self) -> np.ndarray:
        """Step of Gauss and Newton."""
        size = column_lengths(self.jacobian)
        unit = self.jacobian / size
        return np.linalg.lstsq(unit, self.residuals, rcond=None)[0] / size

    def damped_step(self, damping: float) -> np.ndarray:
        """Step of Levenberg and Marquardt."""
        n_parameters = len(self.u)
        size = column_lengths(self.jacobian)
        ridge = np.sqrt(damping) * np.eye(n_parameters)
        rows = np.vstack([self.jacobian / size, ridge])
        right = np.concatenate([self.residuals, np.zeros(n_parameters)])
        return np.linalg.lstsq(rows, right, rcond=None)[0] / size

    def moved_starts(self, step: np.ndarray) -> tuple[np.ndarray, ...]:
        """Best initial states after a step of the parameters, to first order."""
        starts = list(self.starts)
        for number, state in self.states.items():
            change = state.best + state.by_parameter @ step
            starts[number] = starts[number] + change.reshape(2, -1)
        return tuple(starts)

    def influences(self) -> np.ndarray:
        """What each comb of lines moves the parameters by, (n_combs, n_parameters)."""
        size = column_lengths(self.jacobian)
        half = np.linalg.pinv(self.jacobian / size, rcond=1e-12) / size[:, None]
        return self.scores @ half @ half.T


@dataclass(frozen=True)
class StateChange:
    """Best change of the initial state of a shot, and what parameters change of it."""

    best: np.ndarray  # (2 n_dof,)
    by_parameter: np.ndarray  # (2 n_dof, n_parameters)
    basis: np.ndarray  # (n_lines * 2 n_channels, rank), of what it does to the lines


@dataclass(frozen=True)
class _Run:
    """The free run of one shot that is compared with its channels."""

    number: int  # of the shot
    start: np.ndarray
    state_sizes: np.ndarray
    simulated: np.ndarray  # (n_samples, n_channels)


@dataclass(frozen=True)
class WhitenedRuns:
    """Least squares of whitened free runs in some rows of some shots.

    Attributes
    ----------
    rebuild : Rebuild
    shots : sequence of Shot
    forces : sequence of Segment or None
        By shot, the record with corrected forces, under which sensitivities are taken.
    weighting : Weighting
    prior : PriorEquations
    rows : sequence of slice
        Rows that are used, by shot.
    unit : float
        Residual that counts as one standard deviation of a prior equation.
    """

    rebuild: Rebuild
    shots: Sequence[Shot]
    forces: Sequence[Segment | None]
    weighting: Weighting
    prior: PriorEquations
    rows: Sequence[slice]
    unit: float

    @property
    def n_rows(self) -> int:
        """Rows in use, as many as real numbers in all their Fourier lines."""
        return sum(rows.stop - rows.start for rows in self.rows)

    def runs(self, u: np.ndarray, starts: Sequence[np.ndarray]) -> list[_Run]:
        """Free runs of the shots from some initial states."""
        model = self.rebuild(u)
        runs = []
        for number, (shot, rows, start) in enumerate(
            zip(self.shots, self.rows, starts)
        ):
            if rows.stop - rows.start < MIN_ROWS:
                continue
            motion = shot.motion(model, start)
            simulated = shot.channels_of(motion)
            runs.append(_Run(number, start, state_sizes(motion), simulated))
        return runs

    def cost(
        self, u: np.ndarray, runs: Sequence[_Run], states: Mapping[int, StateChange]
    ) -> float:
        """Squared whitened residuals of free runs, less what initial states explain.

        What these do to the lines is taken from a point nearby.
        """
        cost = 0.0
        for run in runs:
            shot = self.shots[run.number]
            gap = (shot.measured - run.simulated) * shot.weights
            gap = gap[self.rows[run.number], :, None]
            lines = self.weighting.whitened(gap, shot.segment.step).ravel()
            explained = states[run.number].basis.T @ lines
            cost += (lines**2).sum() - (explained**2).sum()
        return float(cost + (self.prior_rows(u)[:, -1] ** 2).sum())

    def prior_rows(self, u: np.ndarray) -> np.ndarray:
        """Rows of the prior equations, in the unit of the data."""
        return self.unit * self.prior.linearised(self.rebuild, u)

    def point(
        self,
        u: np.ndarray,
        starts: Sequence[np.ndarray],
        runs: Sequence[_Run] | None = None,
    ) -> Point:
        """The problem linearised at a vector, about its free runs.

        Parameters
        ----------
        u : ndarray of shape (n_parameters,)
        starts : sequence of ndarray of shape (2, n_dof)
            Initial states, by shot.
        runs : list, optional
            The free runs at the vector, if they are known.
        """
        runs = self.runs(u, starts) if runs is None else runs
        model = self.rebuild(u)
        beside = [self.rebuild(u + DIFFERENCE * e) for e in np.eye(len(u))]

        n_columns = len(u) + 1
        factors = []
        scores = [np.empty((0, len(u)))]
        record: list[int] = []
        states = {}
        for run in runs:
            lines, states[run.number] = self._projected(run, model, beside)
            factor = np.linalg.qr(lines.reshape(-1, n_columns), mode="r")
            factors.append(np.pad(factor, ((0, n_columns - len(factor)), (0, 0))))

            rows = self.rows[run.number]
            share = (rows.stop - rows.start) / self.n_rows
            n_combs = max(2, round(N_COMBS * share))
            scores.append(_comb_scores(lines, n_combs))
            record += [self.shots[run.number].number] * n_combs

        prior_rows = self.prior_rows(u)
        for row in prior_rows:
            scores.append(self.unit * _scores_of_prior(row))
            record += [1 + max(record)] * N_COMBS

        stacked = np.concatenate([*factors, prior_rows])
        return Point(
            u=u,
            starts=tuple(starts),
            residuals=stacked[:, -1],
            jacobian=stacked[:, :-1],
            scores=np.concatenate(scores),
            record=np.array(record, dtype=int),
            states=states,
        )

    def _projected(
        self, run: _Run, model: ChainModel, beside: Sequence[ChainModel]
    ) -> tuple[np.ndarray, StateChange]:
        """Whitened sensitivities and residuals of a shot without its initial state.

        Returns (n_lines, 2 n_channels, n_parameters + 1) and the change of the initial
        state that was projected out.
        """
        shot = self.shots[run.number]
        forces = self.forces[run.number]
        sizes = run.state_sizes
        base = run.simulated
        if forces is not None:
            motion = shot.motion(model, run.start, forces)
            sizes = state_sizes(motion)
            base = shot.channels_of(motion)

        sensitivities = []
        for other in beside:
            moved = shot.simulated_channels(other, run.start, forces)
            sensitivities.append((moved - base) / DIFFERENCE)

        decays = decays_of(shot, model, run.start, sizes, base, forces)
        columns = [*decays, *sensitivities, shot.measured - run.simulated]
        weighted = np.stack(columns, axis=2) * shot.weights[:, :, None]
        used = weighted[self.rows[run.number]]
        whitened = self.weighting.whitened(used, shot.segment.step)

        flat = whitened.reshape(-1, len(columns))
        of_states = flat[:, : len(decays)]
        rest = flat[:, len(decays) :]
        length = column_lengths(of_states)
        basis, singular, right = np.linalg.svd(of_states / length, full_matrices=False)
        moving = singular > RANK_OF_STATES * singular[0]
        basis = basis[:, moving]
        explained = basis.T @ rest
        lines = (rest - basis @ explained).reshape(*whitened.shape[:2], -1)

        taken = right[moving].T @ (explained / singular[moving, None])
        change = taken / length[:, None] * sizes[:, None]
        return lines, StateChange(change[:, -1], -change[:, :-1], basis)


def state_sizes(motion: Motion) -> np.ndarray:
    """Rms displacement and velocity of a run, for each entry of an initial state."""
    sizes = []
    for kind in ("x", "v"):
        rms = float(np.sqrt(np.mean(motion[kind] ** 2))) or 1.0
        sizes += [rms] * motion[kind].shape[1]
    return np.array(sizes)


def decays_of(
    shot: Shot,
    model: ChainModel,
    start: np.ndarray,
    sizes: np.ndarray,
    base: np.ndarray,
    forces: Segment | None = None,
) -> list[np.ndarray]:
    """What each entry of the initial state changes in the channels.

    Parameters
    ----------
    shot, model
    start : ndarray of shape (2, n_dof)
    sizes : ndarray of shape (2 n_dof,)
        Size of a change.
    base : ndarray of shape (n_samples, n_channels)
        The channels from the initial state itself.
    forces : Segment, optional
        The record with other forces.
    """
    decays = []
    for place, size in enumerate(sizes):
        state = start.copy()
        state.flat[place] += DIFFERENCE * size
        moved = shot.simulated_channels(model, state, forces)
        decays.append((moved - base) / DIFFERENCE)
    return decays


def _comb_scores(lines: np.ndarray, n_combs: int) -> np.ndarray:
    """Contribution of each comb of whitened lines to the gradient."""
    products = np.einsum("fd,fdp->fp", lines[:, :, -1], lines[:, :, :-1])
    scores = [products[first::n_combs].sum(axis=0) for first in range(n_combs)]
    return np.array(scores)


def _scores_of_prior(row: np.ndarray) -> np.ndarray:
    """An error of one standard deviation of a prior equation, in combs."""
    signs = np.resize([1.0, -1.0], N_COMBS)
    return signs[:, None] * row[:-1] / np.sqrt(N_COMBS)
