r"""Gain, sign and delay between two channels of one motion, from their spectra.

Acceleration, velocity and displacement of a DOF are one motion. Where they do not fit,
the transfer between them says why: its phase is a delay (straight in frequency) or an
inversion (pi), its size a gain,

.. math:: \frac{X_c(f)}{X_r(f)} (2 \pi i f)^{-k} = g \, e^{-2 \pi i f \tau} .

A channel behind a first-order high-pass filter, as every ICP amplifier is one, leads
the other by a phase that falls with frequency,

.. math:: \frac{X_c(f)}{X_r(f)} (2 \pi i f)^{-k} = g \, \frac{i f}{i f + f_c} .
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import zoom_fft

# Order of the derivative of a channel of each kind.
ORDERS = {"x": 0, "v": 1, "a": 2}

# Samples of a channel that are used.
MAX_SAMPLES = 65536
# Share of a spectrum's peak below which a line is not used.
STRONG_LINE = 1e-3
# Lines that are averaged.
NEIGHBOURS = 9
# Cycles of a line, at least, within the lasting part of a record.
MIN_CYCLES = 8
# The same for runs that are differentiated first; lines of several runs for each of the
# longest one.
MIN_CYCLES_OF_RUN = 3
LINES_PER_RUN_LINE = 4
# Highest frequency that is used, and the one from which on central differences are not,
# as shares of the sampling rate.
MAX_FREQUENCY = 0.4
MAX_DIFFERENCE_FREQUENCY = 0.45
# Coherence of an informative line, and the share of the lines that must have it.
COHERENT = 0.5
COHERENT_SHARE = 0.2
# Lines are fitted whose coherence is above this, or this share of the largest one.
CLEAR_COHERENCE = 0.9
# Steps of a sample in which a delay is searched, and samples up to which.
STEPS_PER_SAMPLE = 4
MAX_DELAY_SAMPLES = 20
# The search needs as many steps in a short record as one of this length has.
SHORT_RECORD = 256
DELAY_REFINEMENTS = 3
# A corner is there if it leaves less than this share of what gain and delay leave, and
# these leave more than a least misfit. Of 120 channels behind filters of 0.1 to 2 Hz,
# with noise of 0.1 to 10 %, half left 0.11 and less; 480 without one, delays, gains and
# drifts among them, 0.89 and more.
LEFT_BY_A_CORNER = 0.75
MIN_MISFIT = 0.01
# Blocks of lines over which the scatter of the gain is taken.
MAX_BLOCKS = 8
MIN_BLOCKS = 3


@dataclass(frozen=True)
class PairSpectra:
    """Spectra of two channels brought to one kind, averaged over neighbouring lines.

    Attributes
    ----------
    f : ndarray of shape (n_lines,)
        Frequencies, Hz.
    cross, first, second : ndarray of shape (n_lines,)
        Cross spectrum and power of the two.
    measured : ndarray of shape (n_lines,)
        Power of the first channel before it was brought to the kind of the second.
    min_frequency : float
        Lines below have too few cycles, Hz.
    n_samples : int
        Length of the transform.
    """

    f: np.ndarray
    cross: np.ndarray
    first: np.ndarray
    second: np.ndarray
    measured: np.ndarray
    min_frequency: float
    n_samples: int


@dataclass(frozen=True)
class Transfer:
    """How one channel follows another of the same motion.

    Attributes
    ----------
    coherence : float
        Mean over the lines that were fitted; without a fit, the largest.
    coherent : bool
        Whether the channels follow each other at all.
    gain, sign : float
        Their ratio, and +1 or -1; NaN without a fit.
    delay : float
        s, positive if the second channel is late; NaN without a fit.
    scatter : float
        Of the gain: how far it differs with frequency, and what noise may have made of
        it, as a share; infinite where too few lines are clear.
    misfit : float
        Share of the second channel that gain, sign, delay and corner leave.
    corner : float
        Corner, Hz, of a first-order high-pass filter that one channel has passed; NaN
        if none has.
    corner_in_first : bool
        Whether the first channel has passed it.
    """

    coherence: float = np.nan
    coherent: bool = True
    gain: float = np.nan
    sign: float = np.nan
    delay: float = np.nan
    scatter: float = np.nan
    misfit: float = np.nan
    corner: float = np.nan
    corner_in_first: bool = False


def transfer(
    first: np.ndarray,
    second: np.ndarray,
    order: int,
    fs: float,
    band: tuple[float, float] | None = None,
    runs: Sequence[slice] | None = None,
) -> Transfer:
    """Compare a channel with derivatives or integrals of another.

    Parameters
    ----------
    first, second : ndarray of shape (n_samples,)
    order : int
        Order of the derivative of the first that the second is.
    fs : float
        Hz.
    band : (float, float), optional
        Hz; by default wherever the two are coherent.
    runs : sequence of slice, optional
        Rows that are used; all if None.
    """
    if runs is None:
        spectra = spectra_of_record(first, second, order, fs)
    else:
        spectra = spectra_of_runs(first, second, order, fs, runs)
    lines = _strong_lines(spectra, fs, band)
    # the motion is too slow for the length of the record
    if lines.sum() < NEIGHBOURS:
        return Transfer()

    coherence = np.zeros(len(spectra.f))
    coherence[lines] = (
        np.abs(spectra.cross[lines]) ** 2 / spectra.first[lines] / spectra.second[lines]
    )
    highest = float(coherence.max())
    if (coherence[lines] > COHERENT).sum() <= COHERENT_SHARE * lines.sum():
        return Transfer(highest, coherent=False)
    clear = lines & (coherence > CLEAR_COHERENCE * min(1.0, highest))
    # a line or two of noise that are coherent by chance
    if clear.sum() < NEIGHBOURS // 2:
        return Transfer(highest)
    return _fitted(spectra, clear, coherence[clear], fs)


def spectra_of_record(
    first: np.ndarray, second: np.ndarray, order: int, fs: float
) -> PairSpectra:
    """Spectra of an entire record.

    One transform whose neighbouring lines are averaged, and not Welch's segments: the
    derivative is taken line by line before the average. However steep the spectra,
    nothing leaks then.
    """
    known = np.isfinite(first) & np.isfinite(second)
    y = detrended(first[known][:MAX_SAMPLES])
    z = detrended(second[known][:MAX_SAMPLES])
    n_samples = len(y)
    f = np.fft.rfftfreq(n_samples, 1 / fs)
    rate = 2j * np.pi * np.maximum(f, f[1])
    lines_y = derivative_lines(y, max(order, 0), fs)
    lines_z = derivative_lines(z, max(-order, 0), fs)
    if order < 0:
        # both are brought back to the kind of the second
        lines_y = lines_y * rate**order
        lines_z = lines_z * rate**order

    # lines with few cycles within the window, or within the decay of the motion, say
    # little
    window = hann(n_samples)
    lasting = min(_lasting_samples(window * y), _lasting_samples(window * z)) / fs
    return PairSpectra(
        f,
        _average(np.conj(lines_y) * lines_z),
        _average(np.abs(lines_y) ** 2),
        _average(np.abs(lines_z) ** 2),
        _average(np.abs(np.fft.rfft(window * y)) ** 2),
        MIN_CYCLES / lasting if lasting else np.inf,
        n_samples,
    )


def derivative_lines(x: np.ndarray, order: int, fs: float) -> np.ndarray:
    r"""Spectrum of a derivative of a signal under the Hann window.

    The window takes the derivatives by parts, ``w x' = (w x)' - w' x``, so the motion
    may begin or end anywhere under it:

    .. math:: F[w x''] = F[w'' x] - 2 i \omega F[w' x] - \omega^2 F[w x] .

    Parameters
    ----------
    x : ndarray of shape (n_samples,)
    order : {0, 1, 2}
        Order of the derivative.
    fs : float
        Hz.
    """
    n_samples = len(x)
    window = hann(n_samples)
    lines = np.fft.rfft(window * x)
    if order == 0:
        return lines

    rate = 2j * np.pi * np.fft.rfftfreq(n_samples, 1 / fs)
    turn = 2 * np.pi * fs / n_samples
    angle = 2 * np.pi * (np.arange(n_samples) + 0.5) / n_samples
    of_slope = np.fft.rfft(turn * np.sin(angle) * x)
    if order == 1:
        return rate * lines - of_slope
    of_bend = np.fft.rfft(turn**2 * np.cos(angle) * x)
    return rate**2 * lines - 2 * rate * of_slope + of_bend


def spectra_of_runs(
    first: np.ndarray,
    second: np.ndarray,
    order: int,
    fs: float,
    runs: Sequence[slice],
) -> PairSpectra:
    """Spectra of several runs of rows, added up; central differences bring the channels
    to one kind.
    """
    longest = min(max(run.stop - run.start for run in runs), MAX_SAMPLES)
    n_lines = longest * (LINES_PER_RUN_LINE if len(runs) > 1 else 1)
    f = np.fft.rfftfreq(n_lines, 1 / fs)
    reliable = f < MAX_DIFFERENCE_FREQUENCY * fs
    share = _share_of_differences(f, abs(order), fs)
    cross = np.zeros(len(f), dtype=complex)
    power_y, power_z = np.zeros(len(f)), np.zeros(len(f))
    for run in runs:
        y, z = first[run][:longest], second[run][:longest]
        known = np.isfinite(y) & np.isfinite(z)
        y = _differences(y[known], max(order, 0), fs)
        z = _differences(z[known], max(-order, 0), fs)
        if len(y) < 2 * NEIGHBOURS:
            continue
        lines_y = np.fft.rfft(hann(len(y)) * detrended(y), n_lines)
        lines_z = np.fft.rfft(hann(len(z)) * detrended(z), n_lines)
        if order > 0:
            lines_y = lines_y / share
        elif order < 0:
            lines_z = lines_z / share
        cross += np.where(reliable, np.conj(lines_y) * lines_z, 0.0)
        power_y += np.where(reliable, np.abs(lines_y) ** 2, 0.0)
        power_z += np.where(reliable, np.abs(lines_z) ** 2, 0.0)

    first_power = _average(power_y)
    min_frequency = MIN_CYCLES_OF_RUN * fs / longest
    return PairSpectra(
        f,
        _average(cross),
        first_power,
        _average(power_z),
        first_power,
        min_frequency,
        n_lines,
    )


@lru_cache(maxsize=4)
def hann(n_samples: int) -> np.ndarray:
    """Hann window of height two, sampled in the middles of its intervals; SciPy's are
    sampled at their ends.
    """
    return np.asarray(1 - np.cos(2 * np.pi * (np.arange(n_samples) + 0.5) / n_samples))


def detrended(y: np.ndarray) -> np.ndarray:
    """A signal less its least-squares line.

    In closed form, ten times as fast as :func:`scipy.signal.detrend`, and without BLAS,
    whose threads wait for each other.
    """
    t = np.arange(len(y)) - 0.5 * (len(y) - 1)
    return y - y.mean() - (t * y).mean() / np.square(t).mean() * t


def _strong_lines(
    spectra: PairSpectra, fs: float, band: tuple[float, float] | None
) -> np.ndarray:
    """Lines in which both channels move, with enough cycles, in the band."""
    f = spectra.f
    lines = np.arange(len(f)) > NEIGHBOURS
    lines &= (f > spectra.min_frequency) & (f < MAX_FREQUENCY * fs)
    for power in (spectra.measured, spectra.second):
        lines &= power > STRONG_LINE * power.max()
    if band is not None:
        lines &= (f >= band[0]) & (f <= band[1])
    return lines


def _fitted(
    spectra: PairSpectra, lines: np.ndarray, coherence: np.ndarray, fs: float
) -> Transfer:
    """Gain, sign, delay and corner that fit best in some lines."""
    cross, second = spectra.cross[lines], spectra.second[lines]
    # between the gains that noise in the one and in the other channel makes too small
    # and too large
    response = cross / np.abs(cross) * np.sqrt(second / spectra.first[lines])
    plain = _gain_and_delay(spectra, lines, coherence, response, fs)

    f = spectra.f[lines]
    weight = _weight(coherence)
    best = plain
    if plain.misfit < MIN_MISFIT:
        return plain
    for in_first in (True, False):
        corner = _corner(1.0 / response if in_first else response, f, weight)
        if not corner > 0:
            continue
        filtered = 1.0 / (1.0 - 1j * corner / f)
        free = response * filtered if in_first else response / filtered
        fit = _gain_and_delay(spectra, lines, coherence, free, fs)
        if fit.misfit < min(LEFT_BY_A_CORNER * plain.misfit, best.misfit):
            best = replace(fit, corner=corner, corner_in_first=in_first)
    return best


def _weight(coherence: np.ndarray) -> np.ndarray:
    """Weights of lines: their signal over their noise."""
    return np.minimum(coherence / np.maximum(1 - coherence, 1e-6), 1e3)


def _corner(response: np.ndarray, f: np.ndarray, weight: np.ndarray) -> float:
    """Corner, Hz, of the high-pass filter that a response comes nearest to.

    Its inverse ``(1 - i fc / f) / g`` is linear in ``1 / g`` and ``fc / g``.
    """
    inverse = 1.0 / response
    level = float(np.average(inverse.real, weights=weight))
    slope = -float((weight * inverse.imag / f).sum() / (weight / f**2).sum())
    return slope / level


def _gain_and_delay(
    spectra: PairSpectra,
    lines: np.ndarray,
    coherence: np.ndarray,
    response: np.ndarray,
    fs: float,
) -> Transfer:
    """Gain, sign and delay that come nearest to a response in some lines."""
    w = 2 * np.pi * spectra.f[lines]
    second = spectra.second[lines]
    weight = _weight(coherence)

    delay, sign = _delay_and_sign(response, weight, lines, spectra.n_samples, fs)
    for _ in range(DELAY_REFINEMENTS):
        phase = np.angle(sign * response * np.exp(1j * w * delay))
        delay -= float((weight * w * phase).sum() / (weight * w**2).sum())

    log_gain = np.log(np.abs(response))
    gain = float(np.exp(np.average(log_gain, weights=weight)))
    fit = sign * gain * np.exp(-1j * w * delay)
    power = second * coherence
    unexplained = (np.abs(response / fit - 1) ** 2 * power).sum()
    return Transfer(
        float(np.average(coherence)),
        True,
        gain,
        sign,
        delay,
        _scatter(log_gain, w, weight, coherence),
        float(np.sqrt(unexplained / power.sum())),
    )


def _delay_and_sign(
    response: np.ndarray,
    weight: np.ndarray,
    lines: np.ndarray,
    n_samples: int,
    fs: float,
) -> tuple[float, float]:
    """The delay, s, on a grid that lines all phases up best, by a chirp transform, and
    the sign of their sum.
    """
    in_line = np.zeros(int(np.flatnonzero(lines)[-1]) + 1, dtype=complex)
    in_line[lines[: len(in_line)]] = response / np.abs(response) * weight
    fine = max(STEPS_PER_SAMPLE, -(-STEPS_PER_SAMPLE * SHORT_RECORD // n_samples))
    farthest = MAX_DELAY_SAMPLES * fine
    total = zoom_fft(
        in_line.conj(),
        [-MAX_DELAY_SAMPLES / n_samples, MAX_DELAY_SAMPLES / n_samples],
        2 * farthest + 1,
        fs=1.0,
        endpoint=True,
    ).real
    best = int(np.argmax(np.abs(total)))
    return (best - farthest) / fine / fs, 1.0 if total[best] > 0 else -1.0


def _scatter(
    log_gain: np.ndarray, w: np.ndarray, weight: np.ndarray, coherence: np.ndarray
) -> float:
    """Scatter of the log gain over frequency: between blocks of lines, towards low
    frequencies, and from noise.
    """
    n_blocks = min(MAX_BLOCKS, len(log_gain) // NEIGHBOURS)
    if n_blocks < MIN_BLOCKS:
        return float("inf")
    blocks = np.array_split(np.arange(len(log_gain)), n_blocks)
    means = np.array([np.average(log_gain[b], weights=weight[b]) for b in blocks])
    shares = np.array([weight[block].sum() for block in blocks])
    mean = float(np.average(means, weights=shares))
    between_blocks = np.sqrt(np.average((means - mean) ** 2, weights=shares))

    # a parabola: what the gain is at frequency zero beyond its standard error
    root = np.sqrt(weight)
    columns = np.column_stack([np.ones(len(w)), (w / w.max()) ** 2]) * root[:, None]
    target = log_gain * root
    parabola = np.linalg.lstsq(columns, target, rcond=None)[0]
    residual = columns @ parabola - target
    variance = NEIGHBOURS * np.linalg.pinv(columns.T @ columns)[0, 0]
    error = np.sqrt(variance * (residual @ residual) / len(residual))
    bend = max(abs(parabola[0] - mean) - 2 * error, 0.0)

    noise = np.average(-0.5 * np.log(np.minimum(coherence, 1.0)), weights=weight)
    return float(between_blocks + bend + noise)


def _lasting_samples(y: np.ndarray) -> float:
    """Samples over which the power of a signal is spread: its sum squared over the sum
    of its squares.
    """
    power = y**2
    return float(power.sum() ** 2 / max((power**2).sum(), np.finfo(float).tiny))


def _share_of_differences(f: np.ndarray, order: int, fs: float) -> np.ndarray:
    """Central differences over derivatives by frequency."""
    share = np.ones(len(f))
    angle = np.minimum(2 * np.pi * f[1:] / fs, 0.9 * np.pi)
    if order == 1:
        share[1:] = np.sin(angle) / angle
    else:
        share[1:] = 2 * (1 - np.cos(angle)) / angle**2
    return share


def _differences(y: np.ndarray, order: int, fs: float) -> np.ndarray:
    """Central differences of order 0 to 2, a sample shorter at either end."""
    if order == 0:
        return y[1:-1]
    if order == 1:
        return (y[2:] - y[:-2]) * (0.5 * fs)
    return (y[2:] - 2 * y[1:-1] + y[:-2]) * fs**2


def _average(lines: np.ndarray) -> np.ndarray:
    """Mean over neighbouring lines."""
    return np.asarray(uniform_filter1d(lines, NEIGHBOURS))
