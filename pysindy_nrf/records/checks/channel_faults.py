"""Faults of single channels: of the sensor, of its range, and of the line to it."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..channels import FILLED, fillers
from ..quality import Kind, QualityNote
from ..record import Record
from .transfer_function import hann

_MOTION = re.compile(r"[avx]\d+")
# Range over largest magnitude up to which a channel is constant.
CONSTANT_RANGE = 1e-12
# Samples in a row at an extreme that are clipped.
CLIPPED_SAMPLES = 5
# Fewer distinct steps over the range than this are coarse, and none of its extremes is
# an end of the range.
MIN_STEPS = 64
# A quantisation step counts from this share of the rms and of the range on.
MIN_STEP_OVER_RMS = 0.02
MIN_STEP_OVER_RANGE = 1 / 1024
# Samples that are used to find it, and how often its values must come back.
MAX_SAMPLES_SORTED = 20_000
MIN_REPEATS = 3
# Samples, and share of the channel, without change that are a lost connection.
MIN_STUCK_SAMPLES = 100
MIN_STUCK_SHARE = 0.02
# Robust standard deviations of the second difference, and standard deviations of the
# channel, by which a spike stands out.
SPIKE = 25.0
LOUD_SPIKE = 4.0
MAX_SPIKES = 20_000
# Samples about a spike that give its local level.
LOCAL_SAMPLES = 101
# A single outlier bends its neighbours the other way by half, within this.
SPIKE_TOLERANCE = 0.25
# Of the largest step, below which three samples lie on a straight channel.
STRAIGHT = 1e-9
# Steps that must be seen, and the share of them at even distances, of a slower clock.
MIN_STEPS_SEEN = 50
SLOWER_CLOCK_SHARE = 0.9
# Frequencies of the mains, Hz, and the seconds of a record that can show them.
MAINS = (50.0, 60.0)
MIN_SECONDS = 4.0
# Lines of the spectrum that belong to one of the mains, and Hz beside that give the
# level of the others.
MAINS_LINES = 2.5
BESIDE_MAINS = 2.0
# Times the power of its surroundings from which on a line is no resonance (30 dB), and
# its share of the rms.
MAINS_OVER_SURROUNDINGS = 1000.0
MIN_HUM = 0.01
# Highest harmonic of a load that is looked for at the frequency of the mains: that of a
# load of 5 or 6 Hz.
MAX_HARMONIC = 10


@dataclass(frozen=True)
class Channel:
    """One channel of a record.

    Attributes
    ----------
    name, record : str
    values : ndarray of shape (n_samples,)
    fs : float
        Hz.
    velocity : ndarray of shape (n_samples,) or None
        Of the same floor, if this is an acceleration.
    blows : ndarray of shape (n_samples,)
        Whether a force jumps at a sample or next to it.
    """

    name: str
    record: str
    values: np.ndarray
    fs: float
    velocity: np.ndarray | None
    blows: np.ndarray

    @cached_property
    def y(self) -> np.ndarray:
        """The finite samples."""
        return self.values[np.isfinite(self.values)]

    @property
    def is_motion(self) -> bool:
        """Whether it is the motion of a DOF; others may rest or be constant."""
        return _MOTION.fullmatch(self.name) is not None

    @property
    def is_force(self) -> bool:
        """Whether it is a force."""
        return self.name[:1] == "F"

    @property
    def is_constant(self) -> bool:
        """Whether it does not change."""
        return self.range <= CONSTANT_RANGE * np.abs(self.y).max()

    @property
    def rests(self) -> bool:
        """Whether the velocity is zero where the acceleration is: a floor that friction
        stops.
        """
        v = self.velocity
        return v is not None and v.shape == self.y.shape and not v[self.y == 0].any()

    @cached_property
    def range(self) -> float:
        """Largest less smallest value."""
        return float(np.ptp(self.y))

    @cached_property
    def resolution(self) -> float:
        """Smallest step between two values that the channel takes repeatedly; 0 if
        there is none.
        """
        every = max(1, len(self.y) // MAX_SAMPLES_SORTED)
        values, counts = np.unique(self.y[::every], return_counts=True)
        if len(values) < 3 or np.median(counts) < MIN_REPEATS:
            return 0.0
        return float(np.median(np.diff(values)))

    def note(self, kind: Kind, share: float, message: str) -> QualityNote:
        """A note on this channel."""
        return QualityNote(
            kind, f"{self.name} {message}", self.name, self.record, share
        )


def fault_notes(record: Record) -> tuple[QualityNote, ...]:
    """Notes on what is wrong with each measured channel of a record by itself."""
    notes: list[QualityNote] = []
    earlier: list[Channel] = []
    columns = record.channels()
    blows = _blows(columns, record.n_samples)
    for name, values in columns.items():
        velocity = columns.get(name.replace("a", "v")) if name[:1] == "a" else None
        values = np.asarray(values, dtype=float)
        channel = Channel(name, record.name, values, record.fs, velocity, blows)
        unforced = channel.is_force and not channel.y.any()
        if unforced or not channel.y.size:
            continue
        notes += _notes_on(channel, earlier)
        earlier.append(channel)
    return tuple(notes)


def _blows(columns: Mapping[str, np.ndarray], n_samples: int) -> np.ndarray:
    """Samples at which a force jumps, and those beside them."""
    blows = np.zeros(n_samples, dtype=bool)
    for name, values in columns.items():
        if name[:1] == "F" and n_samples > 2:
            size = np.abs(_bend(np.nan_to_num(values)))
            blows[1:-1] |= size > SPIKE * np.median(size) / 0.6745 + 1e-300
    return np.convolve(blows, np.ones(3), "same") > 0


def _bend(y: np.ndarray) -> np.ndarray:
    """How far inner samples lie from the mean of their neighbours."""
    return np.asarray(y[1:-1] - 0.5 * (y[2:] + y[:-2]))


def _notes_on(channel: Channel, earlier: list[Channel]) -> list[QualityNote]:
    if channel.is_constant:
        message = (
            f"is constant ({channel.y[0]:.4g}): a dead sensor or a wrong column. Leave"
            " it out (a column of NaN)."
        )
        return [channel.note("dead", 1.0, message)]
    notes = [
        _copied(channel, other)
        for other in earlier
        if np.array_equal(other.y, channel.y)
    ]
    filled, description = fillers(channel.values)
    if description:
        share = len(filled) / len(channel.values)
        notes.append(channel.note("filled", share, f"holds {description}. {FILLED}"))
        return notes
    for check in CHECKS:
        note = check(channel)
        if note is not None:
            notes.append(note)
    return notes


def _copied(channel: Channel, other: Channel) -> QualityNote:
    message = (
        f"{channel.name} is the same as {other.name}, sample by sample: a copied"
        " column. Check the wiring list."
    )
    return QualityNote("copied", message, channel.name, channel.record, 1.0, other.name)


def _runs(flag: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flag.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - edges[::2]


def _stuck(channel: Channel) -> QualityNote | None:
    """A motion sensor that stays constant from somewhere in the record on."""
    y = channel.y
    starts, lengths = _runs(np.diff(y) == 0)
    if not len(lengths) or not channel.is_motion:
        return None
    longest = int(lengths.argmax())
    start = int(starts[longest])
    length = int(lengths[longest]) + 1
    if length < max(MIN_STUCK_SAMPLES, MIN_STUCK_SHARE * len(y)):
        return None
    # several runs at an end of the range are clipping, or coarse steps
    if y[start] in (y.min(), y.max()):
        clipped = _runs(y == y[start])[1] >= CLIPPED_SAMPLES
        if clipped.sum() > 1:
            return None
    at_rest_before_the_test = not start or np.ptp(y[:start]) == 0
    if at_rest_before_the_test:
        return None
    return channel.note(
        "dead",
        length / len(y),
        f"does not change for {length} samples from row {start} on: a lost connection."
        " Cut the record there.",
    )


def _clipped(channel: Channel) -> QualityNote | None:
    """A channel that is cut off at an end of its range."""
    y = channel.y
    if channel.resolution > channel.range / MIN_STEPS:
        return None
    n_samples = 0
    sides = []
    for side, level in (("above", y.max()), ("below", y.min())):
        lengths = _runs(y == level)[1]
        clipped = lengths >= CLIPPED_SAMPLES
        # a signal at rest at its extreme before a test is one run; clipping gives
        # several
        if clipped.sum() >= 2 and level != 0:
            n_samples += int(lengths[clipped].sum())
            sides.append(f"{side} {level:.4g}")
    if not n_samples:
        return None
    return channel.note(
        "clipped",
        n_samples / len(y),
        f"is cut off {' and '.join(sides)} in {n_samples} samples: the range was too"
        " small. Measure again with a larger one, or leave those stretches out.",
    )


def _quantised(channel: Channel) -> QualityNote | None:
    """A channel that moves in coarse steps."""
    step, rms = channel.resolution, float(np.std(channel.y))
    too_small = (
        step < MIN_STEP_OVER_RMS * rms or step < MIN_STEP_OVER_RANGE * channel.range
    )
    if not step or too_small:
        return None
    noise = step / 12**0.5
    return channel.note(
        "quantised",
        1.0,
        f"moves in steps of {step:.3g}, {100 * step / rms:.1f} % of its rms: noise of"
        f" {100 * noise / rms:.1f} %. Use a smaller measuring range.",
    )


def _spiky(channel: Channel) -> QualityNote | None:
    """Single samples far off their neighbours, where no blow explains them."""
    y = channel.y
    if channel.is_force or len(y) < 32:
        return None
    bend = _bend(y)
    size = np.abs(bend)
    hits = np.flatnonzero(size > SPIKE * np.median(size) / 0.6745 + 1e-300)
    hits = hits[:MAX_SPIKES]
    if not len(hits):
        return None
    # against the local level: a hammer blow is no spike
    width = min(LOCAL_SAMPLES, len(size) // 2 * 2 - 1)
    beside = hits[:, None] + np.arange(width) - width // 2
    local = np.median(size[np.clip(beside, 0, len(size) - 1)], axis=1)
    hits = hits[size[hits] > SPIKE * local / 0.6745]
    # friction makes the acceleration jump at a reversal of the velocity, but not beyond
    # the range of the channel
    hits = hits[size[hits] > LOUD_SPIKE * np.std(y)]
    # a smooth peak bends its neighbours with it
    hits = hits[(hits > 0) & (hits < len(size) - 1)]
    neighbours = np.stack([bend[hits - 1], bend[hits + 1]])
    ratios = neighbours / np.where(bend[hits] == 0, 1.0, bend[hits])
    single = hits[(np.abs(ratios + 0.5) < SPIKE_TOLERANCE).all(axis=0)]
    # a blow of a few samples makes the acceleration jump
    rows = np.flatnonzero(np.isfinite(channel.values))[single + 1]
    single = single[~channel.blows[rows]]
    if not len(single):
        return None
    return channel.note(
        "spikes",
        len(single) / len(y),
        f"has {len(single)} single samples far off, the first in row {single[0] + 1}:"
        " spikes of the line. Replace them by their neighbours' mean.",
    )


def _interpolated(channel: Channel) -> QualityNote | None:
    """Samples that were made up between those of a slower clock."""
    for order, description in ((1, "is the same"), (2, "lies on a straight line")):
        change = np.abs(np.diff(channel.y, order))
        steps = np.diff(np.flatnonzero(change > STRAIGHT * change.max()))
        if len(steps) <= MIN_STEPS_SEEN:
            continue
        every = int(np.median(steps))
        if every > 1 and (steps % every == 0).mean() > SLOWER_CLOCK_SHARE:
            return channel.note(
                "interpolated",
                1 - 1 / every,
                f"{description} between every {every}th sample: it comes from a slower"
                " logger, and is late or low but for slow frequencies. Resample the"
                " others to its clock.",
            )
    return None


def _dropouts(channel: Channel) -> QualityNote | None:
    """Zeros between large samples."""
    y = channel.y
    starts, lengths = _runs(y == 0)
    # a hammer's blows are shorter than the rests
    between = np.median(_runs(y != 0)[1])
    inside = (lengths > 1) & (lengths < between)
    inside &= (starts > 0) & (starts + lengths < len(y))
    starts, lengths = starts[inside], lengths[inside]
    large = 0.5 * np.sqrt(np.mean(y[y != 0] ** 2))
    before, after = np.abs(y[starts - 1]), np.abs(y[starts + lengths])
    lost = (before > large) | (after > large)
    # a load that is released or set on falls to zero once
    if lost.sum() < 2 or channel.rests:
        return None
    n_samples = int(lengths[lost].sum())
    return channel.note(
        "dropouts",
        n_samples / len(y),
        f"drops to zero {lost.sum()} times in the midst of large values, for"
        f" {n_samples} samples: a loose contact. Cut the record there.",
    )


def _hum(channel: Channel) -> QualityNote | None:
    """A line at the frequency of the mains."""
    n_samples, fs = len(channel.y), channel.fs
    if n_samples < MIN_SECONDS * fs:
        return None
    visible = [mains for mains in MAINS if 1.1 * mains <= fs / 2]
    if not visible:
        return None
    power = np.abs(np.fft.rfft(channel.y * hann(n_samples))) ** 2
    for mains in visible:
        hum = _power_of_line(power, mains, n_samples / fs)
        share = float(np.sqrt(hum / power.sum()))
        if share > MIN_HUM and not _is_harmonic(power, mains, n_samples / fs):
            return channel.note(
                "hum",
                share,
                f"holds a line at {mains:g} Hz, {100 * share:.2g} % of it: hum of the"
                " mains. Ground it, or give a band (band=) without it.",
            )
    return None


def _power_of_line(power: np.ndarray, frequency: float, seconds: float) -> float:
    """Power of a line of a spectrum; zero where it does not stand out."""
    f = np.arange(len(power)) / seconds
    lines_off = (f - frequency) * seconds
    in_line = np.abs(lines_off) < MAINS_LINES
    beside = np.abs(f - frequency) < BESIDE_MAINS
    below = np.median(power[beside & (lines_off < -MAINS_LINES)])
    above = np.median(power[beside & (lines_off > MAINS_LINES)])
    surroundings = max(below, above) * in_line.sum()
    of_line = float(power[in_line].sum())
    return of_line if of_line > MAINS_OVER_SURROUNDINGS * surroundings else 0.0


def _is_harmonic(power: np.ndarray, mains: float, seconds: float) -> bool:
    """Whether a line is a multiple of another one: of the load, or of its response."""
    for harmonic in range(2, MAX_HARMONIC + 1):
        of_load = _power_of_line(power, mains / harmonic, seconds)
        if of_load > MIN_HUM**2 * power.sum():
            return True
    return False


CHECKS: tuple[Callable[[Channel], QualityNote | None], ...] = (
    _stuck,
    _clipped,
    _quantised,
    _spiky,
    _interpolated,
    _dropouts,
    _hum,
)
