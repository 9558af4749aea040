"""One motion from the measured channels of one degree of freedom.

The motion is the spline that minimises the weighted squares about the channels. Noise
levels follow from its residuals; the distance of its knots, by generalised
cross-validation, from the channels too. All in units of samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.signal import welch

from .noise_levels import (
    NORMAL_MEDIAN,
    changing_samples,
    level_of_quietest,
    rms_of_quietest,
    white_level,
)
from .splines import BasisLadder, SplineBasis

# Displacement, velocity and acceleration, each of shape (n_samples,); None where a
# channel is not measured.
Channels = Sequence[np.ndarray | None]

# Change of the logarithm of a level at which it has settled, and at which it is good
# enough to compare knots: 1 / sqrt(2 n), its standard error from 2,048 samples.
SETTLED = 1e-3
SETTLED_ROUGHLY = 0.016
MAX_ROUNDS = 40
# Share of the samples that count at least, however many parameters are spent.
MIN_FREEDOM = 1e-3
# Noise below this share of a channel's rms cannot be distinguished from rounding.
ROUNDING = 1e-9
# A derivative does not determine the mean position. Its noise level is taken as at
# least this share of the level of the channel it is a derivative of; otherwise the
# position is lost in rounding when squared.
MIN_LEVEL_RATIO = 2e-7
# Channels count as computed, not measured, if their white noise is below a share of
# their rms and they contradict each other by less than another, both in the quietest
# tenth of the samples. A force held linear between samples leaves contradictions; 36
# computed chains with friction, gaps and hysteresis have 1e-4 of noise and 3e-4 of
# contradiction at most. Derivatives of what is measured raise its noise. Where nothing
# has to be derived, the drifts have some ten times its share, and the bias of least
# squares is the square of that, 1e-6.
CLEAN_DERIVED = 1e-6
CLEAN_MEASURED = 1e-4
CLEAN_CONTRADICTION = 2e-3
# Power over that of white noise from which on a spectral line is motion.
CLEAR_LINE = 4.0
# Corner of the high-pass as a share of the lowest frequency of the motion: it takes the
# square of that, 0.25 %, of a velocity there.
CORNER = 0.05
# Distances of the knots that may be worse one after the other before the search stops.
# One worse step is no end: a blow may show on the finest knots alone.
WORSE_STEPS = 2


class Spline(NamedTuple):
    """A spline by its basis and its coefficients, (size,)."""

    basis: SplineBasis
    coefficients: np.ndarray


@dataclass(frozen=True, eq=False)
class FusedMotion:
    """The motion of one degree of freedom, in units of samples.

    Attributes
    ----------
    noise : ndarray of shape (3,)
        Noise level of displacement, velocity and acceleration; NaN where a channel is
        not measured.
    spacing : float
        Distance of the knots, samples.
    high_pass : float
        Cycles per sample at which half of the motion is lost; 0 if displacement is
        measured.
    spline : Spline or None
    values : ndarray of shape (3, n_samples) or None
        In place of a spline: the motion of a DOF at rest, or without noise.
    clean : bool
        True for channels without noise, which are passed on as they are.
    """

    noise: np.ndarray
    spacing: float
    high_pass: float
    spline: Spline | None
    values: np.ndarray | None = None
    clean: bool = False

    def evaluate(self) -> np.ndarray:
        """Displacement, velocity and acceleration, (3, n_samples)."""
        if self.spline is None:
            assert self.values is not None
            return self.values
        return self.spline.basis.evaluate(self.spline.coefficients)

    def add(self, weight: np.ndarray, out: np.ndarray) -> None:
        """Add the motion to ``out``, times a weight for each sample."""
        if self.spline is None:
            out += weight * self.evaluate()
        else:
            self.spline.basis.add(self.spline.coefficients, weight, out)


@dataclass(frozen=True, eq=False)
class DofKnowledge:
    """What is known of a degree of freedom before its channels are fused.

    Attributes
    ----------
    noise : ndarray of shape (3,)
        Noise levels; NaN where they are to be found.
    high_pass : float, optional
        Cycles per sample, for a DOF without displacement; None: to be found.
    spacing : float, optional
        Distance of the knots, samples; None: to be found.
    """

    noise: np.ndarray
    high_pass: float | None = None
    spacing: float | None = None


def fuse_dof(
    channels: Channels,
    ladder: BasisLadder,
    known: DofKnowledge,
    first_spacing: float = 1.0,
) -> FusedMotion:
    """Fuse the measured channels of one degree of freedom.

    Parameters
    ----------
    channels : sequence of three ndarrays or None
        Displacement, velocity and acceleration.
    ladder : BasisLadder
        Spline bases of that length.
    known : DofKnowledge
        What need not be found.
    first_spacing : float
        Distance of the knots at which the search for it begins.
    """
    rms = np.array([_rms(channel) for channel in channels])
    if not np.nanmax(rms) > 0:
        noise = np.where(np.isnan(rms), np.nan, 0.0)
        rest = np.zeros((3, ladder.n_samples))
        return FusedMotion(noise, 1.0, 0.0, None, rest)

    fits = _SplineFits(channels, ladder, known, rms)
    if known.spacing is not None and not fits.estimated:
        return fits.motion(known.spacing, fits.first_levels)
    if fits.are_clean():
        return fits.as_measured()

    best = fits.best_spacing(first_spacing)
    levels = fits.settled_levels(best)
    # one channel and no sign of noise beyond its band: it is followed sample by sample
    only_channel = len(fits.measured) == 1 and bool(fits.estimated)
    if only_channel and best == fits.spacings[0]:
        return fits.motion(1.0, levels)
    return fits.motion(best, levels)


def refine(
    channels_of_dofs: Sequence[Channels],
    motions: Sequence[FusedMotion],
    ladder: BasisLadder,
) -> list[FusedMotion]:
    """Motions on knots twice as dense where acceleration is measured: noisier, but
    nothing of the motion is lost.
    """
    out = list(motions)
    for j, (channels, motion) in enumerate(zip(channels_of_dofs, motions, strict=True)):
        accelerated = motion.spline is not None and channels[2] is not None
        if accelerated and motion.spacing > 1.0:
            basis = ladder[max(1.0, motion.spacing / 2)]
            coefficients = solve(channels, basis, motion.noise, motion.high_pass)
            spline = Spline(basis, coefficients)
            out[j] = replace(motion, spacing=basis.spacing, spline=spline)
    return out


def channel_weights(levels: np.ndarray, high_pass: float) -> np.ndarray:
    """Weights of displacement, velocity and acceleration, (3,).

    Where displacement is not measured, its weight about zero makes the high-pass.
    """
    least = np.array(levels, dtype=float)
    least[1:] = np.fmax(least[1:], MIN_LEVEL_RATIO * np.fmax.accumulate(least)[:2])
    weights = np.where(np.isnan(levels), 0.0, least**-2.0)
    if np.isnan(levels[0]):
        corner = 2 * np.pi * high_pass
        weights[0] = corner**2 * weights[1] + corner**4 * weights[2]
    return weights


def solve(
    channels: Channels, basis: SplineBasis, levels: np.ndarray, high_pass: float
) -> np.ndarray:
    """Coefficients of the spline through channels of given noise levels."""
    return basis.solve(channel_weights(levels, high_pass), channels)


class _KnotFit(NamedTuple):
    """A spline on knots of one distance; the levels follow from its residuals."""

    criterion: float
    coefficients: np.ndarray
    levels: np.ndarray


class _SplineFits:
    """Splines through the channels of one DOF, on knots of any distance."""

    def __init__(
        self,
        channels: Channels,
        ladder: BasisLadder,
        known: DofKnowledge,
        rms: np.ndarray,
    ) -> None:
        self.channels = channels
        self.ladder = ladder
        self.measured = {k: y for k, y in enumerate(channels) if y is not None}
        self.known_levels = known.noise
        self.estimated = [k for k in self.measured if np.isnan(known.noise[k])]
        self.scale = np.where(rms > 0, rms, np.nanmax(rms))
        self.floor = ROUNDING * self.scale

        self.first_levels = np.maximum(self._known_or_white_levels(), self.floor)
        self.high_pass = _high_pass(channels, known, self.first_levels)
        self.spacings = ladder.spacings
        # one channel on knots at every sample has no residual
        if len(self.measured) == 1:
            self.spacings = ladder.spacings[1:] or [1.0]
        self._changing = {k: changing_samples(y) for k, y in self.measured.items()}
        self._fits: dict[float, _KnotFit] = {}

    def motion(self, spacing: float, levels: np.ndarray) -> FusedMotion:
        """The motion on knots of one distance, by given levels."""
        basis = self.ladder[spacing]
        coefficients = solve(self.channels, basis, levels, self.high_pass)
        spline = Spline(basis, coefficients)
        return FusedMotion(levels, spacing, self.high_pass, spline)

    def are_clean(self) -> bool:
        """Whether the channels are free of noise and do not contradict each other."""
        complete = len(self.measured) == 3
        limits = (CLEAN_MEASURED if complete else CLEAN_DERIVED) * self.scale
        if not all(self._quiet_level(k) < limits[k] for k in self.measured):
            return False
        finest = self.spacings[0]
        coefficients = self._roughly(finest).coefficients
        residuals = self._residuals(self.ladder[finest], coefficients)
        return all(
            rms_of_quietest(residual) < CLEAN_CONTRADICTION * self.scale[k]
            for k, residual in residuals.items()
        )

    def as_measured(self) -> FusedMotion:
        """The channels as they are; a spline fills in those that are not measured."""
        levels = self._roughly(self.spacings[0]).levels
        motion = self.motion(1.0, levels).evaluate()
        noise = np.full(3, np.nan)
        for order, channel in self.measured.items():
            noise[order] = self._quiet_level(order)
            if order in self.estimated:
                noise[order] = max(noise[order], self.floor[order])
            if self.high_pass == 0.0:
                motion[order] = channel
        return FusedMotion(noise, 1.0, self.high_pass, None, motion, clean=True)

    def best_spacing(self, first: float) -> float:
        """The distance of the knots with the least criterion: coarser ones are tried
        from the first on, then finer ones.
        """
        spacings = self.spacings
        start = min(range(len(spacings)), key=lambda k: abs(spacings[k] - first))
        best = start
        lowest = self._roughly(spacings[start]).criterion
        for step in (1, -1):
            levels = self._roughly(spacings[start]).levels
            k = start + step
            worse = 0
            while 0 <= k < len(spacings) and worse < WORSE_STEPS:
                fit = self._roughly(spacings[k], levels)
                levels = fit.levels
                worse += 1
                if fit.criterion < lowest:
                    best = k
                    lowest = fit.criterion
                    worse = 0
                k += step
        return spacings[best]

    def settled_levels(self, spacing: float) -> np.ndarray:
        """Noise levels on knots of one distance."""
        return self._fit(spacing, self._roughly(spacing).levels, SETTLED).levels

    def _known_or_white_levels(self) -> np.ndarray:
        levels = np.array(self.known_levels, dtype=float)
        for order in self.estimated:
            levels[order] = white_level(self.measured[order])
        return levels

    def _quiet_level(self, order: int) -> float:
        """Noise level of a channel, as known or in its quietest samples."""
        if order in self.estimated:
            return level_of_quietest(self.measured[order])
        return float(self.known_levels[order])

    def _roughly(self, spacing: float, levels: np.ndarray | None = None) -> _KnotFit:
        """Fit on knots of one distance, made once, from some levels on or the first."""
        if spacing not in self._fits:
            start = self.first_levels if levels is None else levels
            self._fits[spacing] = self._fit(spacing, start, SETTLED_ROUGHLY)
        return self._fits[spacing]

    def _fit(self, spacing: float, levels: np.ndarray, settled: float) -> _KnotFit:
        """Alternate between the spline and the noise levels until these settle."""
        basis = self.ladder[spacing]
        n = basis.n_samples
        for _ in range(MAX_ROUNDS if self.estimated else 1):
            weights = channel_weights(levels, self.high_pass)
            coefficients = basis.solve(weights, self.channels)
            residuals = self._residuals(basis, coefficients)
            spent = basis.parameters_spent(weights)
            freedom = np.maximum(n - spent, MIN_FREEDOM * n)

            before = levels
            levels = before.copy()
            for order in self.estimated:
                typical = self._typical_size(residuals[order], order)
                level = typical * np.sqrt(n / freedom[order])
                levels[order] = max(level, self.floor[order])
            change = np.abs(np.log(levels[self.estimated] / before[self.estimated]))
            if change.max(initial=0.0) < settled:
                break

        criterion = self._criterion(residuals, levels, spent, freedom)
        return _KnotFit(criterion, coefficients, levels)

    def _residuals(
        self, basis: SplineBasis, coefficients: np.ndarray
    ) -> dict[int, np.ndarray]:
        motion = basis.evaluate(coefficients)
        return {order: motion[order] - y for order, y in self.measured.items()}

    def _typical_size(self, residual: np.ndarray, order: int) -> float:
        """Rms by the median: the kink that a hammer blow leaves is not noise."""
        sizes = np.abs(residual[self._changing[order]])
        middle = len(sizes) // 2
        return np.partition(sizes, middle)[middle] / NORMAL_MEDIAN

    def _criterion(
        self,
        residuals: dict[int, np.ndarray],
        levels: np.ndarray,
        spent: np.ndarray,
        freedom: np.ndarray,
    ) -> float:
        """Generalised cross-validation, summed over the channels on a logarithmic
        scale; of channels with known levels, Mallows' criterion.
        """
        n = self.ladder.n_samples
        criterion = 0.0
        for order, residual in residuals.items():
            mean_square = max(residual @ residual / n, self.floor[order] ** 2)
            if order in self.estimated:
                criterion += np.log(mean_square) - 2 * np.log(freedom[order] / n)
            else:
                criterion += mean_square / levels[order] ** 2 + 2 * spent[order] / n
        return criterion


def _rms(channel: np.ndarray | None) -> float:
    """Rms of a channel; NaN if it is not measured."""
    if channel is None:
        return float("nan")
    return float(np.sqrt(channel @ channel / len(channel)))


def _high_pass(channels: Channels, known: DofKnowledge, levels: np.ndarray) -> float:
    """Cycles per sample below which motion is lost; 0 with displacement."""
    if channels[0] is not None:
        return 0.0
    if known.high_pass is not None:
        return known.high_pass
    return _lowest_corner(channels, levels)


def _lowest_corner(channels: Channels, levels: np.ndarray) -> float:
    """Corner of the high-pass, cycles per sample, far below the lowest motion.

    That is the lowest frequency at which velocity or acceleration rises out of its
    noise.
    """
    corners = []
    for order in (1, 2):
        channel = channels[order]
        if channel is None or not np.any(channel):
            continue
        n = len(channel)
        segment = min(n, max(16, n // 8))
        f, density = welch(channel, nperseg=segment, detrend="constant")
        noise_density = 2 * levels[order] ** 2
        clear = np.flatnonzero(density[1:] > CLEAR_LINE * noise_density)
        if not clear.size:
            corners.append(0.5 * f[1])
        elif clear[0] == 0:
            # the signal reaches below the first line: only the record's length limits
            corners.append(1.0 / n)
        else:
            corners.append(CORNER * f[1 + clear[0]])
    return float(min(corners))
