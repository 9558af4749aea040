"""Records that were computed step by step: their rule of integration, found in them.

A fusion believes that displacements are the double integral of a smooth acceleration.
Newmark's method, and a force that is straight between its samples, make others. Their
channels obey another rule to the last digit, and are best taken as they are.

All in units of samples, d2 the second difference. Newmark's method with the parameter b
gives ``d2 x = a + b d2 a``. A smooth acceleration obeys
``d2 x = a + d2 a / 12 - d2^2 a / 240 + 31 d2^3 a / 60480 - ..``, and a part of it that
is straight between samples ``d2 x = a + d2 a / 6``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ..hold import Hold
from .block_fusion import ChannelSet
from .dof_fusion import ROUNDING, Channels, FusedMotion

# Samples on which a rule is tried, those of the largest accelerations.
MAX_SAMPLES_TRIED = 4096
MIN_SAMPLES_TRIED = 64
# Share of what a smooth acceleration leaves that a rule may leave. Of frames of three
# to five floors Newmark's method leaves less than 1e-6, straight forces up to 0.1;
# rounded to 16 bits both leave up to 0.1 at 250 Hz and 0.5 at 1 kHz, where they matter
# little. Of splines through the forces, which are nearly smooth, straight forces leave
# 0.32 and more.
EXPLAINED_GAP = 0.25
# Largest error of the displacement, as a share of its rms, with which channels count as
# computed: 16 bits round to 1e-4 of the rms if the peak is ten times that. Where
# nothing is smoothed, drifts have some ten times the share, and the bias of least
# squares is the square of that, 1e-5.
MAX_ERROR = 3e-4
# Largest difference of a measured velocity from that of the rule, as a share of its
# rms: straight forces give one of 1.5 % at 7 samples a period.
MAX_VELOCITY_ERROR = 0.02
# Largest rate of the leaky sums, one over samples.
MAX_LEAK = 0.5
# Of the third differences of a smooth acceleration in the velocity, beside
# (x+ - x-) / 2 - (a+ - a-) / 12.
FOURTH_ORDER = 7 / 720
# In place of a variance of zero.
TINY = 1e-300


@dataclass(frozen=True)
class IntegrationRule:
    """A rule by which displacements follow from accelerations.

    Attributes
    ----------
    name : str
        In a sentence about the channels.
    beta : float
        Newmark's parameter. Straight accelerations obey his rule of 1/6, too.
    hold : {"linear"}, optional
        Course of the forces between the samples, which only the part of the
        acceleration that is the force obeys; the rest of the motion is smooth.
    """

    name: str
    beta: float
    hold: Hold | None = None

    @property
    def simulation_method(self) -> str:
        """The method of :func:`~pysindy_nrf.simulate` that follows such a record."""
        return "newmark" if self.beta == 1 / 4 else "default"

    def velocity(
        self, x: np.ndarray, a: np.ndarray, straight: np.ndarray | None = None
    ) -> np.ndarray:
        """Velocity from displacement and acceleration.

        Exact for Newmark's method, and for the part of the acceleration that is
        straight; of a smooth motion the error is of sixth order.
        """
        step = np.diff(x)
        before = a[:-1]
        after = a[1:]
        at_start = step - (0.5 - self.beta) * before - self.beta * after
        at_end = step + (0.5 - self.beta) * after + self.beta * before

        v = np.empty(len(x))
        v[0] = at_start[0]
        v[-1] = at_end[-1]
        v[1:-1] = (at_start[1:] + at_end[:-1]) / 2
        if straight is not None:
            bend = np.diff(a - straight, 2)
            v[2:-2] += FOURTH_ORDER * (bend[2:] - bend[:-2])
        return v


RULES = (
    IntegrationRule("Newmark's method with constant average acceleration", 1 / 4),
    IntegrationRule("Newmark's method with linear acceleration", 1 / 6),
    IntegrationRule("central differences", 0.0),
    IntegrationRule("forces straight between the samples", 1 / 6, hold="linear"),
)


@dataclass(frozen=True)
class ComputedMotions:
    """Motions of all degrees of freedom of a record that was computed.

    Attributes
    ----------
    rule : IntegrationRule
        The rule that its channels obey.
    motions : list of FusedMotion
        The channels as they are; where velocity is not measured, it is the rule's.
    """

    rule: IntegrationRule
    motions: list[FusedMotion]


def computed_motions(
    channels: ChannelSet, drives: Sequence[Sequence[np.ndarray]], noise: np.ndarray
) -> ComputedMotions | None:
    """The channels as they are, if they obey a rule of integration; else None.

    Parameters
    ----------
    channels : ChannelSet
    drives : sequence of sequences of ndarray of shape (n_samples,)
        Of each DOF, its force and the acceleration of the base, in any unit.
    noise : ndarray of shape (n_dof, 3)
        Noise levels of displacement, velocity and acceleration that are known, in units
        of samples; NaN elsewhere.
    """
    complete = all(
        dof[0] is not None and dof[2] is not None for dof in channels.channels
    )
    if not complete or channels.n_samples < MIN_SAMPLES_TRIED:
        return None
    rows = _strongest_rows(channels)
    gaps = _curvature_gaps(channels, drives, rows)
    rule = _rule_obeyed(gaps)
    if rule is None or _is_noisy(channels, noise):
        return None

    motions = []
    every_sample = channels.block(0, channels.n_samples)
    for dof, drives_of_dof, gap in zip(every_sample, drives, gaps, strict=True):
        motion = _as_computed(dof, drives_of_dof, rule, gap)
        if motion is None:
            return None
        motions.append(motion)
    return ComputedMotions(rule, motions)


class _CurvatureGap:
    """What rules leave of the second differences of the displacement of one DOF.

    These raise the noise of displacements with the square of the frequency. Two leaky
    sums take that back above the typical frequency of the motion, so that what a rule
    leaves is the error of the displacement.
    """

    def __init__(
        self, x: np.ndarray, a: np.ndarray, drives: Sequence[np.ndarray]
    ) -> None:
        self.size = float(x.std())
        leak = min(np.sqrt(a.std() / max(self.size, TINY)), MAX_LEAK)
        gap = np.diff(x, 2)[2:-2] - a[3:-3]
        self._gap = _summed_twice(gap, leak)
        self._bend = _summed_twice(np.diff(a, 2)[2:-2], leak)
        self._smooth_gap = self._gap - _summed_twice(_smooth_bend(a), leak)
        straight = [np.diff(y, 2)[2:-2] / 6 - _smooth_bend(y) for y in drives]
        parts = [_summed_twice(errors, leak) for errors in straight]
        self.drive_gains = _gains(parts, self._smooth_gap)
        self._straight_gap = self._smooth_gap.copy()
        for gain, errors in zip(self.drive_gains, parts, strict=True):
            self._straight_gap -= gain * errors

    def share_of_error(self, rule: IntegrationRule | None = None) -> float:
        """Rms of what a rule leaves, as a share of that of the displacement; of what a
        smooth acceleration leaves if there is no rule.
        """
        if self.size == 0.0:
            return 0.0
        if rule is None:
            remaining = self._smooth_gap
        elif rule.hold is not None:
            remaining = self._straight_gap
        else:
            remaining = self._gap - rule.beta * self._bend
        return float(np.sqrt(np.mean(remaining**2)) / self.size)


def _smooth_bend(a: np.ndarray) -> np.ndarray:
    """Second differences of the displacement less the acceleration, if it is smooth."""
    second = np.diff(a, 2)[2:-2]
    fourth = np.diff(a, 4)[1:-1]
    return second / 12 - fourth / 240 + 31 * np.diff(a, 6) / 60480


def _summed_twice(values: np.ndarray, leak: float) -> np.ndarray:
    for _ in range(2):
        values = lfilter([1.0], [1.0, leak - 1.0], values)
    return values


def _gains(parts: Sequence[np.ndarray], values: np.ndarray) -> np.ndarray:
    """Factors of some parts in values, by least squares; zero for parts of zeros."""
    sizes = np.array([errors.std() for errors in parts])
    gains = np.zeros(len(parts))
    moving = np.flatnonzero(sizes).tolist()
    if moving:
        matrix = np.column_stack([parts[k] / sizes[k] for k in moving])
        gains[moving] = np.linalg.lstsq(matrix, values)[0] / sizes[moving]
    return gains


def _strongest_rows(channels: ChannelSet) -> slice:
    """The rows that are tried: those of the largest accelerations."""
    n_samples = channels.n_samples
    if n_samples <= MAX_SAMPLES_TRIED:
        return slice(0, n_samples)
    # a part of the samples says where the energy is
    stride = -(-n_samples // (4 * MAX_SAMPLES_TRIED))
    window = MAX_SAMPLES_TRIED // stride
    energy = np.zeros(-(-n_samples // stride))
    for _, _, a in channels.channels:
        assert a is not None
        power = a[::stride] ** 2
        energy += power / max(power.sum(), TINY)
    total = np.append(0.0, np.cumsum(energy))
    first = int(np.argmax(total[window:] - total[:-window]))
    start = min(first * stride, n_samples - MAX_SAMPLES_TRIED)
    return slice(start, start + MAX_SAMPLES_TRIED)


def _curvature_gaps(
    channels: ChannelSet, drives: Sequence[Sequence[np.ndarray]], rows: slice
) -> list[_CurvatureGap]:
    """The gap of every DOF."""
    gaps = []
    pieces = channels.block(rows.start, rows.stop - rows.start)
    for (x, _, a), drives_of_dof in zip(pieces, drives, strict=True):
        assert x is not None and a is not None
        gaps.append(_CurvatureGap(x, a, [drive[rows] for drive in drives_of_dof]))
    return gaps


def _rule_obeyed(gaps: Sequence[_CurvatureGap]) -> IntegrationRule | None:
    """The rule that leaves least of the gaps, if that is little."""
    best = None
    least = EXPLAINED_GAP * _rms([gap.share_of_error() for gap in gaps])
    for rule in RULES:
        remaining = [gap.share_of_error(rule) for gap in gaps]
        if _rms(remaining) < least and max(remaining) < MAX_ERROR:
            best = rule
            least = _rms(remaining)
    return best


def _is_noisy(channels: ChannelSet, noise: np.ndarray) -> bool:
    """Whether a noise level is known that no computed channel has."""
    for measured, levels in zip(channels.channels, noise, strict=True):
        for channel, unit, level in zip(measured, channels.units, levels, strict=True):
            if channel is not None and level > MAX_ERROR * channel.std() * unit:
                return True
    return False


def _as_computed(
    channels: Channels,
    drives: Sequence[np.ndarray],
    rule: IntegrationRule,
    gap: _CurvatureGap,
) -> FusedMotion | None:
    """The channels of one DOF as they are, with the velocity that the rule gives; None
    if it is not the measured one.
    """
    x, v, a = channels
    assert x is not None and a is not None
    straight = None
    if rule.hold is not None:
        straight = sum(map(np.multiply, gap.drive_gains, drives), np.zeros(len(a)))
    velocity = rule.velocity(x, a, straight)
    error = max(gap.share_of_error(rule), ROUNDING)
    noise = error * np.array([x.std(), np.nan, a.std()])
    if v is not None:
        noise[1] = max(error * v.std(), (v - velocity).std())
        if noise[1] > MAX_VELOCITY_ERROR * v.std():
            return None
        velocity = v
    motion = np.stack([x, velocity, a])
    return FusedMotion(noise, 1.0, 0.0, None, motion, clean=True)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
