"""Excitations of simulated tests: hammer and band-limited random.

Every function returns forces of shape (n_samples, n_dof) that start at time 0; several
levels or places add up. All randomness comes from ``random_state``.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..chain.sites import dofs_of
from ..common import generator, positive
from ..exceptions import ChainError, ChannelError
from ..laws.power_series import whole
from ..records.zero_phase_filter import check_band, check_rate


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
    random_state: Any = None,
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
    n, columns = _frame(n_dof, duration, fs, excited)
    levels = _levels(level)
    hits = whole("n_hits", n_hits, 1)
    width = positive("width", width, "Give it in s.", ChannelError)
    if not 0 <= spread < 1:
        raise ChannelError(
            f"spread={spread!r} is not between 0 and 1",
            "Give 0 for blows of equal strength.",
        )
    if hits * width > 0.5 * duration:
        cure = "Take fewer or a longer record."
        raise ChannelError(
            f"{hits} blows of {width:g} s do not fit into {duration:g} s", cure
        )
    if width * fs < 2:
        cure = "Sample faster, or take softer blows."
        raise ChannelError(
            f"Blows of {width:g} s are shorter than two samples at {fs:g} Hz", cure
        )
    rng = generator(random_state)
    t = np.arange(n) / fs
    F = np.zeros((n, n_dof))
    interval = duration / hits
    for k in range(hits):
        start = k * interval + rng.uniform(0.05, 0.5) * (interval - width)
        peak = levels[k % len(levels)] * rng.uniform(1 - spread, 1)
        rows = slice(int(np.ceil(start * fs)), int(np.floor((start + width) * fs)) + 1)
        F[rows, columns[k % len(columns)]] += peak * np.sin(
            np.pi * (t[rows] - start) / width
        )
    return F


def band_limited_random(
    n_dof: int,
    duration: float,
    fs: float,
    *,
    excited: int | Iterable[int],
    rms: float | Iterable[float],
    band: tuple[float, float],
    random_state: Any = None,
) -> np.ndarray:
    """Gaussian random forces of flat spectrum within a band and none outside; the rest
    as of :func:`impact_hammer`.

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
    n, columns = _frame(n_dof, duration, fs, excited)
    levels = _levels(rms)
    low, high = check_band(band, 1.000001 * fs)  # half the sampling rate is allowed
    rng = generator(random_state)
    F = np.zeros((n, n_dof))
    parts = np.array_split(np.arange(n), len(levels))
    for j in columns:
        for rows, level in zip(parts, levels):
            spectrum = np.fft.rfft(rng.standard_normal(len(rows)))
            frequency = np.fft.rfftfreq(len(rows), 1 / fs)
            spectrum[(frequency < (low or 0.0)) | (frequency > (high or np.inf))] = 0
            piece = np.fft.irfft(spectrum, len(rows))
            size = np.sqrt(np.mean(piece**2))
            if size == 0:
                what = (
                    f"The band {band} Hz holds no frequency of a record of"
                    f" {len(rows) / fs:g} s"
                )
                raise ChannelError(what, "Widen it or take a longer record.")
            F[rows, j] = piece * (level / size)
    return F


def _levels(value: Any) -> list[float]:
    levels = [
        positive("level", x, "Give N.", ChannelError)
        for x in np.atleast_1d(np.asarray(value, dtype=object))
    ]
    if not levels:
        raise ChannelError("No level is given", "Give at least one, in N.")
    return levels


def _frame(n_dof: Any, duration: Any, fs: Any, excited: Any) -> tuple[int, list[int]]:
    """Number of samples and columns of the forced DOFs."""
    count = whole("n_dof", n_dof, 1)
    n = round(
        positive("duration", duration, "Give it in s.", ChannelError) * check_rate(fs)
    )
    if n < 2:
        raise ChannelError(
            f"{duration} s at {fs} Hz are {n} samples", "At least two are needed."
        )
    wanted = dofs_of("excited", excited, count)
    if not wanted:
        raise ChainError(
            "No DOF is excited", f"Give numbers from 1 to {count} in excited=."
        )
    return n, [j - 1 for j in wanted]
