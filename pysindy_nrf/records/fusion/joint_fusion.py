"""Motions of neighbouring degrees of freedom, improved by what they know of each other.

The spectra of motions that were fused one by one, less the noise left in them, give the
best linear prediction of every motion from the past of all: a vector autoregression,
found from the Yule-Walker equations. It enters the least squares as a prior. A motion
below its noise becomes its expectation given all channels, and such regressors do not
bias a linear regression (Berkson). Neither a model of the structure nor periodicity is
assumed.

A motion below is the array of the spline coefficients of some DOFs, (size, n_dof), each
about its mean and divided by its standard deviation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft
from scipy.linalg import solveh_banded
from scipy.linalg.blas import dsbmv
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from .dof_fusion import Channels, FusedMotion, Spline, channel_weights, solve
from .splines import DEGREE, BasisLadder, SplineBasis

# Neighbouring degrees of freedom that are treated together.
GROUP_SIZE = 6
# Steps of the past in one prediction. Of 24 simulated records of two to five floors,
# accelerations are up to 4 % less exact with half as many, in sweeps up to 14 %; DOFs
# fused one by one lose a third to a half.
MAX_STEPS = 20
# Coefficients for each step and DOF that the prediction needs at least.
COEFFICIENTS_PER_STEP = 16
# Share of a motion below which its noise is left as it is.
NEGLIGIBLE_NOISE = 1e-4
# Length of the filter of the prior, coefficients, and the share of its largest value
# that counts as its reach. Of 24 simulated records no sample differs from that of
# banded equations throughout by more than 0.5 % of the rms error left.
MAX_RESPONSE = 1024
NEGLIGIBLE_RESPONSE = 1e-3
# Least and largest window of the cross spectra, coefficients.
MIN_WINDOW = 32
MAX_WINDOW = 512
# Least power of motion over noise that a line is taken to have.
MIN_SIGNAL_TO_NOISE = 1e-2
# Values over which the variance of prediction errors is averaged, and the standard
# errors by which it must exceed that of the record: chance reaches three in one of 700
# steps, and a record has thousands.
VARIANCE_SAMPLES = 200
CLEAR_VARIANCE = 6.0


def fuse_jointly(
    channels_of_dofs: Sequence[Channels],
    motions: Sequence[FusedMotion],
    ladder: BasisLadder,
) -> list[FusedMotion]:
    """Improve motions that were fused one by one; those without displacement stay."""
    out = list(motions)
    able = [j for j, motion in enumerate(motions) if _can_be_improved(motion)]
    for group in groups_of_neighbours(able):
        members = [motions[j] for j in group]
        channels = [channels_of_dofs[j] for j in group]
        basis = ladder[min(motion.spacing for motion in members)]
        improved = _improved_coefficients(channels, members, basis)
        if improved is not None:
            for j, coefficients in zip(group, improved.T):
                spline = Spline(basis, coefficients)
                out[j] = FusedMotion(motions[j].noise, basis.spacing, 0.0, spline)
    return out


def _can_be_improved(motion: FusedMotion) -> bool:
    """A motion with noise whose displacement is measured."""
    return motion.spline is not None and motion.high_pass == 0.0


def groups_of_neighbours(dofs: Sequence[int]) -> list[np.ndarray]:
    """Degrees of freedom in groups of neighbours that are treated together."""
    if not dofs:
        return []
    return np.array_split(dofs, -(-len(dofs) // GROUP_SIZE))


@dataclass(frozen=True, eq=False)
class Predictor:
    """Best linear prediction of the motion of some DOFs from the past of all of them.

    Attributes
    ----------
    filters : ndarray of shape (n_steps + 1, n_dof, n_dof)
        The error of the prediction of step k, whitened, is
        ``sum_i filters[i] @ motion[k - i]``.
    noise : float
        Variance of these errors that comes from the noise in the motion.
    """

    filters: np.ndarray
    noise: float

    @property
    def n_steps(self) -> int:
        """Steps of the past that are used."""
        return len(self.filters) - 1

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.filters.shape[1]

    @cached_property
    def _blocks(self) -> np.ndarray:
        """Two matrices that make the errors of ``n_steps`` steps from the block of
        steps before and from their own.
        """
        n_steps, n_dof = self.n_steps, self.n_dof
        step = np.arange(n_steps)
        blocks = np.zeros((2 * n_steps, n_dof, n_steps, n_dof))
        for lag, taps in enumerate(self.filters):
            blocks[step + n_steps - lag, :, step] = taps.T
        return blocks.reshape(2, n_steps * n_dof, n_steps * n_dof)

    def errors(self, motion: np.ndarray) -> np.ndarray:
        """Whitened errors of every step that has a past, (size - n_steps, n_dof)."""
        return _by_blocks(motion, self._blocks, self.n_steps)

    def adjoint(self, errors: np.ndarray) -> np.ndarray:
        """The transposed operation: from errors, with ``n_steps`` rows of zeros before
        and after, to the motion.
        """
        transposed = self._blocks[::-1].swapaxes(1, 2)
        return _by_blocks(errors, transposed, self.n_steps)

    def normal_bands(self, n_rows: int) -> np.ndarray:
        """What the error of each later step adds to a column of the lower band of the
        normal matrix, (n_steps + 1, n_dof, n_rows).
        """
        n_dof = self.n_dof
        bands = np.zeros((len(self.filters), n_dof, n_rows))
        row, column = np.ogrid[:n_dof, :n_dof]
        for lag in range(len(self.filters)):
            later = self.filters[lag:].swapaxes(1, 2)
            products = later @ self.filters[: self.n_steps + 1 - lag]
            if lag == 0:
                products = np.triu(products)
            bands[lag:, row, lag * n_dof + column - row] = products
        return bands


def _by_blocks(series: np.ndarray, blocks: np.ndarray, n_steps: int) -> np.ndarray:
    """A filter over the rows of a series, as products with two matrices."""
    size, n_dof = series.shape
    width = n_steps * n_dof
    padded = np.zeros((-(-size * n_dof // width) + 1, width))
    padded.ravel()[: size * n_dof] = series.ravel()
    out = padded[:-1] @ blocks[0] + padded[1:] @ blocks[1]
    return out.reshape(-1, n_dof)[: size - n_steps]


def prior_correction(
    motion: np.ndarray,
    weights: np.ndarray,
    basis: SplineBasis,
    predictor: Predictor,
) -> np.ndarray:
    """What the prior changes in motions that minimise the squares about the channels.

    The sum of these squares and of ``w(k) |error(k)|^2`` over the steps is least.
    Inside the record, where w is one, the change is the prediction error through a
    filter. Where w is not, at the ends, and as far from there as the filter reaches,
    banded normal equations are solved.

    Parameters
    ----------
    motion : ndarray of shape (size, n_dof)
    weights : ndarray of shape (n_dof, 3)
        Of displacement, velocity and acceleration.
    basis : SplineBasis
    predictor : Predictor

    Returns
    -------
    ndarray of shape (size, n_dof)
    """
    errors = predictor.errors(motion)
    error_weights = _error_weights(errors, motion, predictor)
    response, reach = _response(predictor, weights, basis)
    irregular = np.r_[error_weights[: basis.size - 1] != 1.0, True]
    banded = maximum_filter1d(irregular.astype(np.uint8), 2 * reach + 1)

    change = np.zeros(motion.shape)
    if not banded.all():
        errors *= error_weights[predictor.n_steps : basis.size, None]
        change -= _filtered(errors, response, predictor.n_steps, basis.size)

    equations = _BandedEquations(motion, weights, basis, predictor, error_weights)
    edges = np.flatnonzero(np.diff(np.r_[0, banded, 0]))
    for start, stop in edges.reshape(-1, 2):
        change[start:stop] += equations.step(change, start, stop)
    return change


def _improved_coefficients(
    channels: Sequence[Channels], motions: Sequence[FusedMotion], basis: SplineBasis
) -> np.ndarray | None:
    """Coefficients of a group, (size, n_dof); None if their noise is negligible, or
    they are too few to predict.
    """
    n_steps = min(MAX_STEPS, basis.size // (COEFFICIENTS_PER_STEP * len(motions)))
    if n_steps < 2:
        return None
    on_basis, means = [], []
    for measured, motion in zip(channels, motions):
        assert motion.spline is not None
        own_basis, coefficients = motion.spline
        means.append(own_basis.means @ coefficients)
        if own_basis is not basis:
            coefficients = solve(measured, basis, motion.noise, 0.0)
        on_basis.append(coefficients)

    # the prior describes the motion about its mean
    mean = np.array(means)
    scale = np.array([coefficients.std() for coefficients in on_basis])
    standardised = (np.stack(on_basis, axis=1) - mean) / scale
    weights = np.array([channel_weights(motion.noise, 0.0) for motion in motions])
    weights *= scale[:, None] ** 2

    predictor = _predictor(standardised, weights, basis, n_steps)
    if predictor is None:
        return None
    change = prior_correction(standardised, weights, basis, predictor)
    return (standardised + change) * scale + mean


def _error_weights(
    errors: np.ndarray, motion: np.ndarray, predictor: Predictor
) -> np.ndarray:
    """Weight of the prediction error of every step, (size + n_steps,): zero where there
    is no error, and else one over its variance.
    """
    n_steps = predictor.n_steps
    mean_error = motion.mean(axis=0) @ predictor.filters.sum(axis=0).T
    variance = error_variance(errors - mean_error, predictor.noise)
    weights = np.zeros(len(motion) + n_steps)
    weights[n_steps : len(motion)] = 1.0 / variance
    return weights


def error_variance(errors: np.ndarray, noise: float) -> np.ndarray:
    """Variance of the prediction errors from step to step, (n,): in a sweep or after a
    blow it is not that of the record, which is one and the noise.

    Without it the prior takes the frequencies that a sweep passes last for noise.
    """
    n_dof = errors.shape[1]
    squares = np.einsum("ij,ij->i", errors, errors) / n_dof
    window = -(-VARIANCE_SAMPLES // n_dof)
    local = uniform_filter1d(squares, window, mode="nearest")
    by_chance = CLEAR_VARIANCE * np.sqrt(2.0 / VARIANCE_SAMPLES)
    clear = local > (1.0 + noise) * (1.0 + by_chance)
    return np.where(clear, local - noise, 1.0)


def _response(
    predictor: Predictor, weights: np.ndarray, basis: SplineBasis
) -> tuple[np.ndarray, int]:
    """The filter from prediction errors to changes of the motion, (length, n_dof,
    n_dof), and the number of coefficients that it reaches.
    """
    half = min(MAX_RESPONSE, basis.size) // 2
    forward = rfft(predictor.filters, 2 * half, axis=0)
    backward = forward.conj().swapaxes(1, 2)
    frequencies = np.pi * np.arange(half + 1) / half
    data = (weights @ np.maximum(basis.spectra(frequencies), 0.0)).T
    normal = backward @ forward + data[:, :, None] * np.eye(predictor.n_dof)
    response = irfft(np.linalg.solve(normal, backward), 2 * half, axis=0)
    response = np.fft.fftshift(response, axes=0)

    size = np.abs(response).max(axis=(1, 2))
    noticeable = np.flatnonzero(size > NEGLIGIBLE_RESPONSE * size.max())
    reach = int(np.abs(noticeable - half).max())
    if reach >= half - 1:
        # no filter of this length is long enough
        return response, basis.size
    return response, max(reach, predictor.n_steps)


def _filtered(
    errors: np.ndarray, response: np.ndarray, n_steps: int, size: int
) -> np.ndarray:
    """Errors through the centred filter by overlap-add, (size, n_dof)."""
    block = 4 * MAX_RESPONSE
    step = block - MAX_RESPONSE
    lines = rfft(response, block, axis=0)
    out = np.zeros((size + 2 * block, errors.shape[1]))
    for start in range(0, len(errors), step):
        spectrum = rfft(errors[start : start + step], block, axis=0)
        product = (lines @ spectrum[:, :, None])[:, :, 0]
        out[start : start + block] += irfft(product, axis=0)
    # the first error is that of coefficient n_steps
    return out[len(response) // 2 - n_steps :][:size]


class _BandedEquations:
    """Normal equations of data and prior, the coefficients of all DOFs in turn."""

    def __init__(
        self,
        motion: np.ndarray,
        weights: np.ndarray,
        basis: SplineBasis,
        predictor: Predictor,
        error_weights: np.ndarray,
    ) -> None:
        self.motion = motion
        self.weights = weights
        self.basis = basis
        self.predictor = predictor
        self.error_weights = error_weights
        self.reach = max(predictor.n_steps, DEGREE + 1)
        n_dof = predictor.n_dof
        n_rows = max((predictor.n_steps + 1) * n_dof, (DEGREE + 1) * n_dof + 1)
        self.prior_bands = predictor.normal_bands(n_rows)

    def step(self, change: np.ndarray, start: int, stop: int) -> np.ndarray:
        """What must be added to the change between two coefficients, (stop - start,
        n_dof).
        """
        n_dof = self.predictor.n_dof
        first = max(start - self.reach, 0)
        last = min(stop + self.reach, self.basis.size)
        inner = slice(start - first, stop - first)
        right = self._prior_residual(change, first, last)
        band = self._prior_band(start, stop)
        for j, weights in enumerate(self.weights):
            matrix = self.basis.normal_matrix(weights, slice(first, last))
            band[:, j, : n_dof * (DEGREE + 1) + 1 : n_dof] += matrix[:, inner].T
            right[:, j] -= dsbmv(
                DEGREE + 1, 1.0, matrix, change[first:last, j], lower=True
            )
        solution = solveh_banded(
            band.reshape((stop - start) * n_dof, -1).T,
            right[inner].ravel(),
            overwrite_ab=True,
            lower=True,
            check_finite=False,
        )
        return solution.reshape(stop - start, n_dof)

    def _prior_residual(self, change: np.ndarray, first: int, last: int) -> np.ndarray:
        """Right-hand side of the prior for the motion with its change so far."""
        n_steps = self.predictor.n_steps
        motion = self.motion[first:last] + change[first:last]
        errors = np.zeros((last - first + n_steps, self.predictor.n_dof))
        weights = self.error_weights[first + n_steps : last, None]
        errors[n_steps : last - first] = self.predictor.errors(motion) * weights
        return -self.predictor.adjoint(errors)

    def _prior_band(self, start: int, stop: int) -> np.ndarray:
        """Columns of the lower band of the prior, (stop - start, n_dof, n_rows)."""
        n_steps = self.predictor.n_steps
        later = sliding_window_view(
            self.error_weights[start : stop + n_steps], n_steps + 1
        )
        return np.tensordot(later, self.prior_bands, 1)


def _predictor(
    motion: np.ndarray, weights: np.ndarray, basis: SplineBasis, n_steps: int
) -> Predictor | None:
    """The prediction that the spectra of the motion, less its noise, allow; None if the
    noise is negligible.
    """
    size, n_dof = motion.shape
    window = min(MAX_WINDOW, max(MIN_WINDOW, size // max(8, 2 * n_dof)), size)
    spectra = _cross_spectra(motion, window)
    spectra[0] = spectra[1].real
    bases = np.maximum(basis.spectra(2 * np.pi * np.fft.rfftfreq(window)), 0.0)
    noise = 1.0 / (weights @ bases).T

    # shares of the acceleration, where noise is largest
    bending = bases[2] / np.maximum(bases[0], 1e-300)
    power = np.einsum("fjj,f->j", spectra.real, bending)
    noise_shares = (noise * bending[:, None]).sum(axis=0) / power
    if noise_shares.max() < NEGLIGIBLE_NOISE**2:
        return None

    covariances = np.fft.irfft(_without_noise(spectra, noise), axis=0)[: n_steps + 1]
    filters = _prediction_error_filters(covariances)
    gains = np.abs(rfft(filters, window, axis=0)) ** 2
    noise_power = (gains * noise[:, None]).sum(axis=(1, 2)).mean() / n_dof
    return Predictor(filters, float(noise_power))


def _without_noise(spectra: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Cross spectra less independent noise, positive definite, (n_lines, n_dof,
    n_dof).
    """
    root = np.sqrt(noise)
    whitened = spectra / root[:, :, None] / root[:, None, :]
    values, vectors = np.linalg.eigh(whitened)
    values = np.maximum(values - 1.0, MIN_SIGNAL_TO_NOISE)
    signal = (vectors * values[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    return signal * root[:, :, None] * root[:, None, :]


def _prediction_error_filters(covariances: np.ndarray) -> np.ndarray:
    """Whitened filters of the prediction error, (n_steps + 1, n_dof, n_dof).

    ``covariances[k]`` is E motion(t) motion(t + k)^T. Yule-Walker equations.
    """
    n_steps, n_dof = len(covariances) - 1, covariances.shape[1]
    # from lag 1 - n_steps on
    lagged = np.concatenate(
        [covariances[n_steps - 1 : 0 : -1].swapaxes(1, 2), covariances[:n_steps]]
    )
    lags = np.arange(n_steps)[:, None] - np.arange(n_steps) + n_steps - 1
    past = lagged[lags].swapaxes(1, 2).reshape(n_steps * n_dof, n_steps * n_dof)
    past[np.diag_indices(len(past))] *= 1 + 1e-10
    cross = covariances[1:].reshape(n_steps * n_dof, n_dof)
    steps = np.linalg.solve(past, cross).T

    error = covariances[0] - steps @ cross
    values, vectors = np.linalg.eigh((error + error.T) / 2)
    whitening = (vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))).T
    by_step = np.split(steps, n_steps, axis=1)
    return np.stack([whitening, *(-whitening @ step for step in by_step)])


def _cross_spectra(motion: np.ndarray, window: int) -> np.ndarray:
    """Two-sided cross spectra by half-overlapping Hann windows.

    As :func:`scipy.signal.csd`, which would transform every DOF once for each pair.
    """
    hann = np.sin(np.pi * np.arange(window) / window) ** 2
    series = np.ascontiguousarray(motion.T)
    pieces = sliding_window_view(series, window, axis=1)[:, :: window - window // 2]
    centred = pieces - pieces.mean(axis=2, keepdims=True)
    lines = rfft(centred * hann).transpose(2, 0, 1)
    return (lines.conj() @ lines.swapaxes(1, 2)) / (pieces.shape[1] * (hann @ hann))
