"""Channels of one DOF that contradict each other, and sizes that no structure has."""

import re
from collections.abc import Sequence

import numpy as np

from ...exceptions import ChannelError
from ..files.mapping.column_facts import SLOW
from ..quality import QualityNote
from ..record import Record
from .alignment import ChannelComparison, compare_channels
from .transfer_function import ORDERS

# Largest velocity, displacement and force of a structure; more suggests a wrong unit.
LARGEST = {"v": 50.0, "x": 10.0, "F": 1e9}
UNITS = {"a": "m/s^2", "v": "m/s", "x": "m", "F": "N"}
# Acceleration, m/s^2, and displacement, m, that it implies at its strongest frequency;
# both are exceeded only in a wrong unit.
BRISK_ACCELERATION = 500.0
WIDE_DISPLACEMENT = 0.3

# Ratios of two channels of one motion that indicate a unit.
UNIT_RATIOS = {
    9.80665: "g",
    1e3: "mm",
    1e2: "cm",
    1e6: "µm",
    39.3701: "inches",
    3.28084: "feet",
    100 / 9.80665: "gal",
}
ACCELERATION_UNITS = ("g", "gal")
# Units of the time by the true time over the time read.
CLOCK_RATIOS = {1e-3: "ms", 1e-6: "µs"}
# Relative distance within which such a ratio is recognised.
SAME_RATIO = 0.12

# A gain is reported if it differs from 1 by two standard errors and by a least amount,
# or by a large amount whatever its scatter; a delay, from half a sample on.
STANDARD_ERRORS = 2.0
MIN_GAIN_ERROR = 0.02
LARGE_GAIN_ERROR = 0.2
MIN_DELAY_SAMPLES = 0.5
# Change of a gain between the halves of a record that is a drift: 0.02 at most in 130
# clean channels, 0.1 where a gain drifts by 20 %.
MIN_GAIN_DRIFT = 0.05


def unit_notes(record: Record) -> tuple[QualityNote, ...]:
    """Notes on channels whose size suggests a wrong unit."""
    if record.rotates:
        return ()  # an angle, or its rate, has no usual size
    notes = []
    for name, values in record.channels().items():
        base = name in ("ag", "vg", "xg")
        kind = name[0] if base or name[1:].isdigit() else ""
        if kind not in UNITS:
            continue
        peak = float(np.nanmax(np.abs(values)))
        if kind == "a":
            large = peak > BRISK_ACCELERATION and (
                peak > WIDE_DISPLACEMENT * _strongest_frequency(values, record.fs) ** 2
            )
        else:
            large = peak > LARGEST[kind]
        if large:
            message = f"{name} reaches {peak:.3g} {UNITS[kind]}: is its unit declared?"
            notes.append(QualityNote("unit", message, name, record.name, peak))
    return tuple(notes)


def contradiction_notes(record: Record) -> tuple[QualityNote, ...]:
    """Notes on channels of one DOF that contradict each other."""
    try:
        comparisons = compare_channels(record)
    except ChannelError:
        # the motion of the base is not known
        return ()
    clock, several = _wrong_clock(comparisons)
    questions = [_unit_question(comparison) for comparison in comparisons]
    # no unit of a channel explains as much
    if clock and (several or not all(questions)):
        message = (
            f"the motions contradict each other as if the time were in {clock}:"
            f" {_clock_question(clock)}"
        )
        return (QualityNote("clock", message, "t", record.name, _clock_ratio(clock)),)

    notes: list[QualityNote] = []
    for comparison, question in zip(comparisons, questions):
        if question and clock:
            question += f"; or is the time in {clock}? {_clock_question(clock)}"
        notes += _notes_on(comparison, question, record.name)
    return tuple(notes or _gain_drift_notes(record, comparisons))


def slow_clock_note(record: Record) -> QualityNote | None:
    """A note if accelerations are sampled more slowly than structures move."""
    accelerations = [c for c in record.channels() if re.fullmatch(r"a\d+", c)]
    if not accelerations or not record.fs < SLOW:
        return None
    message = f"accelerations at {record.fs:.3g} Hz: {_clock_question('ms')}"
    return QualityNote("clock", message, "t", record.name, _clock_ratio("ms"))


def _notes_on(
    comparison: ChannelComparison, unit_question: str, record: str
) -> list[QualityNote]:
    """Notes on what is wrong with one channel; empty for what noise does."""
    if comparison.aligned:
        return []
    channel, reference = comparison.channel, comparison.reference
    gain = comparison.transfer.gain
    if unit_question:
        message = (
            f"{channel} is {gain:.2g} times as large as {reference} says:"
            f" {unit_question}"
        )
        return [QualityNote("unit", message, channel, record, gain, reference)]

    corner = _corner_notes(comparison, record)
    clear = {"delay": _is_late(comparison), "gain": _gain_is_clear(comparison)}
    if _is_certain(comparison):
        return corner + [
            QualityNote(kind, comparison.message, channel, record, size, reference)
            for kind, size in comparison.faults.items()
            if clear.get(kind, kind != "corner")
        ]
    if clear["gain"]:
        message = (
            f"{channel} is {gain:.3g} times as large as {reference} says: is the"
            " calibration of one of them wrong?"
        )
        return [
            *corner,
            QualityNote("gain", message, channel, record, gain, reference),
        ]
    return corner


def _corner_notes(comparison: ChannelComparison, record: str) -> list[QualityNote]:
    """A note on the channel that has passed a high-pass filter, if one has."""
    if "corner" not in comparison.faults:
        return []
    channel, witness = comparison.filtered_channel, comparison.channel
    if channel == witness:
        witness = comparison.reference
    message = f"{comparison.corner_message}. "
    if channel[0] == "a":
        message += "The acceleration before it is used"
    else:
        message += "What it took away is lost: couple the sensor to DC"
    size = comparison.transfer.corner
    return [QualityNote("corner", message, channel, record, size, witness)]


def _is_certain(comparison: ChannelComparison) -> bool:
    """Whether a contradiction stands whatever the scatter of the gain."""
    fit = comparison.transfer
    large = abs(fit.gain - 1) > LARGE_GAIN_ERROR
    return large or fit.sign < 0 or _is_late(comparison) or not np.isfinite(fit.gain)


def _is_late(comparison: ChannelComparison) -> bool:
    return abs(comparison.samples) > MIN_DELAY_SAMPLES


def _gain_is_clear(comparison: ChannelComparison) -> bool:
    """Whether a gain differs from one by a large amount, or by more than its scatter
    explains.
    """
    gain, scatter = comparison.transfer.gain, comparison.transfer.scatter
    explained = max(MIN_GAIN_ERROR, STANDARD_ERRORS * scatter)
    return abs(gain - 1) > LARGE_GAIN_ERROR or abs(np.log(gain)) > explained


def _gain_drift_notes(
    record: Record, comparisons: Sequence[ChannelComparison]
) -> list[QualityNote]:
    """Notes on channels whose gain against their reference differs between the halves
    of the record.
    """
    middle = record.n_samples // 2
    first = compare_channels(record, runs=[slice(0, middle)])
    last = compare_channels(record, runs=[slice(middle, record.n_samples)])
    notes = []
    for comparison, before, after in zip(comparisons, first, last, strict=True):
        change = np.log(after.transfer.gain / before.transfer.gain)
        error = np.hypot(before.transfer.scatter, after.transfer.scatter)
        if abs(change) > max(MIN_GAIN_DRIFT, STANDARD_ERRORS * error):
            channel, reference = comparison.channel, comparison.reference
            message = (
                f"the gain of {channel} or {reference} drifts: their ratio changes by"
                f" {200 * change:+.2g} % over the record. Check its amplifier."
            )
            notes.append(
                QualityNote(
                    "gain_drift", message, channel, record.name, 2 * change, reference
                )
            )
    return notes


def _wrong_clock(comparisons: Sequence[ChannelComparison]) -> tuple[str, bool]:
    """Unit of the time that would explain all gains, and whether two orders of
    derivatives agree on it.
    """
    if not comparisons:
        return "", False
    gains = np.array([comparison.transfer.gain for comparison in comparisons])
    orders = np.array(
        [ORDERS[c.reference[0]] - ORDERS[c.channel[0]] for c in comparisons]
    )
    if not np.isfinite(gains).all():
        return "", False
    with np.errstate(divide="ignore"):
        times = gains ** (1.0 / orders)
    for ratio, unit in CLOCK_RATIOS.items():
        if (np.abs(times / ratio - 1) < SAME_RATIO).all():
            return unit, len(set(orders)) > 1
    return "", False


def _clock_question(unit: str) -> str:
    return (
        f"is the unit of the time declared? (units={{'t': '{unit}'}}, --unit t={unit})"
    )


def _clock_ratio(unit: str) -> float:
    return next(ratio for ratio, name in CLOCK_RATIOS.items() if name == unit)


def _unit_question(comparison: ChannelComparison) -> str:
    """Question on the unit of one of two channels; empty if their ratio is that of no
    unit.
    """
    channel, reference = comparison.channel, comparison.reference
    for ratio, unit in UNIT_RATIOS.items():
        of_acceleration = unit in ACCELERATION_UNITS
        if abs(comparison.transfer.gain / ratio - 1) < SAME_RATIO:
            # the channel reads too much, or the reference too little
            suspect = reference if of_acceleration else channel
        elif abs(comparison.transfer.gain * ratio - 1) < SAME_RATIO:
            suspect = channel if of_acceleration and channel[0] == "a" else reference
        else:
            continue
        other = channel if suspect == reference else reference
        return f"is {suspect} in {unit}? (or {other} in another unit)"
    return ""


def _strongest_frequency(values: np.ndarray, fs: float) -> float:
    """Circular frequency of the largest spectral line, 1/s."""
    y = values[np.isfinite(values)]
    lines = np.abs(np.fft.rfft(y - y.mean()))[1:]
    return float(2 * np.pi * fs / len(y) * (1 + int(np.argmax(lines))))
