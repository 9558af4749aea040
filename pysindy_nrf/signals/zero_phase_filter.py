"""One zero-phase filter for everything in a balance: force, response and law columns alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..data.channels import rows_text
from ..exceptions import ChannelError

# The part of the filter's impulse response (sum of magnitudes) that may still reach across the edge.
EDGE_LEVEL = 1e-4

Band = tuple[float | None, float | None] | None


class FairFilter:
    """One linear zero-phase operator, the same for every column of one contiguous record.

    A Butterworth filter run forward and backward, the record mirrored at its ends. All of it is
    linear in the column and identical for every column, so a balance that holds for the raw
    columns holds for the filtered ones to round-off, edges included. Filtering the response alone
    does not have this property; nor has a law evaluated on filtered signals. The mirror is even:
    what lies beyond the ends is rows of the record itself. An odd one would add twice the noise of
    the end sample to all of them, which ruins accelerations derived from displacement.

    Parameters
    ----------
    band : (float, float) or None
        Lower and upper edge, Hz. None or 0 as lower edge = low-pass, None as upper edge =
        high-pass, None for both or ``band=None`` = identity.
    fs : float
        Sampling rate, Hz.
    order : int
        Order of the filter; it acts twice.

    Attributes
    ----------
    edge : int
        Number of samples at each end which what lies outside the record can still reach with more
        than 1e-4 of the impulse response (about three seconds for a 1 Hz high-pass): there the
        columns are fair, but not what an endless record would show. Computed from the filter.

    Raises
    ------
    ChannelError
        If the band is empty, negative or reaches the Nyquist frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.signals.zero_phase_filter import FairFilter
    >>> rng = np.random.default_rng(0)
    >>> columns = rng.normal(size=(4000, 3))
    >>> force = columns @ [2.0, -1.0, 0.5]
    >>> f = FairFilter((1.0, 40.0), fs=500.0)
    >>> bool(np.allclose(f.apply(columns) @ [2.0, -1.0, 0.5], f.apply(force), atol=1e-12))
    True
    """

    def __init__(self, band: Band, fs: float, order: int = 4) -> None:
        self.fs, self.order = float(fs), order
        self.band = check_band(band, self.fs)
        if isinstance(order, bool) or not isinstance(order, (int, np.integer)) or order < 1:
            raise ChannelError(f"Filter order {order!r} is not a positive integer", "4 is usual.")
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

        Notes
        -----
        A record shorter than ``edge`` is extended by no more than its own length less one.
        """
        array = np.asarray(columns, dtype=float)
        if self.sos is None or array.shape[0] < 2:
            return array.copy()
        matrix = array[:, None] if array.ndim == 1 else array
        finite = np.isfinite(matrix)
        unmeasured = np.isnan(matrix).all(axis=0)
        bad = ~finite.all(axis=0) & ~unmeasured
        if bad.any():
            j = int(np.flatnonzero(bad)[0])
            raise ChannelError(
                f"Column {j + 1} given to the filter is not finite in {rows_text(np.flatnonzero(~finite[:, j]))}",
                "Filter the rows between the masked edges, one contiguous record at a time.",
            )
        from scipy.signal import sosfiltfilt

        out = np.full(matrix.shape, np.nan)
        use = ~unmeasured
        if use.any():
            padding = min(max(self.edge, 3 * len(self.sos)), len(matrix) - 1)
            out[:, use] = sosfiltfilt(self.sos.copy(), matrix[:, use], axis=0, padtype="even", padlen=padding)
        return out[:, 0] if array.ndim == 1 else out

    def noise_gain(self) -> float:
        """The part of the power of white noise that the filter, run forward and backward, lets through.

        Returns
        -------
        float
            1 without a band.

        Examples
        --------
        >>> from pysindy_nrf.signals.zero_phase_filter import FairFilter
        >>> round(FairFilter((None, 25.0), fs=200.0).noise_gain(), 2)  # a quarter of the band up to 100 Hz, softly cut
        0.23
        """
        if self.sos is None:
            return 1.0
        from scipy.signal import sosfreqz

        return float(np.mean(np.abs(sosfreqz(self.sos, 8192)[1]) ** 4))

    def __repr__(self) -> str:
        return f"FairFilter(band={self.band}, fs={self.fs:g}, order={self.order}, edge={self.edge})"


def check_band(band: Band, fs: float) -> tuple[float | None, float | None]:
    """A band as (lower or None, upper or None) in Hz, checked against the sampling rate."""
    if not np.isfinite(fs) or fs <= 0:
        raise ChannelError(f"fs={fs!r} is not a sampling rate", "Give a positive number in Hz.")
    if band is None:
        return None, None
    try:
        lo, hi = (None if b is None else float(b) for b in band)
    except (TypeError, ValueError):
        raise ChannelError(
            f"band={band!r} is not a pair of frequencies", "Give (lo, hi) in Hz; None for an open end."
        ) from None
    if any(b is not None and not np.isfinite(b) and b != np.inf for b in (lo, hi)) or (lo is not None and lo < 0):
        raise ChannelError(f"band={band!r} holds an impossible frequency", "Give (lo, hi) in Hz with 0 <= lo < hi.")
    lo = None if not lo else lo
    hi = None if hi is None or hi == np.inf else hi
    nyquist = fs / 2
    if hi is not None and hi >= nyquist:
        raise ChannelError(
            f"Band edge {hi:g} Hz is not below the Nyquist frequency {nyquist:g} Hz of fs = {fs:g} Hz",
            "Lower it, or give None for no upper edge.",
        )
    if lo is not None and lo >= nyquist:
        raise ChannelError(f"Band edge {lo:g} Hz is not below the Nyquist frequency {nyquist:g} Hz", "Lower it.")
    if hi is not None and hi <= (lo or 0.0):
        raise ChannelError(
            f"band={band!r} is empty: the upper edge is not above the lower one", "Give (lo, hi) in Hz with lo < hi."
        )
    return lo, hi


def _design(band: tuple[float | None, float | None], fs: float, order: int) -> np.ndarray | None:
    from scipy.signal import butter

    lo, hi = band
    if lo is None and hi is None:
        return None
    # a high-pass after a low-pass: better conditioned than one band-pass of the doubled order
    parts = []
    if hi is not None:
        parts.append(butter(order, hi, "lowpass", fs=fs, output="sos"))
    if lo is not None:
        parts.append(butter(order, lo, "highpass", fs=fs, output="sos"))
    return np.vstack(parts)


def _edge(sos: np.ndarray) -> int:
    """Samples until less than EDGE_LEVEL of the zero-phase impulse response (sum of magnitudes) is left."""
    from scipy.signal import fftconvolve, sos2zpk, sosfilt

    slowest = np.abs(sos2zpk(sos)[1]).max()
    length = int(min(np.ceil(np.log(1e-6) / np.log(slowest)), 2**22)) + 16
    impulse = np.zeros(length)
    impulse[0] = 1.0
    once = sosfilt(sos, impulse)
    both = np.abs(fftconvolve(once, once[::-1])[length - 1 :])
    tail = np.cumsum(both[::-1])[::-1]
    total = 2 * tail[0] - both[0]
    return int(np.argmax(tail < EDGE_LEVEL * total))


def filters_of(band: Band, data: Any) -> list[FairFilter | None]:
    """The filter of each record, or None for each."""
    if band is None:
        return [None] * len(data.segments)
    filters: list[FairFilter | None] = []
    for seg in data.segments:
        if seg.dt is None:
            raise ChannelError(
                "band= needs the sampling step", "Pass dt= (s) to the estimator, time= to fit, or X with a time index."
            )
        steps = np.diff(seg.t)
        uneven = np.flatnonzero(np.abs(steps - np.median(steps)) > 0.05 * seg.dt)
        if uneven.size:
            raise ChannelError(
                f"band= needs an even clock; the step changes after row {seg.rows.start + int(uneven[0])}",
                "Split the record at gaps, or resample it.",
            )
        filters.append(FairFilter(band, 1.0 / seg.dt))
    return filters
