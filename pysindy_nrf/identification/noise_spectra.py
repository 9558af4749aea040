r"""Noise of motions and forces, from what a model misses of the measured motion.

Under the measured force u a model misses the motion by :math:`R(f) = E_x(f) - G(f)
E_u(f)`, with G the model linearised along its run; R has the covariance :math:`S =
\Sigma_x + G \Sigma_u G^*`, and its equations of motion leave :math:`e = -G^{-1} R`. The
best estimate of the force, :math:`\hat u = u + \Sigma_u G^* S^{-1} R`, has an error
that is uncorrelated with R (Soederstrom, Errors-in-variables methods in system
identification, 2007), so runs under it can be instruments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..chain.layout import LawLayout
from ..chain.model import ChainModel
from ..records.dataset import Segment
from .linear_response import Matrices, blocks_of_lines, equivalent_matrices
from .linear_response import transfer as transfer
from .spectra import (
    MEDIAN_OVER_MEAN,
    MIN_LINES_PER_BIN,
    SmoothSpectrum,
    common_band,
    fourier_lines,
    line_frequencies,
    mean_spectrum,
    median_spectrum,
    relative_velocities,
    white_density,
)

# Share of the drifts' power below the lowest line used, and of the accelerations' above
# the highest.
POWER_OUTSIDE = 5e-4
# Smallest share of the gap in a bin that is noise of the motion.
LEAST_MOTION_NOISE = 0.1
# Gap over motion (rms) below which the free run is exact to round-off.
ROUND_OFF = 1e-6
# Smallest share of what a model misses of a channel that is no force on a floor: a
# tenth of it, squared. Hidden floors of three_storey_frf and nees_three_storey come out
# 7 to 15 % off; 10 to 17 % with a hundredth of this, 6 to 18 % with ten times it.
LEAST_CHANNEL_NOISE = 0.01
# Rounds in which the noise of the motion and that of the forces are told apart.
SEPARATION_ROUNDS = 2


@dataclass(frozen=True)
class NoiseModel:
    """Noise of motions and forces, and the structure between them.

    Attributes
    ----------
    matrices : tuple of ndarray of shape (n_dof, n_dof)
        Mass, damping and stiffness of the model, linearised along its run.
    motion : SmoothSpectrum
        Density of the noise of every channel.
    force : ndarray of shape (n_dof + 1,)
        Density of the white noise of every force, and of the base acceleration.
    share : SmoothSpectrum
        Share of the simulated motion's density, by DOF, that the noise of the forces
        did not make.
    signal_band : tuple of float
        Hz; frequencies in which the run moves and the filters of the motions pass.
    channels : tuple of str
        a1, x2, ... whose noise it is; the relative velocities of all DOFs if empty.
    """

    matrices: Matrices
    motion: SmoothSpectrum
    force: np.ndarray
    share: SmoothSpectrum
    signal_band: tuple[float, float]
    channels: tuple[str, ...] = ()

    def transfer(self, f: np.ndarray) -> np.ndarray:
        """Channels from forces and base acceleration, (len(f), n_channels, n + 1)."""
        return transfer(self.matrices, f, self.channels)

    def of_channels(self, columns: Sequence[int]) -> NoiseModel:
        """The noise of some of the channels."""
        motion = SmoothSpectrum(self.motion.f, self.motion.values[:, columns])
        channels = tuple(self.channels[k] for k in columns)
        return replace(self, motion=motion, channels=channels)

    def with_model_error(self, segment: Segment, measured: np.ndarray) -> NoiseModel:
        """Explain gaps beyond the channels' white noise by equal forces on all floors.

        Parameters
        ----------
        segment : Segment
        measured : ndarray of shape (n_valid, n_channels)
        """
        levels = [white_density(channel, segment.step) for channel in measured.T]
        low, high = self.signal_band
        f = line_frequencies(segment)
        f = f[(f >= low) & (f <= high)]

        beyond_noise = np.maximum(self.motion(f) - levels, 0.0).sum(axis=0)
        response = np.abs(self.transfer(f)[:, :, :-1]) ** 2
        force = self.force.copy()
        force[:-1] += np.mean(beyond_noise / response.sum(axis=(0, 2)))

        missed = self.motion.values
        own_noise = np.clip(levels, LEAST_CHANNEL_NOISE * missed, missed)
        return replace(
            self, force=force, motion=SmoothSpectrum(self.motion.f, own_noise)
        )

    def covariances(
        self, f: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Lines of f, the transfer G there, and the covariance S of the gaps."""
        for rows in blocks_of_lines(len(f)):
            G = self.transfer(f[rows])
            S = (G * self.force) @ G.conj().transpose(0, 2, 1)
            diagonal = np.arange(S.shape[1])
            # near an undamped resonance rounding makes S singular
            S[:, diagonal, diagonal] *= 1.0 + 1e-12
            S[:, diagonal, diagonal] += self.motion(f[rows])
            yield rows, G, S

    def likely_forces(
        self, f: np.ndarray, gaps: np.ndarray
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Lines of f, and the unmeasured forces that explain the gaps."""
        for rows, G, S in self.covariances(f):
            weighted = np.linalg.solve(S, gaps[rows][:, :, None])
            yield rows, self.force[:, None] * (G.conj().transpose(0, 2, 1) @ weighted)


@dataclass(frozen=True)
class _Lines:
    """Fourier lines of several records: gaps and velocities of the runs."""

    f: list[np.ndarray]
    gaps: list[np.ndarray]
    velocities: list[np.ndarray]

    def __len__(self) -> int:
        return sum(map(len, self.f))

    def within(self, band: tuple[float, float]) -> _Lines:
        """The lines inside a band."""
        inside = [(f >= band[0]) & (f <= band[1]) for f in self.f]
        return _Lines(
            _chosen(self.f, inside),
            _chosen(self.gaps, inside),
            _chosen(self.velocities, inside),
        )


def _chosen(
    arrays: Sequence[np.ndarray], masks: Sequence[np.ndarray]
) -> list[np.ndarray]:
    return [array[mask] for array, mask in zip(arrays, masks)]


def _powers(lines: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.abs(values) ** 2 for values in lines]


def _size(lines: Sequence[np.ndarray]) -> np.ndarray:
    """Root of the power of each column in all records."""
    return np.sqrt(sum(power.sum(axis=0) for power in _powers(lines)))


def noise_model(
    model: ChainModel,
    layout: LawLayout,
    data: Sequence[Segment],
    runs: Sequence[Segment],
    gaps: Sequence[np.ndarray],
    channels: tuple[str, ...] = (),
) -> NoiseModel | None:
    """Noise of motions (or channels) and forces, from the gaps of free runs.

    Parameters
    ----------
    model, layout
        The model and the columns of its laws.
    data, runs : sequence of Segment
        The records, and the free runs under their measured forces.
    gaps : sequence of ndarray
        Measured less simulated velocities (or channels) of every record.
    channels : tuple of str
        Names of the channels of the gaps; velocities of all DOFs if empty.

    Returns
    -------
    NoiseModel or None
        None if there are no gaps beyond round-off, or too few lines.
    """
    matrices = equivalent_matrices(model, layout, runs)
    lines = _Lines(
        [line_frequencies(segment) for segment in data],
        [fourier_lines(gap, seg.step, taper=True) for seg, gap in zip(data, gaps)],
        [fourier_lines(relative_velocities(r), r.step, taper=True) for r in runs],
    )
    missed = _size(lines.gaps)
    # gaps of channels have other units than the velocities of the run
    motion_size = np.zeros(len(missed)) if channels else _size(lines.velocities)
    if not np.all(missed > ROUND_OFF * motion_size):
        return None

    force = _force_noise_levels(data, model.n_dof)
    low, high = _signal_band(matrices, lines, force)
    lowest, highest = common_band(data)
    signal_band = max(low, lowest), min(high, highest)
    lines = lines.within(signal_band)
    if len(lines) < 2 * MIN_LINES_PER_BIN:
        return None

    floor = ROUND_OFF**2 * (motion_size**2 / len(lines))
    motion, force = _separated(matrices, lines, force, floor, channels)
    share = _share_of_signal(matrices, lines, force)
    return NoiseModel(matrices, motion, force, share, signal_band, channels)


def _force_noise_levels(data: Sequence[Segment], n_dof: int) -> np.ndarray:
    """Density of the white noise of every force and of the base acceleration."""
    densities = np.zeros(n_dof + 1)
    for j in range(n_dof + 1):
        of_records = []
        for segment in data:
            channel = segment.ag if j == n_dof else segment.F[:, j]
            if channel is None or not np.any(channel[segment.valid]):
                continue
            of_records.append(white_density(channel[segment.valid], segment.step))
        if of_records:
            densities[j] = np.mean(of_records)
    return densities


def _signal_band(
    matrices: Matrices, lines: _Lines, force: np.ndarray
) -> tuple[float, float]:
    """Band that holds nearly all power of the run's drifts and accelerations, Hz.

    The lower edge leaves out a share of the drifts' power, the upper edge of that of
    the accelerations.
    """
    f = np.sort(np.concatenate(lines.f), kind="stable")
    from_noise = [_response_to_force_noise(matrices, x, force) for x in lines.f]
    velocity = mean_spectrum(lines.f, _powers(lines.velocities))(f)
    noise = mean_spectrum(lines.f, from_noise)(f)

    drifts = _power_up_to_each_line(f**-2.0, velocity, noise)
    accelerations = _power_up_to_each_line(f**2, velocity, noise)
    low = np.searchsorted(drifts, POWER_OUTSIDE * drifts[-1])
    high = np.searchsorted(accelerations, (1 - POWER_OUTSIDE) * accelerations[-1])
    last = len(f) - 1
    return float(f[min(low, last)]), float(f[min(high, last)])


def _power_up_to_each_line(
    weight: np.ndarray, velocity: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Cumulated power of the signal, every DOF with equal weight."""
    total = velocity * weight[:, None]
    signal = np.maximum(velocity - noise, 0) * weight[:, None]
    # a white force cannot be told from noise: its motion then counts without correction
    has_signal = signal.sum(axis=0) > 0.5 * total.sum(axis=0)
    power = np.where(has_signal, signal, total)
    shares = power / np.maximum(power.sum(axis=0), 1e-300)
    return np.cumsum(shares.sum(axis=1))


def _separated(
    matrices: Matrices,
    lines: _Lines,
    force: np.ndarray,
    floor: np.ndarray,
    channels: Sequence[str],
) -> tuple[SmoothSpectrum, np.ndarray]:
    """Densities of the noise of the motion and of the forces, each less the other."""
    gap_power = _powers(lines.gaps)
    motion = median_spectrum(lines.f, gap_power)
    floor = np.maximum(floor, LEAST_MOTION_NOISE * motion.values)
    motion = replace(motion, values=np.maximum(motion.values, floor))

    for _ in range(SEPARATION_ROUNDS):
        bound = _force_noise_bound(matrices, lines, motion, force > 0, channels)
        force = np.minimum(force, bound)

        of_motion = []
        for f, power in zip(lines.f, gap_power):
            of_force = _response_to_force_noise(matrices, f, force, channels)
            of_motion.append(power - MEDIAN_OVER_MEAN * of_force)
        motion = median_spectrum(lines.f, of_motion)
        motion = replace(motion, values=np.maximum(motion.values, floor))
    return motion, force


def _response_to_force_noise(
    matrices: Matrices,
    f: np.ndarray,
    force: np.ndarray,
    channels: Sequence[str] = (),
) -> np.ndarray:
    """Density of the velocities (or channels) that the noise of the forces makes."""
    out = np.empty((len(f), len(channels) or len(matrices[0])))
    for rows in blocks_of_lines(len(f)):
        out[rows] = (np.abs(transfer(matrices, f[rows], channels)) ** 2) @ force
    return out


def _force_noise_bound(
    matrices: Matrices,
    lines: _Lines,
    motion: SmoothSpectrum,
    noisy: np.ndarray,
    channels: Sequence[str],
) -> np.ndarray:
    """Upper bound of the density of every noisy force, from its share in the gaps."""
    bound = np.full(len(noisy), np.inf)
    if not noisy.any():
        return bound

    estimates = []
    variances = []
    for f, gaps in zip(lines.f, lines.gaps):
        for rows in blocks_of_lines(len(f)):
            G = transfer(matrices, f[rows], channels)[:, :, noisy]
            weighted = G.conj().transpose(0, 2, 1) / motion(f[rows])[:, None, :]
            inverse = np.linalg.pinv(weighted @ G, hermitian=True)
            force = inverse @ (weighted @ gaps[rows][:, :, None])
            estimates.append(np.abs(force[:, :, 0]) ** 2)
            variances.append(np.einsum("ijj->ij", inverse).real)
    estimate = np.concatenate(estimates)
    variance = np.concatenate(variances)

    # only lines in which the noise of the motion blurs the force least
    share = np.clip(2 * MIN_LINES_PER_BIN / len(variance), 0.1, 1.0)
    for i, j in enumerate(np.flatnonzero(noisy)):
        clear = variance[:, i] <= np.quantile(variance[:, i], share)
        bound[j] = np.median(estimate[clear, i]) / MEDIAN_OVER_MEAN
    return bound


def _share_of_signal(
    matrices: Matrices, lines: _Lines, force: np.ndarray
) -> SmoothSpectrum:
    """Share of the simulated motion that the noise of the forces did not make."""
    from_noise = [_response_to_force_noise(matrices, f, force) for f in lines.f]
    motion = mean_spectrum(lines.f, _powers(lines.velocities))
    noise = mean_spectrum(lines.f, from_noise)
    share = 1 - noise.values / np.maximum(motion.values, 1e-300)
    return SmoothSpectrum(motion.f, np.clip(share, 1e-6, 1.0))


def expected_gaps(
    noise: NoiseModel, names: tuple[str, ...], gap: np.ndarray, dt: float
) -> np.ndarray:
    """What a run misses of some channels, given what it misses of the measured ones.

    Parameters
    ----------
    noise : NoiseModel
        Of the measured channels.
    names : tuple of str
        The channels that are asked for.
    gap : ndarray of shape (n_samples, n_channels)
        What the run misses of the measured channels.
    dt : float
        s.

    Returns
    -------
    ndarray of shape (n_samples, n_names)
    """
    f = np.fft.rfftfreq(len(gap), dt)
    # of a constant force a free chain moves without bound
    f[0] = 1e-3 * f[1]
    lines = np.empty((len(f), len(names)), dtype=complex)
    for rows, forces in noise.likely_forces(f, np.fft.rfft(gap, axis=0)):
        lines[rows] = (transfer(noise.matrices, f[rows], names) @ forces)[:, :, 0]
    return np.fft.irfft(lines, len(gap), axis=0)


def corrected(segment: Segment, gap: np.ndarray, noise: NoiseModel) -> Segment:
    """The record with its force and base acceleration corrected by the measured motion.

    Parameters
    ----------
    segment : Segment
    gap : ndarray of shape (n_valid, n_channels)
        What the free run of a model misses of the measured motion.
    noise : NoiseModel
    """
    n = segment.n_dof
    rows = segment.valid
    f = line_frequencies(segment)
    first, last = np.searchsorted(f, noise.signal_band, side="left")
    gap_lines = fourier_lines(gap, segment.step)[first:last]

    correction = np.zeros((len(f) + 1, n + 1), dtype=complex)
    inside = correction[1 + first : 1 + last]
    for lines, forces in noise.likely_forces(f[first:last], gap_lines):
        inside[lines] = forces[:, :, 0]
    # the free run misses E_x - G E_u, so the noise of the force enters with a minus
    # sign: its estimate is added
    scale = np.sqrt(segment.step / segment.n_valid)
    change = np.fft.irfft(correction, segment.n_valid, axis=0) / scale

    F = np.array(segment.F, dtype=float)
    F[rows] += change[:, :n]
    if segment.ag is None:
        return replace(segment, F=F)
    ag = np.array(segment.ag, dtype=float)
    ag[rows] += change[:, n]
    return replace(segment, F=F, ag=ag)
