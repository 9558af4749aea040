"""Zero-phase filters for motion, force and law columns alike, and the band in which
accelerations determine a displacement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from ..common import positive
from ..exceptions import ChannelError
from .channels import rows_text

if TYPE_CHECKING:
    from .dataset import Dataset, Segment

# Part of the filter's impulse response (sum of magnitudes) that may still reach across
# the edge.
EDGE_LEVEL = 1e-4
# The impulse response is followed until its slowest pole is down to this level, for so
# many samples at most.
IMPULSE_LEVEL = 1e-6
MAX_IMPULSE_SAMPLES = 2**22
# Change of the sampling step, as a share of it, from which on a clock is uneven.
UNEVEN_STEP = 0.05

# Lower and upper edge, Hz; None for an open end, or for no filter.
Band = tuple[float | None, float | None] | None


class ZeroPhaseFilter:
    """One linear zero-phase operator, the same for every column of one contiguous
    record.

    A Butterworth filter run forward and backward, the record mirrored evenly at its
    ends. A balance that holds for the raw columns holds for the filtered ones to
    round-off, edges included; filtering the response alone does not have this property,
    nor has a law evaluated on filtered signals.

    Parameters
    ----------
    band : (float, float) or None
        Lower and upper edge, Hz. None or 0 as lower edge = low-pass, None as upper edge
        = high-pass, None for both or ``band=None`` = identity.
    fs : float
        Sampling rate, Hz.
    order : int
        Order of the filter; it acts twice.
    centred : bool
        Whether the mean of every column is taken out, too.

    Attributes
    ----------
    edge : int
        Number of samples at each end which what lies outside the record can still reach
        with more than 1e-4 of the impulse response (about three seconds for a 1 Hz
        high-pass).

    Raises
    ------
    ChannelError
        If the band is empty, negative or reaches the Nyquist frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.zero_phase_filter import ZeroPhaseFilter
    >>> columns = np.random.default_rng(0).normal(size=(4000, 3))
    >>> f = ZeroPhaseFilter((1.0, 40.0), fs=500.0)
    >>> bool(
    ...     np.allclose(
    ...         f.apply(columns) @ [2.0, -1.0, 0.5],
    ...         f.apply(columns @ [2.0, -1.0, 0.5]),
    ...         atol=1e-12,
    ...     )
    ... )
    True
    """

    def __init__(
        self, band: Band, fs: float, order: int = 4, centred: bool = False
    ) -> None:
        self.fs = float(fs)
        self.order = order
        self.centred = centred
        self.band = check_band(band, self.fs)
        is_integer = isinstance(order, (int, np.integer)) and not isinstance(
            order, bool
        )
        if not is_integer or order < 1:
            raise ChannelError(
                f"Filter order {order!r} is not a positive integer", "4 is usual."
            )
        self.sos = _design(self.band, self.fs, int(order))
        self.edge = 0 if self.sos is None else _edge(self.sos)

    def apply(self, columns: ArrayLike) -> np.ndarray:
        """Filter every column of one contiguous record.

        Parameters
        ----------
        columns : array-like of shape (n_samples,) or (n_samples, p)
            A column that is NaN throughout (not measured) stays so.

        Returns
        -------
        ndarray of the same shape

        Raises
        ------
        ChannelError
            If a column holds NaN or infinite samples besides.
        """
        array = np.asarray(columns, dtype=float)
        if self.centred:
            array = array - array.mean(axis=0)
        if self.sos is None or array.shape[0] < 2:
            return array.copy()
        matrix = array[:, None] if array.ndim == 1 else array
        measured = _finite_columns(matrix)
        out = np.full(matrix.shape, np.nan)
        if measured.any():
            padding = min(max(self.edge, 3 * len(self.sos)), len(matrix) - 1)
            # SciPy needs sections that it may write to; those of an unpickled filter
            # may be mapped from disk
            out[:, measured] = signal.sosfiltfilt(
                self.sos.copy(),
                matrix[:, measured],
                axis=0,
                padtype="even",
                padlen=padding,
            )
        return out[:, 0] if array.ndim == 1 else out

    def noise_gain(self) -> float:
        """The part of the power of white noise that the filter, run forward and
        backward, lets through.
        """
        if self.sos is None:
            return 1.0
        _, response = signal.sosfreqz(self.sos, 8192)
        return float(np.mean(np.abs(response) ** 4))

    def __repr__(self) -> str:
        return (
            f"ZeroPhaseFilter(band={self.band}, fs={self.fs:g}, order={self.order},"
            f" edge={self.edge})"
        )


def check_band(band: Band, fs: float) -> tuple[float | None, float | None]:
    """A band as (lower or None, upper or None) in Hz, checked against the sampling
    rate.
    """
    nyquist = check_rate(fs) / 2
    if band is None:
        return None, None
    low, high = edges_of(band)
    _require_below_nyquist(high, nyquist, "Lower it, or give None for no upper edge.")
    _require_below_nyquist(low, nyquist, "Lower it.")
    if high is not None and high <= (low or 0.0):
        raise ChannelError(
            f"band={band!r} is empty: the upper edge is not above the lower one",
            "Give (lo, hi) in Hz with lo < hi.",
        )
    return low, high


def edges_of(
    band: tuple[float | None, float | None],
) -> tuple[float | None, float | None]:
    """Lower and upper edge as numbers; None for 0 and infinity."""
    try:
        low, high = (None if edge is None else float(edge) for edge in band)
    except (TypeError, ValueError):
        raise ChannelError(
            f"band={band!r} is not a pair of frequencies",
            "Give (lo, hi) in Hz; None for an open end.",
        ) from None
    low_is_possible = low is None or 0 <= low
    high_is_possible = high is None or high > -np.inf
    if not low_is_possible or not high_is_possible:
        raise ChannelError(
            f"band={band!r} holds an impossible frequency",
            "Give (lo, hi) in Hz with 0 <= lo < hi.",
        )
    return low or None, None if high == np.inf else high


def _require_below_nyquist(edge: float | None, nyquist: float, cure: str) -> None:
    if edge is not None and edge >= nyquist:
        raise ChannelError(
            f"Band edge {edge:g} Hz is not below the Nyquist frequency {nyquist:g} Hz"
            f" of fs = {2 * nyquist:g} Hz",
            cure,
        )


def check_rate(fs: float) -> float:
    """A sampling rate in Hz, or an error."""
    return positive("fs", fs, "Give the sampling rate in Hz.", ChannelError)


def _finite_columns(matrix: np.ndarray) -> np.ndarray:
    """Which columns are finite, (p,); the others must be NaN throughout."""
    finite = np.isfinite(matrix)
    measured = ~np.isnan(matrix).all(axis=0)
    broken = np.flatnonzero(measured & ~finite.all(axis=0))
    if broken.size:
        rows = np.flatnonzero(~finite[:, broken[0]])
        raise ChannelError(
            f"Column {broken[0] + 1} given to the filter is not finite in"
            f" {rows_text(rows)}",
            "Filter the rows between the masked edges, one contiguous record at a"
            " time.",
        )
    return measured


def _design(
    band: tuple[float | None, float | None], fs: float, order: int
) -> np.ndarray | None:
    """Second-order sections of a low-pass, then of a high-pass: better conditioned than
    one band-pass of the doubled order.
    """
    low, high = band
    sections = []
    if high is not None:
        sections.append(signal.butter(order, high, "lowpass", fs=fs, output="sos"))
    if low is not None:
        sections.append(signal.butter(order, low, "highpass", fs=fs, output="sos"))
    return np.vstack(sections) if sections else None


def _edge(sos: np.ndarray) -> int:
    """Samples until less than EDGE_LEVEL of the zero-phase impulse response (sum of
    magnitudes) is left.
    """
    slowest = np.abs(signal.sos2zpk(sos)[1]).max()
    duration = np.ceil(np.log(IMPULSE_LEVEL) / np.log(slowest))
    length = int(min(duration, MAX_IMPULSE_SAMPLES)) + 16
    impulse = np.zeros(length)
    impulse[0] = 1.0
    forward = signal.sosfilt(sos, impulse)
    response = signal.fftconvolve(forward, forward[::-1])[length - 1 :]
    tail = np.cumsum(np.abs(response)[::-1])[::-1]
    both_sides = 2 * tail[0] - np.abs(response[0])
    return int(np.argmax(tail < EDGE_LEVEL * both_sides))


def filters_of(band: Band, data: Dataset) -> list[ZeroPhaseFilter | None]:
    """The filter of each record of a data set, or None for each without a band.

    Records with unknown zeros are freed of their means.
    """
    filters: list[ZeroPhaseFilter | None] = []
    for segment in data.segments:
        if band is not None:
            filters.append(_filter_of(band, segment))
        elif segment.offsets is not None:
            filters.append(ZeroPhaseFilter(None, 1.0, centred=True))
        else:
            filters.append(None)
    return filters


def _filter_of(band: Band, segment: Segment) -> ZeroPhaseFilter:
    """The filter of one record, whose clock must be even."""
    if segment.t is None or segment.dt is None:
        raise ChannelError(
            "band= needs the sampling step",
            "Pass dt= (s) to the estimator, time= to fit, or X with a time index.",
        )
    steps = np.diff(segment.t)
    uneven = np.abs(steps - np.median(steps)) > UNEVEN_STEP * segment.dt
    if uneven.any():
        row = segment.rows.start + int(np.flatnonzero(uneven)[0])
        raise ChannelError(
            f"band= needs an even clock; the step changes after row {row}",
            "Split the record at gaps, or resample it.",
        )
    centred = segment.offsets is not None
    return ZeroPhaseFilter(band, 1.0 / segment.dt, centred=centred)


# Noise of an integrated acceleration that may remain in a displacement, as a share of
# it.
MAX_NOISE_SHARE = 0.02
# Part of the spectrum, from the top, that holds noise alone.
NOISE_PART = 0.2
# Share of the record that the filter may spoil at each end.
MAX_SPOILT_SHARE = 0.2
# Share of the kinetic energy that is most of it: slow drifts have little, first modes
# much.
KINETIC_SHARE = 0.9
# Share of the displacement's power that must be left where a short record asks for a
# higher edge.
DISPLACEMENT_SHARE = 0.8
# Highest edge that is tried, as a share of the sampling rate.
MAX_EDGE = 0.1


def lowest_frequency(
    accelerations: np.ndarray, fs: float, max_noise_share: float = MAX_NOISE_SHARE
) -> float | None:
    """Frequency above which displacements integrated from noisy accelerations can be
    trusted.

    Parameters
    ----------
    accelerations : ndarray of shape (n_samples, n_dof)
    fs : float
        Hz.
    max_noise_share : float
        Where the frequency is less than an octave below most of the kinetic energy,
        noise may be this share of the displacement from that octave on.

    Returns
    -------
    float or None
        Hz; None if there is none, or the record is too short for a filter there.
    """
    drifts = np.diff(accelerations, axis=1)
    channels = np.column_stack([accelerations, drifts])
    channels = channels[:, channels.any(axis=0)]
    if channels.shape[1] == 0:
        return None
    displacements = _IntegratedSpectra(channels, fs)
    line = displacements.first_clear_line(MAX_NOISE_SHARE)
    if line is None:
        return None
    if max_noise_share > MAX_NOISE_SHARE:
        line = displacements.line_that_keeps_first_mode(line, max_noise_share)
    return displacements.edge_from(line, MAX_SPOILT_SHARE * len(channels))


class _IntegratedSpectra:
    """Power of displacements above each frequency, from accelerations with noise."""

    def __init__(self, accelerations: np.ndarray, fs: float) -> None:
        segment = max(64, len(accelerations) // 6)
        f, density = signal.welch(accelerations, fs, nperseg=segment, axis=0)
        self.fs = fs
        self.f = f[1:]
        density = density[1:]
        top = self.f > (1 - NOISE_PART) * self.f[-1]
        noise = np.median(density[top], axis=0)
        motion = np.maximum(density - noise, 0.0)
        twice = self.f[:, None] ** -4.0
        self.motion = _power_above(motion * twice)
        self.noise = _power_above(noise * twice)
        self.velocity = _power_above(motion * self.f[:, None] ** -2.0)

    def first_clear_line(self, max_noise_share: float) -> int | None:
        """First line above which noise is at most a share of every displacement, else
        the one with the least share; None if noise is all there is.
        """
        line, share = self._clearest(self.motion, max_noise_share)
        return line if np.isfinite(share) else None

    def line_that_keeps_first_mode(self, line: int, max_noise_share: float) -> int:
        """A lower line, where this one is less than an octave below the first mode and
        more noise is allowed there.
        """
        lowest, _ = self._clearest(self.motion, max_noise_share)
        energetic = self.velocity >= KINETIC_SHARE * self.velocity[lowest]
        first_mode = self.f[np.flatnonzero(energetic.all(axis=1))[-1]]
        octave_below = int(np.searchsorted(self.f, 0.5 * first_mode))
        allowed, _ = self._clearest(self.motion[octave_below], max_noise_share)
        return max(allowed, min(line, octave_below))

    def edge_from(self, line: int, max_edge_samples: float) -> float | None:
        """The first frequency from a line on at which a high-pass spoils few samples of
        the record; None if too much of the displacement lies below it.
        """
        last = int(np.searchsorted(self.f, MAX_EDGE * self.fs))
        for k in range(line, last):
            if (self.motion[k] < DISPLACEMENT_SHARE * self.motion[line]).any():
                return None
            high_pass = ZeroPhaseFilter((float(self.f[k]), None), self.fs)
            if high_pass.edge <= max_edge_samples:
                return float(self.f[k])
        return None

    def _clearest(
        self, motion: np.ndarray, max_noise_share: float
    ) -> tuple[int, float]:
        """First line above which noise is at most such a share of every motion, else
        the line with the least share; and that share.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.sqrt(self.noise / motion)
        worst = np.where(np.isfinite(shares), shares, np.inf).max(axis=1)
        clear = worst <= max_noise_share
        line = int(np.argmax(clear)) if clear.any() else int(np.argmin(worst))
        return line, float(worst[line])


def _power_above(density: np.ndarray) -> np.ndarray:
    """Sum of a density from each line up."""
    return np.cumsum(density[::-1], axis=0)[::-1]
