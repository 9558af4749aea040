"""Channels of one DOF that contradict each other, and what would reconcile them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..chain.sites import Site
from ..exceptions import NRFError
from ..records.checks.alignment import channel_alignment
from .prepare import PreparedRecords
from .search_data import SearchData


@dataclass(frozen=True)
class ContradictionSettings:
    """When channels contradict each other."""

    # Gain or delay, as a share of the channel.
    least_share: float = 0.03
    # Samples below which half a record shows no delay.
    samples_of_half: int = 1000


CONTRADICTIONS = ContradictionSettings()


@dataclass(frozen=True)
class Contradiction:
    """A channel that another channel of its DOF contradicts.

    Attributes
    ----------
    site : Site
        ``"sensor a2"``.
    order : int
        Of the derivative that the channel would have too much of: 0 of a gain, 1 of a
        delay.
    share : float
        Share of that derivative.
    size : float
        How far the channels are apart, as a share.
    witness : str
        How they contradict each other, in words.
    reference : str
        The other channel.
    """

    site: Site
    order: int
    share: float
    size: float
    witness: str
    reference: str


def contradictions(records: PreparedRecords, data: SearchData) -> list[Contradiction]:
    """Contradictions of the channels of one DOF, the largest first.

    Either channel of two may be wrong, and both are listed.
    """
    record = longest_record(data)
    runs = data.runs_in_record(record)
    try:
        table = channel_alignment(records.records[record], runs=runs)
        halves = []
        if not table["aligned"].all():
            for half in _halves(runs):
                halves.append(channel_alignment(records.records[record], runs=half))
    except NRFError:
        return []

    listed: list[Contradiction] = []
    for channel, row in table.iterrows():
        if not row["aligned"] and np.isfinite(row["gain"]):
            parts = [half.loc[channel] for half in halves]
            listed += _contradictions_of(str(channel), row, parts, data)

    # of several at one channel the largest
    by_place = {}
    for contradiction in sorted(listed, key=lambda c: c.size):
        by_place[contradiction.order, contradiction.site] = contradiction
    return sorted(by_place.values(), key=lambda c: -c.size)


def _contradictions_of(
    channel: str, row: pd.Series, halves: Sequence[pd.Series], data: SearchData
) -> Iterator[Contradiction]:
    """How a channel and its reference may be wrong.

    What one half of the record denies is chance.
    """
    delay, gain = float(row["delay"]), _signed_gain(row)
    turn = abs(delay) * mean_rate(data, int(channel[1:]))
    if turn >= CONTRADICTIONS.least_share and _agree(
        [half["delay"] for half in halves]
    ):
        yield from _both(channel, row, 1, turn, (-delay, delay))

    off = _gain_beyond_noise(gain, row)
    if off >= CONTRADICTIONS.least_share and _agree(
        [_signed_gain(half) - 1.0 for half in halves]
    ):
        yield from _both(channel, row, 0, off, (gain - 1.0, 1.0 / gain - 1.0))


def _both(
    channel: str, row: pd.Series, order: int, size: float, shares: tuple[float, float]
) -> Iterator[Contradiction]:
    """The channel is wrong, or its reference is by the reverse."""
    channels = channel, str(row["reference"])
    for name, other, share in zip(channels, channels[::-1], shares):
        site = Site(f"sensor {name}")
        yield Contradiction(site, order, share, size, str(row["message"]), other)


def _signed_gain(row: pd.Series) -> float:
    return float(row["sign"] * row["gain"])


def _gain_beyond_noise(gain: float, row: pd.Series) -> float:
    """How far a gain is off, zero where noise may have made it so.

    Noise in either channel alone makes a gain seem off by the root of the coherence;
    and a gain is one number, so it does not scatter with frequency.
    """
    scatter = row["scatter"] if np.isfinite(row["scatter"]) else 0.0
    chance = max(-0.5 * np.log(row["coherence"]), scatter)
    if gain > 0 and not abs(np.log(gain)) > chance:
        return 0.0
    return abs(gain - 1.0)


def _agree(values: Sequence[float]) -> bool:
    """Whether no two values have different signs."""
    return not (any(x > 0 for x in values) and any(x < 0 for x in values))


def longest_record(data: SearchData) -> int:
    """The record that has most rows of the search."""

    def n_rows(record: int) -> int:
        return sum(run.stop - run.start for run in data.runs(record))

    return max(data.searched, key=n_rows)


def _halves(runs: Sequence[slice]) -> list[list[slice]]:
    """The first and the second half of some rows, each as runs.

    All of them where they are too few to be halved.
    """
    lengths = [run.stop - run.start for run in runs]
    if sum(lengths) < 2 * CONTRADICTIONS.samples_of_half:
        return [list(runs)]

    first, second = [], []
    remaining = sum(lengths) // 2
    for run, length in zip(runs, lengths):
        cut = run.start + min(max(remaining, 0), length)
        remaining -= length
        if cut > run.start:
            first.append(slice(run.start, cut))
        if cut < run.stop:
            second.append(slice(cut, run.stop))
    return [first, second]


def mean_rate(data: SearchData, dof: int) -> float:
    """Mean circular frequency of the velocity of a DOF, 1/s."""
    change, size = 0.0, 0.0
    for block in data.search:
        segment = data.data.segments[block.segment]
        velocity = segment.v[segment.valid, :dof][block.rows].sum(axis=1)
        acceleration = np.diff(velocity) / (segment.dt or 1.0)
        change += float(acceleration @ acceleration)
        size += float(velocity @ velocity)
    return float(np.sqrt(change / size)) if size > 0 else 1.0
