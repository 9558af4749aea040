"""Measurement noise as a share of each channel's RMS."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..common import RandomState, generator, number_of
from ..exceptions import ChannelError
from ..records.record import BASES, OF_LETTER, Record

ARGUMENT_OF_BASE = {short: argument for argument, short in BASES.items()}


def add_noise(
    record: Record,
    level: float,
    random_state: RandomState = None,
    channels: Iterable[str] | None = None,
) -> Record:
    """A record with white Gaussian noise on its channels.

    Parameters
    ----------
    record : Record
    level : float
        Standard deviation of the noise as a share of the RMS of the channel, 0.05 = 5 %
        (the paper's "5 % noise" is a share of the mean, almost nothing for a signal
        that swings about zero).
    random_state : int, Generator or None
        A whole number gives noise its own stream: it may be the one that the
        excitation was drawn from.
    channels : iterable of str, optional
        ``"a"`` (all accelerations), ``"a2"``, ``"F"``, ``"ag"``, the name of a
        covariate; by default every measured force and motion. Channels of zeros (known
        to be unforced) stay zero.

    Raises
    ------
    ChannelError
        If the level is not a share or a channel is not in the record.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf import Record
    >>> from pysindy_nrf.simulation.noise import add_noise
    >>> t = np.arange(5000) / 1000
    >>> rec = Record(
    ...     acceleration=3 * np.sin(40 * t), force=np.cos(9 * t), fs=1000.0
    ... )
    >>> noisy = add_noise(rec, 0.05, random_state=0)
    >>> round(
    ...     float(np.std(noisy.acceleration - rec.acceleration)), 2
    ... )  # 5 % of 3 / sqrt(2)
    0.11
    """
    share = number_of(level)
    if not np.isfinite(share) or share < 0:
        raise ChannelError(
            f"level={level!r} is not a share of the RMS", "Give e.g. 0.05 for 5 %."
        )
    measured = record.channels()
    rng = generator(random_state, "noise")
    noisy = {}
    if channels is None:
        channels = [name for name in measured if name not in record.covariates]
    for name in _chosen(measured, channels, record.name):
        values = np.asarray(measured[name], dtype=float)
        rms = np.sqrt(np.nanmean(values**2))
        noisy[name] = values + share * rms * rng.standard_normal(len(values))
    return record.replace(**_as_arguments(record, noisy))


def _as_arguments(record: Record, channels: dict[str, np.ndarray]) -> dict[str, Any]:
    """Arguments of a Record with some channels replaced."""
    arguments: dict[str, Any] = {}
    for name, values in channels.items():
        if name in record.covariates:
            covariates = arguments.setdefault("covariates", dict(record.covariates))
            covariates[name] = values
        elif name in ARGUMENT_OF_BASE:
            arguments[ARGUMENT_OF_BASE[name]] = values
        else:
            key = OF_LETTER[name[0]]
            if key not in arguments:
                arguments[key] = np.array(getattr(record, key), dtype=float)
            arguments[key][:, int(name[1:]) - 1] = values
    return arguments


def _chosen(
    measured: Iterable[str], channels: str | Iterable[str], record: str
) -> list[str]:
    """Names of the channels that get noise, in the order of the record."""
    chosen: set[str] = set()
    for text in [channels] if isinstance(channels, str) else channels:
        named = {name for name in measured if _matches(name, text)}
        if not named:
            raise ChannelError(
                f"Channel {text!r} is not in record {record!r}",
                f"It has {', '.join(measured)}.",
            )
        chosen |= named
    return [name for name in measured if name in chosen]


def _matches(name: str, text: str) -> bool:
    """Whether a channel is the one named, or of the kind that a letter stands for."""
    if text in OF_LETTER:
        return re.fullmatch(rf"{text}\d+", name) is not None
    return name == text
