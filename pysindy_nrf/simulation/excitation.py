"""Excitations of simulated tests: hammer and band-limited random.

Every function returns forces of shape (n_samples, n_dof) that start at time 0; several
levels or places add up. All randomness comes from ``random_state``.
"""

from collections.abc import Iterable

import numpy as np

from ..chain.sites import dofs_of
from ..common import RandomState, generator, positive
from ..exceptions import ChainError, ChannelError
from ..laws.power_series import whole_number
from ..records.zero_phase_filter import check_band, check_rate

MAX_SHARE_OF_BLOWS = 0.5  # of the record: blows would overlap otherwise


def impact_hammer(
    n_dof: int,
    duration: float,
    fs: float,
    *,
    excited: int | Iterable[int],
    level: float | Iterable[float],
    n_hits: int = 10,
    width: float = 0.01,
    spread: float = 0.5,
    random_state: RandomState = None,
) -> np.ndarray:
    r"""Half-sine hammer blows at random times and of random strength.

    .. math:: F(t) = P \sin(\pi (t - t_0) / w), \quad t_0 \le t \le t_0 + w

    Parameters
    ----------
    n_dof : int
    duration, fs : float
        Length (s) and sampling rate (Hz).
    excited : int or iterable of int
        Floors that are hit in turn.
    level : float or iterable of float
        Largest peak of the blows, N; several levels are used in turn, blow after blow.
    n_hits : int
        Number of blows, spread over the record one in each equal part of it.
    width : float
        Length of a blow, s.
    spread : float
        Blows have between (1 - spread) and 1 times the level.
    random_state : int, Generator or None

    Returns
    -------
    ndarray of shape (n_samples, n_dof)
        N.

    Raises
    ------
    ChainError, ChannelError
        If a DOF does not exist or a number is out of range.

    Examples
    --------
    >>> from pysindy_nrf.simulation.excitation import impact_hammer
    >>> F = impact_hammer(
    ...     4, 8.0, 1000.0, excited=3, level=1000.0, n_hits=5, random_state=0
    ... )
    >>> (
    ...     F.shape,
    ...     bool(500 < F[:, 2].max() <= 1000),
    ...     float(abs(F[:, [0, 1, 3]]).max()),
    ... )
    ((8000, 4), True, 0.0)
    """
    n_samples, columns = _frame(n_dof, duration, fs, excited)
    levels = _levels(level)
    n_hits = whole_number("n_hits", n_hits, 1)
    width = positive("width", width, "Give it in s.", ChannelError)
    _check_blows(n_hits, width, spread, duration, fs)

    rng = generator(random_state)
    t = np.arange(n_samples) / fs
    F = np.zeros((n_samples, n_dof))
    interval = duration / n_hits
    for hit in range(n_hits):
        start = hit * interval + rng.uniform(0.05, 0.5) * (interval - width)
        peak = levels[hit % len(levels)] * rng.uniform(1 - spread, 1)
        first = int(np.ceil(start * fs))
        last = int(np.floor((start + width) * fs))
        rows = slice(first, last + 1)
        pulse = peak * np.sin(np.pi * (t[rows] - start) / width)
        F[rows, columns[hit % len(columns)]] += pulse
    return F


def _check_blows(
    n_hits: int, width: float, spread: float, duration: float, fs: float
) -> None:
    if not 0 <= spread < 1:
        raise ChannelError(
            f"spread={spread!r} is not between 0 and 1",
            "Give 0 for blows of equal strength.",
        )
    if n_hits * width > MAX_SHARE_OF_BLOWS * duration:
        raise ChannelError(
            f"{n_hits} blows of {width:g} s do not fit into {duration:g} s",
            "Take fewer or a longer record.",
        )
    if width * fs < 2:
        raise ChannelError(
            f"Blows of {width:g} s are shorter than two samples at {fs:g} Hz",
            "Sample faster, or take softer blows.",
        )


def band_limited_random(
    n_dof: int,
    duration: float,
    fs: float,
    *,
    excited: int | Iterable[int],
    rms: float | Iterable[float],
    band: tuple[float, float],
    random_state: RandomState = None,
) -> np.ndarray:
    """Gaussian random forces within a band; the rest as for :func:`impact_hammer`.

    Their spectrum is flat within the band and zero outside.

    Parameters
    ----------
    excited : int or iterable of int
        DOFs that are driven, by independent forces.
    rms : float or iterable of float
        RMS of the force, N; several levels take equal parts of the record one after the
        other.
    band : (float, float)
        Lowest and highest frequency, Hz.

    Examples
    --------
    >>> from pysindy_nrf.simulation.excitation import band_limited_random
    >>> F = band_limited_random(
    ...     2,
    ...     10.0,
    ...     1000.0,
    ...     excited=2,
    ...     rms=200.0,
    ...     band=(1.0, 100.0),
    ...     random_state=0,
    ... )
    >>> round(float((F[:, 1] ** 2).mean() ** 0.5), 6)
    200.0
    """
    n_samples, columns = _frame(n_dof, duration, fs, excited)
    levels = _levels(rms)
    low, high = check_band(band, 1.000001 * fs)  # half the sampling rate is allowed
    limits = low or 0.0, high or np.inf

    rng = generator(random_state)
    F = np.zeros((n_samples, n_dof))
    parts = np.array_split(np.arange(n_samples), len(levels))
    for column in columns:
        for rows, level in zip(parts, levels):
            noise = _in_band(rng.standard_normal(len(rows)), fs, limits)
            size = np.sqrt(np.mean(noise**2))
            if size == 0:
                raise ChannelError(
                    f"The band {band} Hz contains no frequency of a record of"
                    f" {len(rows) / fs:g} s",
                    "Widen it or take a longer record.",
                )
            F[rows, column] = noise * (level / size)
    return F


def _in_band(signal: np.ndarray, fs: float, band: tuple[float, float]) -> np.ndarray:
    """The part of a signal within a band, by its Fourier series."""
    spectrum = np.fft.rfft(signal)
    frequency = np.fft.rfftfreq(len(signal), 1 / fs)
    spectrum[(frequency < band[0]) | (frequency > band[1])] = 0
    return np.fft.irfft(spectrum, len(signal))


def _levels(value: float | Iterable[float]) -> list[float]:
    """Positive levels, at least one."""
    values = np.atleast_1d(np.asarray(value, dtype=object))
    levels = [positive("level", level, "Give N.", ChannelError) for level in values]
    if not levels:
        raise ChannelError("No level is given", "Give at least one, in N.")
    return levels


def _frame(
    n_dof: int, duration: float, fs: float, excited: int | Iterable[int]
) -> tuple[int, list[int]]:
    """Number of samples and columns of the forced DOFs."""
    n_dof = whole_number("n_dof", n_dof, 1)
    seconds = positive("duration", duration, "Give it in s.", ChannelError)
    n_samples = round(seconds * check_rate(fs))
    if n_samples < 2:
        raise ChannelError(
            f"{duration} s at {fs} Hz are {n_samples} samples",
            "At least two are needed.",
        )
    forced = dofs_of("excited", excited, n_dof)
    if not forced:
        raise ChainError(
            "No DOF is excited", f"Give numbers from 1 to {n_dof} in excited=."
        )
    return n_samples, [dof - 1 for dof in forced]
