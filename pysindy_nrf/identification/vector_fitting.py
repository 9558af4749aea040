"""Modes of a structure from a few channels, by vector fitting.

The spectra of the channels are fitted with rational functions of common poles
(Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1999); the effect of initial and
final state is fitted with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from operator import attrgetter

import numpy as np
from scipy.ndimage import uniform_filter1d

from .shots import Shot
from .whitened_runs import column_lengths

# Iterations of the poles with those of noise, and as many without.
ROUNDS = 8
# Poles for noise that are tried.
NUMBERS_OF_NOISE_POLES = (0, 2)
# Damping ratio of the first poles, and the highest frequency over their lowest at most.
FIRST_DAMPING = 0.01
MAX_FREQUENCY_RATIO = 300
# Relative difference of poles up to which two sets of modes are one.
SAME_POLES = 1e-3
# Lines in a local mean of the response, by which lines are weighted; share of its rms
# below which weights are even. A noisy force errs in proportion to the response.
LINES_IN_MEAN = 9
LEAST_RESPONSE = 0.05
# Share of the largest line of a smoothed spectrum above which lines are used, and the
# number of lines over which it is smoothed: a part of all, and so many at least.
LEAST_POWER = 1e-3
SMOOTHED_PARTS = 200
MIN_SMOOTHED_LINES = 3
# Twice the power of the largest of some rows of noise, over that of one row and the
# logarithm of their number: a mode of less energy may be noise.
NOISE_POWER = 4.0

# Derivatives between a channel of each kind and an acceleration.
DERIVATIVES = {"x": 2, "v": 1, "a": 0}


@dataclass(frozen=True)
class Residue:
    """Displacement residues of all modes, of a channel on DOF ``channel`` (from 0).

    The input is a force on a DOF (from 0), or the base acceleration (n_dof).
    """

    channel: int
    input: int
    values: np.ndarray


@dataclass(frozen=True)
class Modes:
    """Modes of a chain in the upper half plane.

    Attributes
    ----------
    poles : ndarray of shape (n,)
        1/s.
    residues : list of Residue
    errors : ndarray of shape (n,)
        Relative standard errors of the residues; inf: noise alone may look like this
        mode.
    """

    poles: np.ndarray
    residues: list[Residue]
    errors: np.ndarray


@dataclass(frozen=True)
class _Spectra:
    """Spectra of one shot, line by line."""

    s: np.ndarray  # imaginary frequencies, 1/s
    channels: np.ndarray  # as accelerations, (n_lines, n_channels)
    inputs: np.ndarray  # forces and base acceleration, (n_lines, n_dof + 1)


@dataclass(frozen=True)
class _PoleFit:
    """Least squares of the spectra with given poles."""

    poles: np.ndarray
    residual: float  # sum of squares
    values: list[np.ndarray]  # coefficients, by channel
    energy: np.ndarray  # of each mode in all channels


def modes_of(
    shots: Sequence[Shot], n: int, band: tuple[float, float] = (0.0, np.inf)
) -> list[Modes]:
    """Sets of n modes, from several first poles.

    Parameters
    ----------
    shots : sequence of Shot
    n : int
        Modes, as many as there are DOFs.
    band : tuple of float
        Hz; lines outside are not used.
    """
    spectra = [_spectra_of(shot, band) for shot in shots]
    fit = _VectorFit(spectra, shots[0].channels)

    sets: list[Modes] = []
    for spaced, n_noise_poles in product(
        (np.linspace, np.geomspace), NUMBERS_OF_NOISE_POLES
    ):
        lowest = max(fit.low, fit.high / MAX_FREQUENCY_RATIO)
        frequencies = spaced(lowest, fit.high, n + n_noise_poles + 2)[1:-1]
        modes = fit.modes_from(frequencies * (1j - FIRST_DAMPING), n)
        if not _is_among(modes, sets):
            sets.append(modes)
    return sets


def _is_among(modes: Modes, sets: Sequence[Modes]) -> bool:
    for other in sets:
        if np.allclose(modes.poles, other.poles, rtol=SAME_POLES):
            return True
    return False


def _spectra_of(shot: Shot, band: tuple[float, float]) -> _Spectra:
    """Spectra of a shot between the first and last line that holds motion and force."""
    segment = shot.segment
    rows = segment.valid
    ag = np.zeros(segment.n_valid) if segment.ag is None else segment.ag[rows]
    drives = np.column_stack([segment.F[rows], ag])
    channels = np.fft.rfft(shot.measured, axis=0)[1:]
    inputs = np.fft.rfft(drives, axis=0)[1:]
    f = np.fft.rfftfreq(segment.n_valid, segment.step)[1:]

    used = _holds_power(channels) & _holds_power(inputs)
    used &= (f >= band[0]) & (f <= band[1])
    first = int(np.argmax(used))
    last = len(used) - int(np.argmax(used[::-1]))

    s = 2j * np.pi * f[first:last]
    orders = [DERIVATIVES[channel[0]] for channel in shot.channels]
    accelerations = channels[first:last] * s[:, None] ** orders
    return _Spectra(s, accelerations, inputs[first:last])


def _holds_power(lines: np.ndarray) -> np.ndarray:
    """Mask of the lines in which a smoothed spectrum of all columns holds power."""
    power = np.abs(lines) ** 2
    relative = power / np.maximum(power.max(axis=0), 1e-300)
    width = max(MIN_SMOOTHED_LINES, len(lines) // SMOOTHED_PARTS)
    smooth = np.convolve(relative.sum(axis=1), np.ones(width) / width, "same")
    return smooth > LEAST_POWER * smooth.max()


def _real(values: np.ndarray) -> np.ndarray:
    """Complex equations as real ones."""
    return np.concatenate([values.real, values.imag])


def _partial_fractions(s: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Partial fractions with real coefficients, two a pole, (len(s), 2 n_poles)."""
    upper = 1 / (s[:, None] - poles)
    lower = 1 / (s[:, None] - poles.conj())
    pairs = np.stack([upper + lower, 1j * (upper - lower)], axis=2)
    return pairs.reshape(len(s), -1)


class _VectorFit:
    """Rational functions of common poles, fitted to the spectra of some shots."""

    def __init__(self, spectra: Sequence[_Spectra], channels: Sequence[str]) -> None:
        self.spectra = spectra
        self.channel_dofs = [int(channel[1:]) - 1 for channel in channels]
        self.low = min(abs(lines.s[0]) for lines in spectra)
        self.high = max(abs(lines.s[-1]) for lines in spectra)

        self.response = np.concatenate([lines.channels for lines in spectra])
        size = np.abs(self.response)
        rms = np.sqrt(np.mean(size**2, axis=0))
        local_mean = uniform_filter1d(size, LINES_IN_MEAN, axis=0)
        weights = 1 / (local_mean + LEAST_RESPONSE * rms)
        self.weights = weights / np.sqrt(((weights * size) ** 2).sum(axis=0))

        power = sum((np.abs(lines.inputs) ** 2).sum(axis=0) for lines in spectra)
        self.inputs = np.flatnonzero(power).tolist()
        self.input_sizes = np.sqrt(power)[self.inputs]

    def modes_from(self, poles: np.ndarray, n: int) -> Modes:
        """The n modes that some first poles, which may be more, lead to."""
        for _ in range(ROUNDS):
            poles = self._relocated(poles)
        poles = self._relocated(poles)
        # poles of noise hold little energy
        strongest = np.argsort(-self._fitted(poles).energy)
        poles = poles[strongest[:n]]

        fits = [self._fitted(poles)]
        for _ in range(ROUNDS - 1):
            poles = self._relocated(poles)
            fits.append(self._fitted(poles))
        best = min(fits, key=attrgetter("residual"))

        order = np.argsort(np.abs(best.poles))
        residues = []
        for dof, values in zip(self.channel_dofs, best.values):
            for i, drive in enumerate(self.inputs):
                residue = self._displacement_residue(best.poles, values, i)
                residues.append(Residue(dof, drive, residue[order]))
        return Modes(best.poles[order], residues, self._errors(best)[order])

    def _displacement_residue(
        self, poles: np.ndarray, values: np.ndarray, i: int
    ) -> np.ndarray:
        """Displacement residues of one channel and input from the fitted values."""
        n = len(poles)
        first = i * (2 * n + 1)
        pairs = values[first : first + 2 * n].reshape(n, 2)
        return pairs @ [1, 1j] / self.input_sizes[i] / poles**2

    def _errors(self, fit: _PoleFit) -> np.ndarray:
        """Relative standard errors of the residues of every mode."""
        n_rows = 2 * len(self.response)
        variance = fit.residual / n_rows / len(self.channel_dofs)
        shown = fit.energy / variance
        is_noise = shown < NOISE_POWER * np.log(n_rows)
        return np.where(is_noise, np.inf, 1 / np.sqrt(shown))

    def _columns(self, poles: np.ndarray) -> list[np.ndarray]:
        """Residues, direct terms and transients of one channel, by shot."""
        columns = []
        for number, spectra in enumerate(self.spectra):
            s = spectra.s
            fractions = np.column_stack([_partial_fractions(s, poles), np.ones(len(s))])
            parts = []
            for drive, size in zip(self.inputs, self.input_sizes):
                parts.append(fractions * (spectra.inputs[:, drive] / size)[:, None])
            # initial and final state of a shot act like a short input of its own
            transients = np.column_stack([fractions, s / abs(s[-1])]) / np.sqrt(len(s))
            blank = np.zeros_like(transients)
            for other in range(len(self.spectra)):
                parts.append(transients if other == number else blank)
            columns.append(np.hstack(parts))
        return columns

    def _systems(self, poles: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Weighted real columns and right-hand side of every channel."""
        columns = np.vstack(self._columns(poles))
        systems = []
        for response, weights in zip(self.response.T, self.weights.T):
            system = _real(np.column_stack([columns, response]) * weights[:, None])
            systems.append((system[:, :-1], system[:, -1]))
        return systems

    def _relocated(self, poles: np.ndarray) -> np.ndarray:
        """Zeros of the common denominator."""
        fractions = [_partial_fractions(lines.s, poles) for lines in self.spectra]
        shared = np.vstack(fractions)

        rows = []
        right = []
        for c, (columns, target) in enumerate(self._systems(poles)):
            n_own = columns.shape[1]
            response = self.response[:, c, None]
            denominator = _real(shared * response * self.weights[:, c, None])
            system = [columns / column_lengths(columns), -denominator, target]
            R = np.asarray(np.linalg.qr(np.column_stack(system), mode="r"))
            R = R[n_own:, n_own:]
            rows.append(R[:, :-1])
            right.append(R[:, -1])
        sigma = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]

        n = len(poles)
        A = np.zeros((2 * n, 2 * n))
        for k, pole in enumerate(poles):
            pair = slice(2 * k, 2 * k + 2)
            A[pair, pair] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        b = np.tile([2.0, 0.0], n)
        zeros = np.linalg.eigvals(A - np.outer(b, sigma))

        # two real ones become a pair
        zeros = zeros[np.argsort(-zeros.imag)][:n]
        frequencies = np.clip(np.abs(zeros.imag), 0.5 * self.low, 1.5 * self.high)
        return -np.abs(zeros.real) + 1j * frequencies

    def _fitted(self, poles: np.ndarray) -> _PoleFit:
        """Least squares with given poles."""
        residual = 0.0
        values = []
        energy = np.zeros(len(poles))
        for columns, target in self._systems(poles):
            x = np.linalg.lstsq(columns, target, rcond=None)[0]
            residual += float(((target - columns @ x) ** 2).sum())
            values.append(x)
            energy += self._energy(columns, x, len(poles))
        return _PoleFit(poles, residual, values, energy)

    def _energy(
        self, columns: np.ndarray, values: np.ndarray, n_poles: int
    ) -> np.ndarray:
        """Energy of each mode in one channel."""
        energy = np.zeros(n_poles)
        for i in range(len(self.inputs)):
            first = i * (2 * n_poles + 1)
            residues = slice(first, first + 2 * n_poles)
            terms = (columns[:, residues] * values[residues]).reshape(
                len(columns), -1, 2
            )
            energy += (terms.sum(axis=2) ** 2).sum(axis=0)
        return energy
