"""Zero-phase filters, the same for force, response and law columns; the usable band of
accelerations.
"""

from typing import Any

import numpy as np
import pandas as pd
from scipy import signal

from ..common import positive
from ..exceptions import ChannelError
from .channels import by_record, rows_text
from .record import row_times

# part of the filter's impulse response (sum of magnitudes) that may still reach across
# the edge
EDGE_LEVEL = 1e-4

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

    def __init__(self, band: Band, fs: float, order: int = 4) -> None:
        self.fs, self.order = float(fs), order
        self.band = check_band(band, self.fs)
        if (
            isinstance(order, bool)
            or not isinstance(order, (int, np.integer))
            or order < 1
        ):
            raise ChannelError(
                f"Filter order {order!r} is not a positive integer", "4 is usual."
            )
        self.sos = _design(self.band, self.fs, int(order))
        self.edge = 0 if self.sos is None else _edge(self.sos)

    def apply(self, columns: Any) -> np.ndarray:
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
        if self.sos is None or array.shape[0] < 2:
            return array.copy()
        matrix = array[:, None] if array.ndim == 1 else array
        finite = np.isfinite(matrix)
        use = ~np.isnan(matrix).all(axis=0)
        bad = use & ~finite.all(axis=0)
        if bad.any():
            j = int(np.flatnonzero(bad)[0])
            what = (
                f"Column {j + 1} given to the filter is not finite in"
                f" {rows_text(np.flatnonzero(~finite[:, j]))}"
            )
            raise ChannelError(
                what,
                "Filter the rows between the masked edges, one contiguous record at a"
                " time.",
            )
        out = np.full(matrix.shape, np.nan)
        if use.any():
            padding = min(max(self.edge, 3 * len(self.sos)), len(matrix) - 1)
            out[:, use] = signal.sosfiltfilt(
                self.sos.copy(), matrix[:, use], axis=0, padtype="even", padlen=padding
            )
        return out[:, 0] if array.ndim == 1 else out

    def noise_gain(self) -> float:
        """The part of the power of white noise that the filter, run forward and
        backward, lets through.
        """
        return (
            1.0
            if self.sos is None
            else float(np.mean(np.abs(signal.sosfreqz(self.sos, 8192)[1]) ** 4))
        )

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
    try:
        lo, hi = (None if b is None else float(b) for b in band)
    except (TypeError, ValueError):
        cure = "Give (lo, hi) in Hz; None for an open end."
        raise ChannelError(
            f"band={band!r} is not a pair of frequencies", cure
        ) from None
    if any(b is not None and not np.isfinite(b) and b != np.inf for b in (lo, hi)) or (
        lo is not None and lo < 0
    ):
        raise ChannelError(
            f"band={band!r} holds an impossible frequency",
            "Give (lo, hi) in Hz with 0 <= lo < hi.",
        )
    lo = None if not lo else lo
    hi = None if hi is None or hi == np.inf else hi
    for edge, cure in (
        (hi, "Lower it, or give None for no upper edge."),
        (lo, "Lower it."),
    ):
        if edge is not None and edge >= nyquist:
            what = (
                f"Band edge {edge:g} Hz is not below the Nyquist frequency {nyquist:g}"
                f" Hz of fs = {fs:g} Hz"
            )
            raise ChannelError(what, cure)
    if hi is not None and hi <= (lo or 0.0):
        cure = "Give (lo, hi) in Hz with lo < hi."
        raise ChannelError(
            f"band={band!r} is empty: the upper edge is not above the lower one", cure
        )
    return lo, hi


def _design(
    band: tuple[float | None, float | None], fs: float, order: int
) -> np.ndarray | None:
    # a high-pass after a low-pass: better conditioned than one band-pass of the doubled
    # order
    edges = zip(band[::-1], ("lowpass", "highpass"))
    parts = [
        signal.butter(order, edge, kind, fs=fs, output="sos")
        for edge, kind in edges
        if edge is not None
    ]
    return np.vstack(parts) if parts else None


def _edge(sos: np.ndarray) -> int:
    """Samples until less than EDGE_LEVEL of the zero-phase impulse response (sum of
    magnitudes) is left.
    """
    slowest = np.abs(signal.sos2zpk(sos)[1]).max()
    length = int(min(np.ceil(np.log(1e-6) / np.log(slowest)), 2**22)) + 16
    impulse = np.zeros(length)
    impulse[0] = 1.0
    once = signal.sosfilt(sos, impulse)
    both = np.abs(signal.fftconvolve(once, once[::-1])[length - 1 :])
    tail = np.cumsum(both[::-1])[::-1]
    total = 2 * tail[0] - both[0]
    return int(np.argmax(tail < EDGE_LEVEL * total))


def filters_of(band: Band, data: Any) -> list[ZeroPhaseFilter | None]:
    """The filter of each record, or None for each."""
    if band is None:
        return [None] * len(data.segments)
    filters: list[ZeroPhaseFilter | None] = []
    for seg in data.segments:
        if seg.dt is None:
            cure = (
                "Pass dt= (s) to the estimator, time= to fit, or X with a time index."
            )
            raise ChannelError("band= needs the sampling step", cure)
        steps = np.diff(seg.t)
        uneven = np.flatnonzero(np.abs(steps - np.median(steps)) > 0.05 * seg.dt)
        if uneven.size:
            what = (
                "band= needs an even clock; the step changes after row"
                f" {seg.rows.start + int(uneven[0])}"
            )
            raise ChannelError(what, "Split the record at gaps, or resample it.")
        filters.append(ZeroPhaseFilter(band, 1.0 / seg.dt))
    return filters


def clock_of(X: Any, time: Any, size: int, record: Any = None) -> np.ndarray | None:
    """Time of the rows in s, from ``time`` or from the index of a table, increasing in
    each record; None if unknown.
    """
    index: Any = getattr(X, "index", None)
    if time is None and isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        time = index
    elif (
        time is None
        and getattr(index, "name", None) in ("t", "time")
        and index.dtype.kind in "fiu"
    ):
        time = index.to_numpy()
    return None if time is None else row_times(time, size, by_record(record, size))


def check_rate(fs: Any) -> float:
    """A sampling rate in Hz, or an error."""
    return positive("fs", fs, "Give the sampling rate in Hz.", ChannelError)


# noise of the displacement that integration may bring along, as a share of the
# displacement
SHARE = 0.02
_TOP = 0.2  # part of the spectrum, from the top, that holds noise alone
_SPOILT = 0.2  # share of the record that a filter may spoil at each end
# share of the kinetic energy that is most of it: slow drifts have little, first modes
# much
_ENERGY = 0.9
# share of the displacement's power that a short record, which asks for a higher edge,
# must keep
_KEPT = 0.8


def _lowest(noise: np.ndarray, signal: np.ndarray, most: float) -> tuple[int, bool]:
    """First line from which on noise is at most such a share of every channel, else the
    best; whether any tells.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sqrt(noise / signal)
    worst = np.where(np.isfinite(share), share, np.inf).max(axis=1)
    at = int(np.argmax(worst <= most)) if worst.min() <= most else int(np.argmin(worst))
    return at, bool(np.isfinite(worst[at]))


def lowest_frequency(
    accelerations: np.ndarray, fs: float, most: float = SHARE
) -> float | None:
    """Frequency above which displacements integrated from noisy accelerations can be
    trusted.

    Where that is less than an octave below most of the kinetic energy, noise may be a
    larger share, ``most``, of the displacement from that octave on.
    """
    channels = np.column_stack([accelerations, np.diff(accelerations, axis=1)])
    channels = channels[:, channels.any(axis=0)]
    if channels.shape[1] == 0:
        return None
    f, density = signal.welch(channels, fs, nperseg=max(64, len(channels) // 6), axis=0)
    f, density = f[1:], density[1:]
    noise = np.median(density[f > (1 - _TOP) * f[-1]], axis=0)
    weight = f[:, None] ** -4.0
    above = lambda y: np.cumsum(y[::-1], axis=0)[::-1]  # noqa: E731
    signal_part, noise_part = (
        above(np.maximum(density - noise, 0.0) * weight),
        above(noise * weight),
    )
    at, clear = _lowest(noise_part, signal_part, SHARE)
    if not clear:
        return None
    if most > SHARE:
        low = _lowest(noise_part, signal_part, most)[0]
        rate = above(np.maximum(density - noise, 0.0) * f[:, None] ** -2.0)
        first = f[
            np.flatnonzero((rate >= _ENERGY * rate[low]).all(axis=1))[-1]
        ]  # about the first mode
        octave = int(np.searchsorted(f, 0.5 * first))
        at = max(_lowest(noise_part, signal_part[octave], most)[0], min(at, octave))
    for i in range(at, int(np.searchsorted(f, 0.1 * fs))):
        if (signal_part[i] < _KEPT * signal_part[at]).any():
            break
        if ZeroPhaseFilter((float(f[i]), None), fs).edge <= _SPOILT * len(channels):
            return float(f[i])
    return None
