"""Weighted least-squares fusion of the measured channels into motions that are splines,
noise levels included.

All in units of samples; one degree of freedom at a time, then neighbours together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import comb
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft
from scipy.linalg import solveh_banded
from scipy.linalg.blas import dsbmv
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import welch
from scipy.special import erfinv
from threadpoolctl import threadpool_limits

from .splines import DEGREE, BasisLadder, SplineBasis, ladder_of

# Change of a level at which the search for knots takes it for found: 1 / sqrt(2 n), its
# error from 2,048 samples.
ROUGHLY = 0.016
# Noise below this share of a channel's rms cannot be distinguished from rounding.
FLOOR = 1e-9
# A derivative does not determine the mean position. Its noise level is taken as at
# least this share of the level of the channel it is a derivative of (units of samples);
# otherwise the position is lost in rounding when squared.
REACH = 2e-7
# Channels count as computed, not measured, if their white noise is below a share of
# their rms and they contradict each other by less than the last (as under a force held
# linear between samples), both in the quietest tenth of the samples: friction and blows
# leave kinks, noise is everywhere (36 computed chains with friction, gaps, hysteresis:
# 1e-4 and 3e-4 at most). Derivatives of what is measured raise its noise; where nothing
# has to be derived, the drifts have some ten times its share, and the bias of least
# squares is the square of that, 1e-6.
CLEAN_DERIVED, CLEAN_MEASURED, CLEAN_CONTRADICTION, QUIETEST = 1e-6, 1e-4, 2e-3, 0.1


@dataclass
class FusedMotion:
    """The motion of one degree of freedom, in units of samples: a spline, or values
    where it is at rest or clean.
    """

    noise: np.ndarray  # levels (rms) used, (3,); NaN for a channel that is not measured
    spacing: float  # of the knots, samples
    # cycles per sample at which half of the motion is lost; 0 if x is measured
    high_pass: float
    spline: tuple[SplineBasis, np.ndarray] | None = None  # basis and coefficients
    values: np.ndarray | None = None
    clean: bool = False  # free of noise: the measured channels are passed on unchanged

    @cached_property
    def motion(self) -> np.ndarray:
        """Displacement, velocity, acceleration, (3, n_samples)."""
        if self.spline is not None:
            return self.spline[0].evaluate(self.spline[1])
        assert self.values is not None
        return self.values

    def add(self, weight: np.ndarray, out: np.ndarray) -> None:
        """Add the motion to ``out``, with a weight for each sample."""
        if self.spline is not None:
            self.spline[0].add(self.spline[1], weight, out)
        else:
            out += weight * self.motion


def fuse(
    channels: list[Any],
    ladder: BasisLadder,
    near: float = 1.0,
    noise: np.ndarray | None = None,
    high_pass: float | None = None,
    knots: float | None = None,
) -> FusedMotion:
    """One motion from the measured channels of one degree of freedom, with knots from
    ``near`` on if they are None.
    """
    measured = [o for o in range(3) if channels[o] is not None]
    given = np.full(3, np.nan) if noise is None else np.asarray(noise, dtype=float)
    scale = np.array(
        [np.sqrt(y @ y / ladder.n) if y is not None else np.nan for y in channels]
    )
    moving = [o for o in measured if scale[o] > 0]
    if not moving:  # constant channels: the motion is zero
        return FusedMotion(
            np.where(np.isnan(scale), np.nan, 0.0),
            1.0,
            0.0,
            values=np.zeros((3, ladder.n)),
        )
    scale = np.where(scale > 0, scale, np.nanmax(scale))
    floor = FLOOR * scale
    white = [
        white_level(y) if y is not None and np.isnan(s) else s
        for y, s in zip(channels, given)
    ]
    start = np.maximum(np.array(white), floor)
    corner = 0.0
    if 0 not in measured:
        corner = (
            _lowest_frequency(channels, start, ladder.n)
            if high_pass is None
            else high_pass
        )
    if knots is not None and not np.isnan(given[measured]).any():
        c = _solve(channels, ladder[knots], start, corner)
        return FusedMotion(start, knots, corner, (ladder[knots], c))
    spacings = [h for h in ladder.spacings if len(measured) > 1 or h > 1.0] or [1.0]
    fits: dict[int, tuple[float, np.ndarray, np.ndarray]] = {}
    changing = [slice(None) if y is None else _changing(y) for y in channels]
    fit = partial(_fit, channels, changing, given, floor, corner)

    def fitted(k: int, levels: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        if k not in fits:
            fits[k] = fit(ladder[spacings[k]], levels, ROUGHLY)
        return fits[k]

    quiet = (CLEAN_MEASURED if len(measured) == 3 else CLEAN_DERIVED) * scale
    if all(
        (_quiet_level(channels[o]) if np.isnan(given[o]) else given[o]) < quiet[o]
        for o in measured
    ):
        motion = ladder[spacings[0]].evaluate(fitted(0, start)[1])
        left = [_quietest(motion[o] - channels[o]) for o in measured]
        if np.all(left < CLEAN_CONTRADICTION * scale[measured]):
            return _as_measured(
                channels, measured, ladder, given, floor, fits[0][2], corner
            )
    best = min(range(len(spacings)), key=lambda k: abs(spacings[k] - near))
    lowest, first = fitted(best, start)[0], best
    for way in (
        1,
        -1,
        # coarser knots, then finer ones; one worse step is no end: a blow may show on
        # the finest alone
    ):
        k, worse = first + way, 0
        while 0 <= k < len(spacings) and worse < 2:
            value = fitted(k, fits[k - way][2])[0]
            best, lowest, worse = (
                (k, value, 0) if value < lowest else (best, lowest, worse + 1)
            )
            k += way
    spacing = spacings[best]
    levels = fit(ladder[spacing], fits[best][2])[2]
    if len(measured) == 1 and best == 0 and np.isnan(given[measured[0]]):
        # one channel and no sign of noise beyond its band: follow it sample by sample
        spacing = 1.0
    c = _solve(channels, ladder[spacing], levels, corner)
    return FusedMotion(levels, spacing, corner, (ladder[spacing], c))


def refine(
    views: list[list[np.ndarray | None]], single: list[FusedMotion], ladder: BasisLadder
) -> list[FusedMotion]:
    """Motions on knots twice as dense where acceleration is measured: noisier, but
    nothing of the motion is lost.
    """
    out = list(single)
    for j, (channels, m) in enumerate(zip(views, single, strict=True)):
        if m.spline and channels[2] is not None and m.spacing > 1.0:
            knots = max(1.0, m.spacing / 2)
            out[j] = replace(
                fuse(channels, ladder, 1.0, m.noise, m.high_pass, knots),
                spacing=ladder[knots].h,
            )
    return out


def _as_measured(
    channels: Any,
    measured: list[int],
    ladder: BasisLadder,
    given: Any,
    floor: Any,
    levels: Any,
    corner: float,
) -> FusedMotion:
    spline = ladder[1.0], _solve(channels, ladder[1.0], levels, corner)
    motion = FusedMotion(levels, 1.0, corner, spline).motion
    noise = np.full(3, np.nan)
    for o in measured:
        noise[o] = (
            max(_quiet_level(channels[o]), floor[o]) if np.isnan(given[o]) else given[o]
        )
        if corner == 0.0:
            motion[o] = channels[o]
    return FusedMotion(noise, 1.0, corner, values=motion, clean=True)


def weights_of(levels: np.ndarray, corner: float) -> np.ndarray:
    """Weights of displacement, velocity and acceleration; NaN levels = not measured."""
    least = np.array(levels, dtype=float)
    least[1:] = np.fmax(least[1:], REACH * np.fmax.accumulate(least)[:2])
    weights = np.where(np.isnan(levels), 0.0, least**-2.0)
    if np.isnan(levels[0]):
        wc = 2 * np.pi * corner
        weights[0] = wc**2 * weights[1] + wc**4 * weights[2]
    return weights


def _solve(
    channels: Any, basis: SplineBasis, levels: np.ndarray, corner: float
) -> np.ndarray:
    return basis.solve(weights_of(levels, corner), channels)


def _fit(
    channels: Any,
    changing: Any,
    given: Any,
    floor: Any,
    corner: float,
    basis: SplineBasis,
    levels: Any,
    settled: float = 1e-3,
    rounds: int = 40,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Criterion, coefficients and noise levels for one distance of the knots, from some
    levels on.
    """
    n, measured = basis.n, [o for o in range(3) if channels[o] is not None]
    free = [o for o in measured if np.isnan(given[o])]
    for _ in range(rounds if free else 1):
        weights = weights_of(levels, corner)
        c = basis.solve(weights, channels)
        spent = (
            basis.size
            * weights
            * (basis.spectrum @ (1.0 / (weights @ basis.spectrum)))
            / basis.spectrum.shape[1]
        )
        left = np.maximum(n - spent, 1e-3 * n)
        squares, typical, motion = np.zeros(3), np.zeros(3), basis.evaluate(c)
        for o in measured:
            residual = motion[o] - channels[o]
            squares[o] = residual @ residual
            # by the median: the kink that a hammer blow leaves is not noise
            sizes = np.abs(residual[changing[o]])
            typical[o] = np.partition(sizes, len(sizes) // 2)[len(sizes) // 2] / 0.6745
        new = levels.copy()
        new[free] = np.maximum(typical[free] * np.sqrt(n / left[free]), floor[free])
        change = np.abs(np.log(new[free] / levels[free])).max() if free else 0.0
        levels = new
        if change < settled:
            break
    # generalised cross-validation, summed over the channels on a logarithmic scale
    criterion = 0.0
    for o in measured:
        mean = max(squares[o] / n, floor[o] ** 2)
        if o in free:
            criterion += np.log(mean) - 2 * np.log(left[o] / n)
        else:
            criterion += mean / levels[o] ** 2 + 2 * spent[o] / n
    return criterion, c, levels


def white_level(y: np.ndarray, order: int = 4) -> float:
    """Level of white noise that explains the differences of a channel: its noise, and
    what motion adds to them.
    """
    if len(y) < 4 * order:
        return float(1e-3 * np.sqrt(np.mean(y**2)))
    steps = np.abs(np.diff(y, order))
    if (
        2 * np.count_nonzero(steps) < steps.size
    ):  # constant to the last bit for the most part: see _changing
        steps = steps[steps > 0]
    return (
        float(np.median(steps) / 0.6745 / np.sqrt(comb(2 * order, order)))
        if steps.size
        else 0.0
    )


def _quiet_level(y: np.ndarray) -> float:
    """Level of the white noise of a channel in its quietest samples, by tenth
    differences.
    """
    steps = np.diff(y, 10)
    return (
        _quietest(steps[steps != 0]) / comb(20, 10) ** 0.5
        if len(y) >= 40 and steps.any()
        else white_level(y, 10)
    )


def _quietest(noise: np.ndarray) -> float:
    """Rms of normal noise with the same quietest tenth."""
    return float(np.quantile(np.abs(noise), QUIETEST) / (2**0.5 * erfinv(QUIETEST)))


def _changing(y: np.ndarray) -> slice | np.ndarray:
    """Samples at which a channel changes; all unless it is constant to the last bit for
    half of the record.
    """
    moves = np.diff(y) != 0
    if 2 * np.count_nonzero(moves) >= moves.size or not moves.any():
        return slice(None)
    return np.r_[moves, False] | np.r_[False, moves]


def _lowest_frequency(channels: Any, levels: np.ndarray, n: int) -> float:
    """Half the lowest frequency (cycles per sample) at which a channel rises out of its
    noise.
    """
    found = []
    for o in (1, 2):
        if channels[o] is None or not np.any(channels[o]):
            continue
        f, density = welch(
            channels[o], nperseg=min(n, max(16, n // 8)), detrend="constant"
        )
        above = np.flatnonzero(density[1:] > 4 * 2 * levels[o] ** 2)
        # the signal reaches below the first line that can be told: only the record's
        # length limits
        found.append(
            2.0 / n
            if above.size and above[0] == 0
            else f[1 + above[0]]
            if above.size
            else f[1]
        )
    return 0.5 * min(found)


# Joint fusion: the spectra of the fused motions, less the noise left in them, give the
# best linear prediction of every motion from the past of all (a vector autoregression,
# Yule-Walker equations). It enters the least squares as a prior: a motion below its
# noise becomes its expectation given all channels, and such regressors do not bias a
# linear regression (Berkson). Neither a model of the structure nor periodicity is
# assumed.
GROUP = 6  # neighbouring degrees of freedom treated together
# Steps of the past in one prediction. Of 24 simulated records of two to five floors,
# accelerations are up to 4 % less exact with half as many, in sweeps up to 14 %; DOFs
# fused one by one lose a third to a half.
STEPS = 20
NEGLIGIBLE = 1e-4  # share of a motion below which its noise is left alone
# Length of the filter of the joint pass, steps, and the share of its largest value that
# counts as its reach: of 24 simulated records no sample differs from that of banded
# equations throughout by more than 0.5 % of the rms error left.
LONGEST, TAIL = 1024, 1e-3


def fuse_jointly(
    views: list[list[np.ndarray | None]], single: list[FusedMotion], ladder: BasisLadder
) -> list[FusedMotion]:
    """Improve motions that were fused one by one."""
    able = [j for j, m in enumerate(single) if m.spline and m.high_pass == 0.0]
    out = list(single)
    for group in _groups(able):
        basis = ladder[min(single[j].spacing for j in group)]
        order = min(STEPS, basis.size // (16 * len(group)))
        if order < 2:
            continue
        found = _group(
            [views[j] for j in group], [single[j] for j in group], basis, order
        )
        for j, c in zip(group, () if found is None else found.T):
            out[j] = FusedMotion(single[j].noise, basis.h, 0.0, (basis, c))
    return out


def _groups(able: list[int]) -> list[np.ndarray]:
    """Neighbouring degrees of freedom that are treated together."""
    return np.array_split(able, -(-len(able) // GROUP)) if able else []


def _group(views: Any, single: Any, basis: Any, order: int) -> np.ndarray | None:
    """Coefficients of the motions of a group, (size, n_dof); None if their noise is
    negligible.
    """
    own = [
        m.spline[1] if m.spline[0] is basis else _solve(y, basis, m.noise, 0.0)
        for y, m in zip(views, single)
    ]
    mean = np.array(
        [m.spline[0].mean @ m.spline[1] for m in single]
    )  # the prior describes the motion about its mean
    scale = np.array([x.std() for x in own])
    c = (np.stack(own, axis=1) - mean) / scale
    weights = np.array([weights_of(m.noise, 0.0) for m in single]) * scale[:, None] ** 2
    found = _prediction(c, weights, basis, order)
    return (
        None
        if found is None
        else (c + _correction(c, weights, basis, *found)) * scale + mean
    )


def _correction(
    c: np.ndarray, weights: np.ndarray, basis: Any, filters: np.ndarray, noise: float
) -> np.ndarray:
    """What the prior changes in the coefficients: they minimise  data + sum_k w(k)
    |sum_i G_i c(k - i)|^2.

    Inside the record, where w is one, the change is the prediction error through a
    filter. Where w is not, at the ends, and as far from there as the filter reaches,
    banded normal equations are solved.
    """
    order, (size, n), ahead = len(filters) - 1, c.shape, _ahead(filters)
    errors, weight = _errors(c, ahead), np.zeros(size + order)
    weight[order:size] = 1.0 / _innovations(
        errors - c.mean(axis=0) @ filters.sum(axis=0).T, noise
    )
    taps, far = _taps(filters, weights, basis)
    change = np.zeros((size, n))
    apart = maximum_filter1d(
        np.r_[weight[: size - 1] != 1.0, True].astype(np.uint8), 2 * far + 1
    )
    if not apart.all():
        lines, step, out = (
            rfft(taps, 4 * LONGEST, axis=0),
            3 * LONGEST,
            np.zeros((size + 8 * LONGEST, n)),
        )
        for k in range(0, len(errors), step):  # overlap-add
            part = rfft(
                errors[k : k + step] * weight[order:size, None][k : k + step],
                4 * LONGEST,
                axis=0,
            )
            out[k : k + 4 * LONGEST] += irfft(
                (lines @ part[:, :, None])[:, :, 0], axis=0
            )
        change -= out[len(taps) // 2 - order :][:size]
    reach = max(order, DEGREE + 1)
    shares = _shares(filters, max((order + 1) * n, (DEGREE + 1) * n + 1))
    for lo, hi in np.flatnonzero(np.diff(np.r_[0, apart, 0])).reshape(-1, 2):
        a, b = max(lo - reach, 0), min(hi + reach, size)
        error = np.zeros((b - a + order, n))
        error[order : b - a] = (
            _errors(c[a:b] + change[a:b], ahead) * weight[a + order : b, None]
        )
        right = -_errors(error, ahead[::-1].swapaxes(1, 2))  # the adjoint
        band = np.tensordot(
            sliding_window_view(weight[lo : hi + order], order + 1), shares, 1
        )
        for j, own in enumerate(weights):
            matrix = basis.normal_matrix(own, slice(a, b))
            band[:, j, : n * (DEGREE + 1) + 1 : n] += matrix[
                :, lo - a : hi - a
            ].T  # as LAPACK wants it
            right[:, j] -= dsbmv(DEGREE + 1, 1.0, matrix, change[a:b, j], lower=True)
        flat = band.reshape((hi - lo) * n, -1).T, right[lo - a : hi - a].ravel()
        change[lo:hi] += solveh_banded(
            *flat, overwrite_ab=True, lower=True, check_finite=False
        ).reshape(hi - lo, n)
    return change


def _taps(
    filters: np.ndarray, weights: np.ndarray, basis: Any
) -> tuple[np.ndarray, int]:
    """The filter from prediction errors to changes of the coefficients, (length, n, n),
    and how far it reaches.
    """
    half = min(LONGEST, basis.size) // 2
    forth = rfft(filters, 2 * half, axis=0)
    back = forth.conj().swapaxes(1, 2)
    data = (
        weights @ np.maximum(basis.symbols(np.pi * np.arange(half + 1) / half), 0.0)
    ).T
    normal = back @ forth + data[:, :, None] * np.eye(len(weights))
    taps = np.fft.fftshift(
        irfft(np.linalg.solve(normal, back), 2 * half, axis=0), axes=0
    )
    height = np.abs(taps).max(axis=(1, 2))
    far = int(np.abs(np.flatnonzero(height > TAIL * height.max()) - half).max())
    return taps, (
        max(far, len(filters) - 1) if far < half - 1 else basis.size
    )  # no filter of this length holds it


def _shares(filters: np.ndarray, rows: int) -> np.ndarray:
    """What the prediction error of a later step adds to a column of the lower band,
    (order + 1, n, rows).
    """
    count, n = filters.shape[:2]
    shares = np.zeros((count, n, rows))
    row, column = np.ogrid[:n, :n]
    for lag in range(count):
        blocks = filters[lag:].swapaxes(1, 2) @ filters[: count - lag]
        shares[lag:, row, lag * n + column - row] = blocks if lag else np.triu(blocks)
    return shares


def _ahead(filters: np.ndarray) -> np.ndarray:
    """The prediction filter as two matrices, for blocks of ``order`` steps: of the
    block before and of the block.
    """
    order, n, at = len(filters) - 1, filters.shape[1], np.arange(len(filters) - 1)
    shares = np.zeros((2 * order, n, order, n))
    for i, g in enumerate(filters):
        shares[at + order - i, :, at] = g.T
    return shares.reshape(2, order * n, order * n)


def _errors(c: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Whitened errors of the prediction of every step that has a past, (size - order,
    n).
    """
    (size, n), width = c.shape, ahead.shape[1]
    blocks = np.zeros((-(-size * n // width) + 1, width))
    blocks.ravel()[: size * n] = c.ravel()
    return (blocks[:-1] @ ahead[0] + blocks[1:] @ ahead[1]).reshape(-1, n)[
        : size - width // n
    ]


def _prediction(
    c: np.ndarray, weights: np.ndarray, basis: Any, order: int
) -> tuple[np.ndarray, float] | None:
    """Whitened one-step prediction errors as filters G_0 .. G_order, (order + 1, n, n),
    and the noise in them.
    """
    n = c.shape[1]
    length = min(512, max(32, len(c) // max(8, 2 * n)), len(c))
    f, spectra = np.fft.rfftfreq(length), _cross_spectra(c, length)
    spectra[0] = spectra[1].real
    symbols = np.maximum(basis.symbols(2 * np.pi * f), 0.0)
    noise = 1.0 / (weights @ symbols).T
    bending = symbols[2] / np.maximum(symbols[0], 1e-300)
    share = (noise * bending[:, None]).sum(axis=0) / np.einsum(
        "fjj,f->j", spectra.real, bending
    )
    if share.max() < NEGLIGIBLE**2:
        return None
    root = np.sqrt(noise)
    clear, vectors = np.linalg.eigh(spectra / root[:, :, None] / root[:, None, :])
    clear = np.maximum(clear - 1.0, 1e-2)
    signal = (
        (vectors * clear[:, None, :])
        @ vectors.conj().transpose(0, 2, 1)
        * root[:, :, None]
        * root[:, None, :]
    )
    r = np.fft.irfft(signal, axis=0)[: order + 1]  # r[k] = E c(t) c(t + k)^T

    lagged = np.concatenate(
        [r[order - 1 : 0 : -1].swapaxes(1, 2), r[:order]]
    )  # from lag 1 - order on
    lags = np.arange(order)[:, None] - np.arange(order) + order - 1
    past = lagged[lags].swapaxes(1, 2).reshape(order * n, order * n)
    past[np.diag_indices(len(past))] *= 1 + 1e-10
    cross = np.vstack([r[k + 1] for k in range(order)])
    steps = np.linalg.solve(past, cross).T
    left = r[0] - steps @ cross
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    white = (vectors / np.sqrt(np.maximum(values, 1e-12 * values.max()))).T
    filters = np.stack(
        [white, *(-white @ steps[:, k * n : (k + 1) * n] for k in range(order))]
    )
    return filters, float(
        (np.abs(rfft(filters, length, axis=0)) ** 2 * noise[:, None])
        .sum(axis=(1, 2))
        .mean()
        / n
    )


def _cross_spectra(c: np.ndarray, length: int) -> np.ndarray:
    """Two-sided cross spectra of some columns by half-overlapping Hann windows (Welch),
    (n_lines, n, n).
    """
    window = np.sin(np.pi * np.arange(length) / length) ** 2
    pieces = sliding_window_view(np.ascontiguousarray(c.T), length, axis=1)[
        :, :: length - length // 2
    ]
    lines = rfft((pieces - pieces.mean(axis=2, keepdims=True)) * window).transpose(
        2, 0, 1
    )
    return (lines.conj() @ lines.swapaxes(1, 2)) / (pieces.shape[1] * (window @ window))


def _innovations(errors: np.ndarray, noise: float) -> np.ndarray:
    """Variance of the prediction errors from step to step: in a sweep or after a blow
    it is not that of the record.

    Meaned over 200 values, which tell a variance to a tenth; six standard errors tell
    it from that of the record, which is one and the noise (chance reaches three in one
    of 700 steps, and a record has thousands). Without it the prior takes the
    frequencies that a sweep passes last for noise.
    """
    n = errors.shape[1]
    local = uniform_filter1d(
        np.einsum("ij,ij->i", errors, errors) / n, -(-200 // n), mode="nearest"
    )
    clear = local > (1.0 + noise) * (1.0 + 6.0 * np.sqrt(2.0 / 200))
    return np.where(clear, local - noise, 1.0)


Views = list[np.ndarray | None]

BLOCK = 32768  # samples fused at a time
OVERLAP = 4096  # samples over which neighbouring blocks are cross-faded
# samples of the pieces that tell noise levels (to 1.6 %) and knots of records eight
# times as long
SEARCH = 2048


@threadpool_limits.wrap(
    limits=1
)  # the banded matrices are narrow: threads slow each other down
def fuse_all(
    views: list[Views],
    levels: np.ndarray,
    corner: float | None = None,
    joint: bool = True,
    kept: list | None = None,
    knots: list[float | None] | None = None,
    units: Sequence[float] = (1.0, 1.0, 1.0),
) -> list[FusedMotion]:
    """Motions of all DOFs from channels times ``units``, in units of samples; those of
    each alone are ``kept``.
    """
    known = list(kept or ())

    def one_by_one(
        part: list[Views], ladder: BasisLadder, *given: Any
    ) -> list[FusedMotion]:
        single: list[FusedMotion] = known.pop(0) if known else []
        for y, *own in zip(part, *given, strict=True) if not single else ():
            single.append(fuse(y, ladder, single[-1].spacing if single else 1.0, *own))
        if kept is not None:
            kept.append(single)
        return single

    finish = fuse_jointly if joint else refine
    n, each = len(next(y for y in views[0] if y is not None)), [corner] * len(views)
    knots = knots or [None] * len(views)
    size = (
        SEARCH if all(view[0] is not None for view in views) else BLOCK
    )  # a lowest frequency takes its time
    if n <= max(8 * SEARCH, 3 * (size // 2)):
        views = _part(views, 0, units, n)
        return finish(
            views, one_by_one(views, ladder_of(n), levels, each, knots), ladder_of(n)
        )
    count = -(-(n - OVERLAP) // (BLOCK - OVERLAP)) if n > 3 * BLOCK // 2 else 1
    length = BLOCK if count > 1 else n
    starts = np.linspace(0, n - length, count).astype(int)
    ladder = ladder_of(length)
    first = one_by_one(
        [_telling(view, units, size) for view in views],
        ladder_of(size),
        levels,
        each,
        knots,
    )
    levels, corners = np.array([m.noise for m in first]), [m.high_pass for m in first]
    knots = [
        None if m.clean else m.spacing for m in first
    ]  # channels without noise are looked at block by block
    for group in _groups(
        [j for j, m in enumerate(first) if not m.clean and m.high_pass == 0.0]
    ):
        if (
            joint and kept is None
        ):  # the finest knots of a group are those of all its members
            knots = [
                min(knots[i] for i in group) if j in group else h
                for j, h in enumerate(knots)
            ]
    motion = [np.zeros((3, n)) for _ in views]
    spacing, total = np.zeros(len(views)), np.zeros(n)
    weight = np.minimum(
        length / 2 - np.abs(np.arange(length) + 0.5 - length / 2), OVERLAP
    )
    for start in starts:
        part = _part(views, start, units, length)
        block = finish(part, one_by_one(part, ladder, levels, corners, knots), ladder)
        total[start : start + length] += weight
        for j, m in enumerate(block):
            m.add(weight, motion[j][:, start : start + length])
            spacing[j] = max(spacing[j], m.spacing)
    for values in motion:
        values /= total  # three blocks may overlap
    return [
        FusedMotion(*own)
        for own in zip(levels, spacing, corners, [None] * len(views), motion)
    ]


def _telling(view: Views, units: Sequence[float], size: int) -> Views:
    """The piece of the channels of a DOF with the largest third derivative: it needs
    the finest knots.
    """
    order, y = [(o, y) for o, y in enumerate(view) if y is not None][-1]
    starts = np.linspace(0, len(y) - size, -(-len(y) // size)).astype(int)
    third = np.diff(y, 3 - order)
    sizes = [part @ part for part in (third[k : k + size - 3] for k in starts)]
    return _part([view], starts[np.argmax(sizes)], units, size)[0]


def _part(
    views: list[Views], start: int, units: Sequence[float], size: int
) -> list[Views]:
    return [
        [
            None if y is None else y[start : start + size] * unit
            for y, unit in zip(view, units)
        ]
        for view in views
    ]
