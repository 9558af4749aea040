"""Channels that are late, inverted, wrongly scaled, or on their own clocks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.signal import resample_poly

from ...exceptions import ChannelError
from ...laws.sensor import shifted
from ..channels import GAP, as_matrix
from ..quality import Kind
from ..record import OF_LETTER, Record, seconds_of
from .reference_frame import wrong_frame
from .transfer_function import ORDERS, Transfer, transfer

__all__ = ["align", "channel_alignment", "resampled", "split_at_gaps"]

# Samples from which on a channel is called late, and share of one from which on it is
# called wrongly scaled.
CLEAR_DELAY = 0.05
CLEAR_GAIN = 0.02
# Share of a channel that gain, sign and delay leave, from which on it is of another
# place.
OTHER_PLACE = 0.5
# Relative difference of two ratios of rates that count as the same, and the largest
# denominator of a simple ratio.
SAME_RATIO = 1e-6
MAX_DENOMINATOR = 1000


@dataclass(frozen=True)
class ChannelComparison:
    """One motion channel against another of the same DOF.

    Attributes
    ----------
    channel, reference : str
        Such as ``"x2"`` and ``"a2"``.
    fs : float
        Hz.
    transfer : Transfer
        Gain, sign and delay.
    frame_message : str
        Why the channel is in another frame of reference than the record says; empty if
        it is not. Nothing else is compared then.
    """

    channel: str
    reference: str
    fs: float
    transfer: Transfer
    frame_message: str = ""

    @property
    def samples(self) -> float:
        """Delay in samples."""
        return self.transfer.delay * self.fs

    @cached_property
    def faults(self) -> dict[Kind, float]:
        """Kind and size of everything that is wrong, the sizes as those of a
        QualityNote.
        """
        fit = self.transfer
        if self.frame_message:
            return {"frame": np.nan}
        if not fit.coherent:
            return {"incoherent": fit.coherence}
        if fit.misfit > OTHER_PLACE:
            return {"swapped": np.nan}
        faults: dict[Kind, float] = {}
        if fit.sign < 0:
            faults["sign"] = fit.sign
        if abs(self.samples) > CLEAR_DELAY:
            faults["delay"] = fit.delay
        if abs(fit.gain - 1) > CLEAR_GAIN:
            faults["gain"] = fit.gain
        if np.isfinite(fit.corner):
            faults["corner"] = fit.corner
        return faults

    @property
    def filtered_channel(self) -> str:
        """The channel that has passed a high-pass filter, if one has."""
        return self.reference if self.transfer.corner_in_first else self.channel

    @property
    def aligned(self) -> bool:
        """Whether nothing is wrong."""
        return not self.faults

    @property
    def message(self) -> str:
        """What is wrong, in a sentence; empty if nothing is."""
        channel, reference = self.channel, self.reference
        if self.frame_message or not self.faults:
            return self.frame_message
        if "incoherent" in self.faults:
            return (
                f"{channel} and {reference} are not coherent: columns swapped, another"
                " floor, or dead"
            )
        if "swapped" in self.faults:
            return (
                f"{channel} does not follow {reference} as {OF_LETTER[channel[0]]}"
                f" follows {OF_LETTER[reference[0]]}: columns swapped, or a channel of"
                " another floor"
            )
        of_channel = [kind for kind in self.faults if kind != "corner"]
        sentences = []
        if of_channel:
            faults = " and ".join(map(self._phrase, of_channel))
            sentences.append(f"{channel} {faults} against {reference}")
        if "corner" in self.faults:
            sentences.append(self.corner_message)
        return "; ".join(sentences)

    @property
    def corner_message(self) -> str:
        """What a high-pass filter does to one of the two."""
        filtered = self.filtered_channel
        other = self.channel if filtered == self.reference else self.reference
        return (
            f"{filtered} has passed a high-pass filter of first order with its corner"
            f" at {self.transfer.corner:.3g} Hz, as {other} shows"
        )

    def _phrase(self, kind: Kind) -> str:
        if kind == "sign":
            return "has the opposite sign"
        if kind == "gain":
            return f"is {self.transfer.gain:.3g} times as large"
        side = "late" if self.transfer.delay > 0 else "early"
        milliseconds = abs(self.transfer.delay) * 1e3
        return f"is {milliseconds:.3g} ms ({abs(self.samples):.2f} samples) {side}"

    def row(self) -> dict[str, str | float | bool]:
        """A row of the table of :func:`channel_alignment`."""
        fit = self.transfer
        return {
            "reference": self.reference,
            "delay": fit.delay,
            "samples": self.samples,
            "gain": fit.gain,
            "scatter": fit.scatter,
            "sign": fit.sign,
            "coherence": fit.coherence,
            "corner": fit.corner,
            "aligned": self.aligned,
            "message": self.message,
        }


def channel_alignment(
    record: Record,
    band: tuple[float, float] | None = None,
    reference: str = "a",
    runs: Sequence[slice] | None = None,
) -> pd.DataFrame:
    """Delay, gain and sign of each motion channel against another channel of the same
    DOF.

    Parameters
    ----------
    record : Record
    band : (float, float), optional
        Hz; by default wherever the two channels are coherent.
    reference : {"a", "v", "x"}
        Kind taken as right; where a DOF lacks it the first that it has of a, v, x.
    runs : sequence of slice, optional
        Rows that are looked at; all if None.

    Returns
    -------
    DataFrame
        By channel:

        - ``reference``: the other channel.
        - ``delay``: s, positive for a late channel; the same in ``samples``.
        - ``gain``, and its ``scatter`` with frequency and by noise, as a share;
          infinite where too few lines are clear.
        - ``sign``: +1 or -1.
        - ``coherence``.
        - ``corner``: Hz, of a high-pass filter that one of the two has passed.
        - ``aligned``: bool, and ``message``.

    Raises
    ------
    ChannelError
        If no DOF has two kinds of channels.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records.checks.alignment import channel_alignment
    >>> rec = datasets.load_demo()
    >>> table = channel_alignment(rec.replace(displacement=-rec.displacement))
    >>> table["sign"].tolist()
    [-1.0, -1.0, -1.0]
    """
    comparisons = compare_channels(record, band, reference, runs)
    if not comparisons:
        raise ChannelError(
            f"No DOF of record {record.name!r} has two kinds of motion channels",
            "Delays between DOFs show in the balances only.",
        )
    names = [comparison.channel for comparison in comparisons]
    rows = [comparison.row() for comparison in comparisons]
    return pd.DataFrame(rows, index=pd.Index(names, name="channel"))


def compare_channels(
    record: Record,
    band: tuple[float, float] | None = None,
    reference: str = "a",
    runs: Sequence[slice] | None = None,
) -> tuple[ChannelComparison, ...]:
    """Compare the motion channels of each DOF; see :func:`channel_alignment`.

    Returns
    -------
    tuple of ChannelComparison
        Empty if no DOF has two kinds of channels.
    """
    if reference not in ORDERS:
        raise ChannelError(
            f"reference={reference!r} is unknown", "Choose 'a', 'v' or 'x'."
        )
    channels = record.channels()
    base = _base_acceleration(record)
    out = []
    for j in range(1, record.n_dof + 1):
        kinds = [kind for kind in "avx" if f"{kind}{j}" in channels]
        first = reference if reference in kinds else "".join(kinds[:1])
        for kind in kinds:
            if kind != first:
                out.append(_comparison(record, base, j, first, kind, band, runs))
    return tuple(out)


def _base_acceleration(record: Record) -> np.ndarray | None:
    """What must be taken off absolute accelerations; None if nothing must."""
    if record.coordinates == "absolute" or not record.base_moves:
        return None
    if record.base_acceleration is None:
        raise ChannelError(
            f"Record {record.name!r} has a moving base without its acceleration",
            "Give base_acceleration.",
        )
    return record.base_acceleration


def _comparison(
    record: Record,
    base: np.ndarray | None,
    dof: int,
    reference: str,
    kind: str,
    band: tuple[float, float] | None,
    runs: Sequence[slice] | None,
) -> ChannelComparison:
    """One kind of channel of a DOF against another."""
    names = f"{kind}{dof}", f"{reference}{dof}"
    message = wrong_frame(record, dof, kind, reference)
    if message:
        return ChannelComparison(*names, record.fs, Transfer(), message)
    channels = record.channels()
    if base is not None and f"a{dof}" in names:
        channels[f"a{dof}"] = channels[f"a{dof}"] - base
    order = ORDERS[kind] - ORDERS[reference]
    fit = transfer(
        channels[f"{reference}{dof}"],
        channels[f"{kind}{dof}"],
        order,
        record.fs,
        band,
        runs,
    )
    return ChannelComparison(*names, record.fs, fit)


def align(record: Record, alignment: pd.DataFrame, gains: bool = False) -> Record:
    """Shift and invert channels as found by :func:`channel_alignment`.

    Parameters
    ----------
    record : Record
    alignment : DataFrame
        Rows may be dropped or changed before.
    gains : bool
        Correct gains too; a gain shows that one of two channels is wrong, not which.

    Returns
    -------
    Record
        A new one; rows at the ends that a shift leaves empty are NaN in that channel.

    Examples
    --------
    >>> from pysindy_nrf import datasets
    >>> from pysindy_nrf.records.checks.alignment import (
    ...     align,
    ...     channel_alignment,
    ... )
    >>> rec = datasets.load_demo()
    >>> turned = rec.replace(
    ...     displacement=-rec.displacement
    ... )  # the laser counts the other way
    >>> bool(
    ...     (
    ...         align(turned, channel_alignment(turned)).displacement
    ...         == rec.displacement
    ...     ).all()
    ... )
    True
    """
    changes: dict[str, np.ndarray] = {}
    for name, row in alignment.iterrows():
        # of an incoherent channel nothing is known to correct
        if row["aligned"] or not np.isfinite(row["sign"]):
            continue
        key, j = OF_LETTER[str(name)[0]], int(str(name)[1:]) - 1
        array = changes.setdefault(key, np.array(getattr(record, key), dtype=float))
        factor = row["sign"]
        if gains and abs(row["gain"] - 1) > CLEAR_GAIN:
            factor = factor / row["gain"]
        if abs(row["samples"]) > CLEAR_DELAY:
            array[:, j] = shifted(array[:, j], -row["samples"])
        array[:, j] *= factor
    return record.replace(**changes)


def resampled(
    channels: Mapping[str, ArrayLike],
    rates: Mapping[str, float],
    fs: float | None = None,
    *,
    name: str = "record",
    coordinates: str = "relative",
) -> Record:
    """One record from channels that were sampled at different rates.

    Parameters
    ----------
    channels : mapping of str to array-like
        By name (``a1``, ``x2``, ``F3``, ``ag``, ...); all start at the same instant.
    rates : mapping of str to float
        Hz, by channel or by kind (``{"a": 1000.0, "x1": 500.0}``).
    fs : float, optional
        Rate wanted, Hz; the lowest of the rates if None.
    name, coordinates : str
        As for :class:`Record`.

    Returns
    -------
    Record
        Resampled with :func:`scipy.signal.resample_poly` (its anti-aliasing filter has
        no delay), cut to the shortest channel.

    Raises
    ------
    ChannelError
        If the rate of a channel is not given, or a rate and the one wanted have no
        simple ratio.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.records.checks.alignment import resampled
    >>> slow, fast = np.arange(1000) / 250, np.arange(4000) / 1000
    >>> rec = resampled(
    ...     {"x1": np.sin(9 * slow), "a1": -81 * np.sin(9 * fast)},
    ...     {"x1": 250.0, "a1": 1000.0},
    ... )
    >>> (
    ...     rec.fs,
    ...     bool(
    ...         np.abs(rec.acceleration + 81 * rec.displacement)[50:-50].max()
    ...         < 0.2
    ...     ),
    ... )
    (250.0, True)
    """
    rate_of = {channel: _rate_of(channel, rates) for channel in channels}
    wanted = float(fs or min(rate_of.values()))
    out = {}
    for channel, values in channels.items():
        line = as_matrix(values, [channel], 1)[:, 0].astype(float)
        ratio = _simple_ratio(channel, rate_of[channel], wanted)
        if ratio != 1:
            line = resample_poly(
                line, ratio.numerator, ratio.denominator, padtype="line"
            )
        out[channel] = line

    shortest = min(map(len, out.values()))
    table = pd.DataFrame({channel: line[:shortest] for channel, line in out.items()})
    return Record.from_frame(table, fs=wanted, name=name, coordinates=coordinates)


def _rate_of(channel: str, rates: Mapping[str, float]) -> float:
    """Sampling rate of a channel, Hz, by its name or its kind."""
    kind = channel.rstrip("0123456789")
    rate = float(rates.get(channel, rates.get(kind, np.nan)))
    if not np.isfinite(rate) or rate <= 0:
        raise ChannelError(
            f"The sampling rate of channel {channel} is unknown",
            "Give it in rates={...}, in Hz.",
        )
    return rate


def _simple_ratio(channel: str, rate: float, wanted: float) -> Fraction:
    ratio = Fraction(wanted / rate).limit_denominator(MAX_DENOMINATOR)
    if abs(float(ratio) * rate / wanted - 1) > SAME_RATIO:
        raise ChannelError(
            f"{rate:g} Hz of channel {channel} and {wanted:g} Hz have no simple ratio",
            "Give another fs.",
        )
    return ratio


def split_at_gaps(
    table: pd.DataFrame,
    fs: float | None = None,
    shortest: int = 100,
    *,
    name: str = "record",
    coordinates: str = "relative",
) -> list[Record]:
    """Records from a table whose clock has gaps, or whose channels have NaN inside.

    Parameters
    ----------
    table : DataFrame
        As for :meth:`Record.from_frame`, with a time.
    fs : float, optional
        Hz; from the usual step if None.
    shortest : int
        Pieces with fewer samples are left out.
    name, coordinates : str
        As for :class:`Record`; the pieces are numbered.

    Raises
    ------
    ChannelError
        If no piece without a gap has ``shortest`` samples, the clock is not finite, or
        :meth:`Record.from_frame` cannot take the channels.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.records.checks.alignment import split_at_gaps
    >>> t = np.delete(
    ...     np.arange(1000) / 100, slice(400, 500)
    ... )  # the logger paused for a second
    >>> table = pd.DataFrame({"t": t, "x1": np.sin(9 * t)})
    >>> [(rec.n_samples, round(rec.fs, 6)) for rec in split_at_gaps(table)]
    [(400, 100.0), (500, 100.0)]
    """
    clock = next((label for label in ("t", "time") if label in table), None)
    time = table.index if clock is None else table[clock].to_numpy()
    channels = table if clock is None else table.drop(columns=[clock])
    steps = np.diff(seconds_of(time))
    usual = 1.0 / fs if fs else float(np.median(steps))
    complete = channels.dropna(axis=1, how="all").notna().all(axis=1).to_numpy()
    breaks = (steps > GAP * usual) | (steps <= 0) | (complete[1:] != complete[:-1])

    out: list[Record] = []
    for rows in np.split(np.arange(len(table)), np.flatnonzero(breaks) + 1):
        if complete[rows[0]] and len(rows) >= shortest:
            record = Record.from_frame(
                channels.iloc[rows].reset_index(drop=True),
                fs=1.0 / usual,
                name=f"{name}, part {len(out) + 1}",
                coordinates=coordinates,
            )
            out.append(record)
    if not out:
        raise ChannelError(
            f"No piece without a gap has {shortest} samples",
            "Repair the channels, or lower shortest=.",
        )
    return out
