"""Channels that were sampled on their own clocks, on one clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...exceptions import ChannelError
from ..quality import QualityNote
from .table import Clock

# Samples by which two clocks may differ over a record and still be one: a phase of
# 0.003 rad at half the sampling rate.
SAME_SAMPLE = 1e-3
# Half width of the interpolating sinc in zero crossings, and the shape of its Kaiser
# window. By Kaiser's formula, 80 dB are reached 0.08 of the cutoff away from it.
ZERO_CROSSINGS = 32
KAISER_SHAPE = 8.0
# Share of half the lower rate at which a channel that is slowed down is cut off, so
# that what lies above that half is 80 dB down.
CUTOFF = 0.92
# Rates that differ by less are interpolated without a lower cutoff.
SAME_RATE = 0.01
# Share of the cutoff up to which the interpolation leaves a channel as it is.
FLAT_BELOW = 0.92
BLOCK = 4096  # samples that are interpolated at once; 2 MB for each
# Share of the shortest channel that must be common to all.
LEAST_OVERLAP = 0.5


@dataclass(frozen=True)
class OneClock:
    """Channels on one clock.

    Parameters
    ----------
    lines : dict of str to ndarray of shape (n_samples,)
    clock : Clock
    notes : tuple of QualityNote
        Shifts, changes of rate, and what all channels have in common.
    """

    lines: dict[str, np.ndarray]
    clock: Clock
    notes: tuple[QualityNote, ...] = ()


def on_one_clock(
    lines: Mapping[str, np.ndarray], clocks: Mapping[str, Clock], record: str
) -> OneClock:
    """Bring channels to the clock of the slowest of them.

    Parameters
    ----------
    lines : mapping of str to ndarray
        By channel; lengths may differ.
    clocks : mapping of str to Clock
        Of each channel; starts on one scale of time.
    record : str
        Name of the record, for notes and messages.

    Returns
    -------
    OneClock
        The time that all channels cover. A channel that lies a whole number of samples
        compared with the others is cut; others are interpolated with a band limit.

    Raises
    ------
    ChannelError
        If the channels have too little time in common.
    """
    reference = min(lines, key=lambda channel: clocks[channel].fs)
    clock = clocks[reference]
    first, last = _overlap(lines, clocks, reference, record)
    grid = np.arange(first, last + 1)  # samples of the reference

    out: dict[str, np.ndarray] = {}
    notes: list[QualityNote] = []
    for channel, line in lines.items():
        of_channel = clocks[channel]
        shift = (clock.start - of_channel.start) * of_channel.fs
        position = shift + grid * (of_channel.fs / clock.fs)
        if _is_whole(position):
            start = round(position[0])
            out[channel] = line[start : start + len(grid)]
        else:
            out[channel] = _interpolated_inside_edges(
                line, position, of_channel.fs / clock.fs, f"{channel} of {record!r}"
            )
        notes += _notes_on_channel(channel, of_channel, reference, clock, record)

    notes += _note_on_overlap(lines, clocks, len(grid) / clock.fs, record)
    start = clock.start + first / clock.fs
    return OneClock(out, Clock(clock.fs, start), tuple(notes))


def _overlap(
    lines: Mapping[str, np.ndarray],
    clocks: Mapping[str, Clock],
    reference: str,
    record: str,
) -> tuple[int, int]:
    """First and last sample of the reference at which all channels are measured."""
    clock = clocks[reference]
    ends = {channel: clocks[channel].end(len(lines[channel])) for channel in lines}
    latest = max(lines, key=lambda channel: clocks[channel].start)
    earliest = min(lines, key=lambda channel: ends[channel])

    start = (clocks[latest].start - clock.start) * clock.fs
    end = (ends[earliest] - clock.start) * clock.fs
    first = int(np.ceil(start - SAME_SAMPLE))
    last = int(np.floor(end + SAME_SAMPLE))

    spans = [ends[channel] - clocks[channel].start for channel in lines]
    if last - first < max(1, LEAST_OVERLAP * min(spans) * clock.fs):
        raise ChannelError(
            f"Record {record!r}: {latest} starts at {clocks[latest].start:g} s and"
            f" {earliest} ends at {ends[earliest]:g} s: they have less than half of the"
            " test in common",
            "Check the start times of the files, and the units of their times; or leave"
            " the times out (t = 'none') and give fs if they started together.",
        )
    return first, last


def _is_whole(position: np.ndarray) -> bool:
    """Whether positions are those of samples, one after the other."""
    beside = np.abs(position[[0, -1]] - np.round(position[[0, -1]])).max()
    is_next = round(position[-1]) - round(position[0]) == len(position) - 1
    return bool(beside <= SAME_SAMPLE and is_next)


def _interpolated_inside_edges(
    line: np.ndarray, position: np.ndarray, ratio: float, title: str
) -> np.ndarray:
    """A channel between its samples; empty where its edges are."""
    measured = np.flatnonzero(np.isfinite(line))
    if not measured.size:
        return np.full(len(position), np.nan)

    first, last = measured[0], measured[-1]
    inside = line[first : last + 1].astype(float)
    if len(measured) != len(inside):
        raise ChannelError(
            f"Channel {title} has empty cells inside, and a clock of its own",
            "Fill them, or cut the record there.",
        )
    cutoff = 1.0 if ratio <= 1 + SAME_RATE else CUTOFF / ratio
    values = interpolated(inside, position - first, cutoff)
    outside = (position < first - SAME_SAMPLE) | (position > last + SAME_SAMPLE)
    values[outside] = np.nan
    return values


def interpolated(
    line: np.ndarray, position: np.ndarray, cutoff: float = 1.0
) -> np.ndarray:
    """Values between the samples of a line, by a windowed sinc.

    Parameters
    ----------
    line : ndarray of shape (n_samples,)
    position : ndarray of shape (n_positions,)
        In samples from the first.
    cutoff : float
        Where the band ends, as a share of half the sampling rate.

    Returns
    -------
    ndarray of shape (n_positions,)

    References
    ----------
    J. O. Smith, "Digital audio resampling", Stanford, 1984.
    """
    half = int(np.ceil(ZERO_CROSSINGS / cutoff))
    half = min(half, len(line) - 1)
    padded = np.pad(line, half, mode="reflect", reflect_type="odd")
    taps = np.arange(1 - half, half + 1)

    out = np.empty(len(position))
    for start in range(0, len(position), BLOCK):
        block = position[start : start + BLOCK]
        nearest = np.floor(block).astype(int)
        nearest = np.clip(nearest, 0, len(line) - 1)
        away = block[:, None] - nearest[:, None] - taps
        inside = np.clip(1 - (away / half) ** 2, 0, None)
        weights = np.sinc(cutoff * away) * np.i0(KAISER_SHAPE * np.sqrt(inside))
        weights[inside == 0] = 0.0
        weights /= weights.sum(axis=1, keepdims=True)
        samples = padded[nearest[:, None] + taps + half]
        out[start : start + BLOCK] = (samples * weights).sum(axis=1)
    return out


def _notes_on_channel(
    channel: str, of_channel: Clock, reference: str, clock: Clock, record: str
) -> list[QualityNote]:
    """How the clock of a channel differs from that of the reference."""
    notes = []
    shift = of_channel.start - clock.start
    samples = shift * clock.fs
    if abs(samples) > SAME_SAMPLE:
        side = "after" if shift > 0 else "before"
        message = (
            f"{channel} starts {1e3 * abs(shift):.4g} ms ({abs(samples):.4g} steps)"
            f" {side} {reference}: moved to its clock"
        )
        notes.append(QualityNote("shifted", message, channel, record, shift, reference))
    if abs(of_channel.fs / clock.fs - 1) > 1e-9:
        limit = 0.5 * clock.fs * CUTOFF * FLAT_BELOW
        message = (
            f"{channel} was sampled at {of_channel.fs:.9g} Hz, {reference} at"
            f" {clock.fs:.9g} Hz: resampled, as measured below {limit:.3g} Hz"
        )
        ratio = of_channel.fs / clock.fs
        notes.append(
            QualityNote("resampled", message, channel, record, ratio, reference)
        )
    return notes


def _note_on_overlap(
    lines: Mapping[str, np.ndarray],
    clocks: Mapping[str, Clock],
    common: float,
    record: str,
) -> list[QualityNote]:
    """The time that all channels cover, where that is less than one of them covers."""
    longest = max(len(line) / clocks[channel].fs for channel, line in lines.items())
    fastest = max(clock.fs for clock in clocks.values())
    if longest - common < 0.5 / fastest:
        return []
    message = f"all channels cover {common:.5g} s of {longest:.5g} s; the rest is cut"
    return [QualityNote("overlap", message, "", record, common)]
