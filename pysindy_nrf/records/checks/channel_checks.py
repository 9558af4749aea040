"""Channels of one record: faults of sensors and of the line, wrong units, signs and
clocks; a summary for pages.
"""

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from ...exceptions import DataQualityWarning, NRFError
from ..channels import FILLED, fillers
from ..files.reading import SLOW
from ..files.summary import kind_of, summary
from ..record import Record
from .alignment import channel_alignment, hann

_MOTION = re.compile(r"[avx]\d+")
CLIPPED = 5  # samples in a row at an extreme
SPIKE = 25.0  # robust standard deviations of the second difference
LOUD = 4.0  # standard deviations of the channel by which a spike stands out
# samples used to find the quantisation step, and largest number of spike candidates
ENOUGH = 20_000
LEVELS = 64  # fewer distinct steps over the range than this are coarse

# Motions or forces above these sizes suggest a wrong unit.
_LARGE = {
    "a": (np.inf, "m/s^2"),
    "v": (50.0, "m/s"),
    "x": (10.0, "m"),
    "F": (1e9, "N"),
}  # of a see _BRISK
# Ratios of two channels of one motion that indicate a unit.
_RATIOS = {
    9.80665: "g",
    1e3: "mm",
    1e2: "cm",
    1e6: "µm",
    39.3701: "inches",
    3.28084: "feet",
    100 / 9.80665: "gal",
}
# Acceleration (m/s^2) and the displacement (m) it implies at its strongest frequency,
# both exceeded for a wrong unit.
_BRISK, _WIDE = 500.0, 0.3
# A gain is reported if it differs from 1 by _SURE times its scatter and by _LEAST, or
# by _FAR whatever the scatter.
_SURE, _LEAST, _FAR = 2.0, 0.02, 0.2
# between halves of a record; 0.02 at most in 130 clean channels, 0.1 where a gain
# drifts by 20 %
_STEADY = 0.05
_NEAR = 0.12  # relative distance within which a ratio is recognised
# Rows of arrays that are looked at; squared steps over variance of a drift from fewer
# than six rows a cycle on (rows in no order: 2); steps this many times as large as
# those beside, and half as many times the rms, join two stretches.
_LEAST_ROWS, _MOST_ROWS, _ROUGH, _JUMP = 256, 4096, 1.0, 8.0
# gain between channels of arrays that is called wrong; noise of 10 % on each gave 2.01
# at most
_GROSS = 3.0
_ROUND_OFF = 1e-6  # of a standard deviation
_CLOCKS = {1e-3: "ms", 1e-6: "µs"}  # ratios of the true time to the time read

Finding = tuple[
    str, str, float, str
]  # channel, problem, share and message as in the table


def check_channels(record: Record, warn: bool = False) -> pd.DataFrame:
    """Table of what is wrong with the measured channels of a record."""
    rows: list[Finding] = []
    seen: dict[str, np.ndarray] = {}
    for name, values in record.channels().items():
        y = np.asarray(values, dtype=float)
        filled, what = fillers(y)
        y = y[np.isfinite(y)]
        if not len(y) or (name[:1] == "F" and not y.any()):
            continue
        if np.ptp(y) <= 1e-12 * np.abs(y).max():
            text = (
                f"{name} is constant ({y[0]:.4g}): a dead sensor or a wrong column."
                " Leave it out (a column of NaN)."
            )
            rows.append((name, "dead", 1.0, text))
            continue
        for other, z in seen.items():
            if np.array_equal(z, y):
                text = (
                    f"{name} is the same as {other}, sample by sample: a copied column."
                    " Check the wiring list."
                )
                rows.append((name, "copied", 1.0, text))
        seen[name] = y
        if what:
            rows.append(
                (
                    name,
                    "filled",
                    len(filled) / len(values),
                    f"{name} holds {what}. {FILLED}",
                )
            )
            continue
        for problem, check in (*_CHECKS, ("hum", partial(_hum, fs=record.fs))):
            if (found := check(name, y)) and not (
                problem == "dropouts" and _stands(name, y, record.channels())
            ):
                rows.append((name, problem, *found))
    table = pd.DataFrame(rows, columns=["channel", "problem", "share", "message"])
    if warn and len(table):
        warnings.warn(
            f"Record {record.name!r}: " + " ".join(table["message"]),
            DataQualityWarning,
            stacklevel=2,
        )
    return table


def _runs(flag: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flag.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - edges[::2]


def _clipped(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share of samples cut off at an extreme of the range, and the message."""
    if _resolution(y) > np.ptp(y) / LEVELS:
        return None
    total, sides = 0, []
    for side, level in (("above", y.max()), ("below", y.min())):
        lengths = _runs(y == level)[1]
        long = lengths >= CLIPPED
        # a signal at standstill at its extreme before a test is one run; clipping gives
        # several
        if long.sum() >= 2 and level != 0:
            total += int(lengths[long].sum())
            sides.append(f"{side} {level:.4g}")
    if not total:
        return None
    return (
        total / len(y),
        (
            f"{name} is cut off {' and '.join(sides)} in {total} samples: the range was"
            " too small. Measure again with a larger one, or leave those stretches"
            " out."
        ),
    )


def _stuck(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share of samples after which a motion sensor stays constant during the record,
    and the message.
    """
    starts, lengths = _runs(np.diff(y) == 0)
    if not len(lengths) or not _MOTION.fullmatch(
        name
    ):  # forces, the base and covariates may be constant
        return None
    longest = int(lengths.argmax())
    start, length = int(starts[longest]), int(lengths[longest]) + 1
    at_end = y[start] in (
        y.min(),
        y.max(),
    )  # of the range; there several runs are clipping or coarse steps
    if (
        length < max(100, 0.02 * len(y))
        or at_end
        and (_runs(y == y[start])[1] >= CLIPPED).sum() > 1
    ):
        return None
    if not start or np.ptp(y[:start]) == 0:  # at standstill before the test begins
        return None
    text = (
        f"{name} does not change for {length} samples from row {start} on: a lost"
        " connection. Cut the record there."
    )
    return length / len(y), text


def _resolution(y: np.ndarray) -> float:
    """Smallest step between two values that the channel takes repeatedly; 0 if there is
    none.
    """
    values, counts = np.unique(y[:: max(1, len(y) // ENOUGH)], return_counts=True)
    return (
        0.0
        if len(values) < 3 or np.median(counts) < 3
        else float(np.median(np.diff(values)))
    )


def _quantised(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share (1) of a coarsely quantised channel, and the message."""
    step, rms = _resolution(y), float(np.std(y))
    if not step or step < 0.02 * rms or step < np.ptp(y) / 1024:
        return None
    return (
        1.0,
        (
            f"{name} moves in steps of {step:.3g}, {100 * step / rms:.1f} % of its rms:"
            f" noise of {100 * step / 12**0.5 / rms:.1f} %. Use a smaller measuring"
            " range."
        ),
    )


def _spiky(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share of single outlying samples, and the message."""
    if name[:1] == "F" or len(y) < 32:
        return None
    signed = y[1:-1] - 0.5 * (y[2:] + y[:-2])
    bend = np.abs(signed)
    floor = np.median(bend) / 0.6745
    hits = np.flatnonzero(bend > SPIKE * floor + 1e-300)[:ENOUGH]
    if not len(hits):
        return None
    # relative to the local level, so that a hammer blow is not taken for a spike
    width = min(101, len(bend) // 2 * 2 - 1)
    at = np.clip(hits[:, None] + np.arange(width) - width // 2, 0, len(bend) - 1)
    hits = hits[bend[hits] > SPIKE * np.median(bend[at], axis=1) / 0.6745]
    # friction makes the acceleration jump at a velocity reversal, but not beyond the
    # range of the channel
    hits = hits[bend[hits] > LOUD * np.std(y)]
    # a single outlier bends its neighbours the other way by half; a smooth peak does
    # not
    hits = hits[(hits > 0) & (hits < len(bend) - 1)]
    beside = np.stack([signed[hits - 1], signed[hits + 1]]) / np.where(
        signed[hits] == 0, 1.0, signed[hits]
    )
    single = hits[(np.abs(beside + 0.5) < 0.25).all(axis=0)]
    if not len(single):
        return None
    return (
        len(single) / len(y),
        (
            f"{name} has {len(single)} single samples far off, the first in row"
            f" {single[0] + 1}: spikes of the line. Replace them by their neighbours'"
            " mean."
        ),
    )


def _interpolated(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share of samples that were made up between those of a slower clock, and the
    message.
    """
    for order, words in ((1, "is the same"), (2, "lies on a straight line")):
        change = np.abs(np.diff(y, order))
        steps = np.diff(np.flatnonzero(change > _STRAIGHT * change.max()))
        every = int(np.median(steps)) if len(steps) > 50 else 1
        if every > 1 and (steps % every == 0).mean() > 0.9:
            return (
                1 - 1 / every,
                (
                    f"{name} {words} between every {every}th sample: it comes from a"
                    " slower logger, and is late or low but for slow frequencies."
                    " Resample the others to its clock."
                ),
            )
    return None


def _dropouts(name: str, y: np.ndarray) -> tuple[float, str] | None:
    """Share of samples that are zero between large ones, and the message."""
    starts, lengths = _runs(y == 0)
    between = np.median(_runs(y != 0)[1])  # a hammer's blows are shorter than the rests
    inside = (
        (lengths > 1) & (lengths < between) & (starts > 0) & (starts + lengths < len(y))
    )
    starts, lengths = starts[inside], lengths[inside]
    size = 0.5 * np.sqrt(np.mean(y[y != 0] ** 2))
    lost = (np.abs(y[starts - 1]) > size) | (np.abs(y[starts + lengths]) > size)
    if lost.sum() < 2:  # a load that is released or set on falls to zero once
        return None
    n = int(lengths[lost].sum())
    return (
        n / len(y),
        (
            f"{name} drops to zero {lost.sum()} times in the midst of large values, for"
            f" {n} samples: a loose contact. Cut the record there."
        ),
    )


def _stands(name: str, y: np.ndarray, channels: Mapping[str, np.ndarray]) -> bool:
    """Whether the velocity is zero where the acceleration is: a floor that friction
    holds.
    """
    v = channels.get(name.replace("a", "v"))
    return (
        name.startswith("a")
        and v is not None
        and v.shape == y.shape
        and not v[y == 0].any()
    )


def _hum(name: str, y: np.ndarray, fs: float) -> tuple[float, str] | None:
    """Share of a line at the frequency of the mains, and the message."""
    known = [
        mains for mains in (50.0, 60.0) if mains * 1.1 <= fs / 2 and len(y) >= 4 * fs
    ]
    power = np.abs(np.fft.rfft(y * hann(len(y)))) ** 2 if known else np.zeros(0)
    f = np.arange(len(power)) * fs / len(y)
    for mains in known:
        off = (f - mains) * len(y) / fs  # lines away from it
        near = np.abs(off) < 2.5
        sides = [(off * side > 2.5) & (np.abs(f - mains) < 2.0) for side in (-1, 1)]
        floor = max(np.median(power[one]) for one in sides) * near.sum()
        share = np.sqrt(power[near].sum() / power.sum())
        if power[near].sum() > _LINE * floor and share > 0.01:
            return (
                share,
                (
                    f"{name} holds a line at {mains:g} Hz, {100 * share:.2g} % of it:"
                    " hum of the mains. Ground it, or give a band (band=) without it."
                ),
            )
    return None


_STRAIGHT = (
    1e-9  # of the largest step, below which three samples lie on a straight line
)
# times the power of its surroundings, from which on a line is no resonance (30 dB
# within 2 Hz)
_LINE = 1000.0
_CHECKS = (
    ("dead", _stuck),
    ("clipped", _clipped),
    ("quantised", _quantised),
    ("spiky", _spiky),
    ("interpolated", _interpolated),
    ("dropouts", _dropouts),
)


def data_warnings(record: Record) -> list[str]:
    """Messages on units, clocks, signs, delays and channels of a record that are
    probably wrong.
    """
    out = _large(record) + _contradictions(record)
    if (
        not out
        and record.fs < SLOW
        and any(re.fullmatch(r"a\d+", name) for name in record.channels())
    ):
        out = [f"accelerations at {record.fs:.3g} Hz: {_declared('ms')}"]
    return out + list(check_channels(record)["message"])


def motion_doubts(
    a: np.ndarray, v: np.ndarray, s: np.ndarray, ag: Any, dt: float | None
) -> list[str]:
    """Messages on accelerations of DOFs, rates and drifts of storeys that are not
    derivatives of each other.
    """
    some = slice(None, None, max(1, len(s) // _MOST_ROWS))
    lines = (line for y in (a, v, s) for line in y.T)
    if all(
        abs(line[some].std() - 1.0) < 0.5 and abs(line.std() - 1.0) < _ROUND_OFF
        for line in lines
    ):
        return [
            "every column of X has a standard deviation of one, as behind a"
            " StandardScaler: without their units they are no motion. Pass X as"
            " measured"
        ]
    if dt is None or len(s) < _LEAST_ROWS:
        return []
    rows = _largest_drift(s)
    if _integrates(s[rows], v[rows], dt) and _integrates(
        v[rows], _relative(a, ag, rows), dt
    ):
        return []
    rows = _smooth_stretch(s, v, rows)
    if rows.stop - rows.start < _LEAST_ROWS:
        return []
    relative = _relative(a, ag, rows)
    storeys = Record(
        acceleration=relative, velocity=v[rows], displacement=s[rows], fs=1.0 / dt
    )
    table = channel_alignment(storeys)
    gain, delay = np.abs(np.log(table["gain"].astype(float))), table["samples"].abs()
    turned = (table["sign"] < 0) & (delay < 0.5)
    wrong = (
        (gain > np.log(_GROSS))
        | turned
        | (gain.notna() & table["message"].str.contains("does not follow"))
    )
    if (
        not wrong.any()
    ):  # small gains, delays and lost coherence are what noise on every channel does
        return []
    return [re.sub(r"\bx(\d)", r"s\1", text) for text in _contradictions(storeys)]


def _relative(a: np.ndarray, ag: Any, rows: slice) -> np.ndarray:
    """Accelerations of the floors against those below."""
    return np.diff(a[rows], axis=1, prepend=0.0 if ag is None else ag[rows, None])


def _largest_drift(s: np.ndarray) -> slice:
    """Rows about the largest drift of storey 1."""
    step = max(1, len(s) // _MOST_ROWS)
    start = max(
        min(
            step * int(np.abs(s[::step, 0]).argmax()) - _MOST_ROWS // 2,
            len(s) - _MOST_ROWS,
        ),
        0,
    )
    return slice(start, min(start + _MOST_ROWS, len(s)))


def _integrates(y: np.ndarray, rate: np.ndarray, dt: float) -> bool:
    """Whether all columns move as their rates say, over steps of about one radian of
    their motion.
    """
    lag = int(
        np.median(y.std(axis=0))
        / max(np.median(np.diff(y, axis=0).std(axis=0)), 1e-300)
    )
    if not 1 < lag < len(y) // 4:
        return False
    path = np.cumsum(rate, axis=0)
    moved, said = y[lag:] - y[:-lag], dt * (path[lag:] - path[:-lag])
    size, other, along = (
        (one * two).sum(axis=0)
        for one, two in ((moved, moved), (said, said), (moved, said))
    )
    return bool(
        np.all(
            (along > 0.9 * np.sqrt(size * other))
            & (size < 4 * other)
            & (other < 4 * size)
        )
    )


def _smooth_stretch(s: np.ndarray, v: np.ndarray, rows: slice) -> slice:
    """Rows of these between jumps, where folds were joined; none where the rows follow
    no clock.
    """
    part = np.hstack([s[rows], v[rows]])
    steps = np.abs(np.diff(part, axis=0))
    rms, power = np.sqrt(np.mean(steps**2, axis=0)), part.var(axis=0)
    if len(part) < _LEAST_ROWS or not power.all() or np.median(rms**2 / power) > _ROUGH:
        return slice(0, 0)
    alone = steps[1:-1] > _JUMP * np.maximum(
        np.maximum(steps[:-2], steps[2:]), 0.5 * rms
    )
    edges = np.concatenate([[0], np.flatnonzero(alone.any(axis=1)) + 2, [len(part)]])
    longest = int(np.diff(edges).argmax())
    return slice(rows.start + int(edges[longest]), rows.start + int(edges[longest + 1]))


def _large(record: Record) -> list[str]:
    """Messages on channels whose size suggests a wrong unit."""
    out = []
    for name, line in record.channels().items():
        kind = name[0] if name in ("ag", "vg", "xg") or name[1:].isdigit() else ""
        if kind in _LARGE:
            most, unit = _LARGE[kind]
            peak = float(np.nanmax(np.abs(line)))
            if peak > most or (
                kind == "a"
                and peak > _BRISK
                and peak > _WIDE * _dominant(line, record.fs) ** 2
            ):
                out.append(f"{name} reaches {peak:.3g} {unit}: is its unit declared?")
    return out


def _dominant(line: np.ndarray, fs: float) -> float:
    """Circular frequency of the largest spectral line, 1/s."""
    y = line[np.isfinite(line)]
    return (
        2
        * np.pi
        * fs
        / len(y)
        * (1 + int(np.argmax(np.abs(np.fft.rfft(y - y.mean()))[1:])))
    )


def _contradictions(record: Record) -> list[str]:
    """Messages on channels of one DOF that contradict each other."""
    try:
        table = channel_alignment(record)
    except NRFError:  # no DOF has two kinds of channels
        return []
    out = []
    clock, several = _wrong_clock(table)
    gains = table["gain"].astype(float)
    known = gains.index[np.isfinite(gains)]
    asked = {
        n: _unit_question(gains[n], str(table.at[n, "reference"]), str(n))
        for n in known
    }
    if clock and (
        several or not all(asked.values())
    ):  # no unit of a channel explains as much
        return [
            f"the motions contradict each other as if the time were in {clock}:"
            f" {_declared(clock)}"
        ]
    for name, row in table.iterrows():
        if row["aligned"]:
            continue
        gain, unit = float(row["gain"]), asked.get(name, "")
        if unit:
            unit += f"; or is the time in {clock}? {_declared(clock)}" if clock else ""
            out.append(
                f"{name} is {gain:.2g} times as large as {row['reference']} says:"
                f" {unit}"
            )
        elif (
            not np.isfinite(gain)
            or abs(gain - 1) > _FAR
            or row["sign"] < 0
            or abs(row["samples"]) > 0.5
        ):
            out.append(str(row["message"]))
        elif abs(np.log(gain)) > max(_LEAST, _SURE * row["scatter"]):
            says = f"{name} is {gain:.3g} times as large as {row['reference']} says"
            out.append(f"{says}: is the calibration of one of them wrong?")
    return out or _drifting(record, table)


def _drifting(record: Record, table: pd.DataFrame) -> list[str]:
    """Messages on channels whose gain against their reference differs between the
    halves of the record.
    """
    half, n = record.n_samples // 2, record.n_samples
    first, last = (
        channel_alignment(record, runs=[rows])
        for rows in (slice(0, half), slice(half, n))
    )
    apart = np.log((last["gain"] / first["gain"]).astype(float))
    chance = _SURE * np.hypot(
        first["scatter"].astype(float), last["scatter"].astype(float)
    )
    return [
        f"the gain of {name} or {table.at[name, 'reference']} drifts: their ratio"
        f" changes by {200 * apart[name]:+.2g} % over the record. Check its amplifier."
        for name in table.index[apart.abs() > np.maximum(_STEADY, chance)]
    ]


def _wrong_clock(table: pd.DataFrame) -> tuple[str, bool]:
    """Unit of the time that would explain all gains, and whether two orders of
    derivatives agree on it.
    """
    orders = pd.Series(range(3), list("xva"))
    steps = (
        orders[table["reference"].str[0]].to_numpy()
        - orders[table.index.str[0]].to_numpy()
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = table["gain"].to_numpy(dtype=float) ** (1.0 / steps)  # of the times
    for wrong, unit in _CLOCKS.items():
        if np.isfinite(ratio).all() and (np.abs(ratio / wrong - 1) < _NEAR).all():
            return unit, len(set(steps)) > 1
    return "", False


def _declared(unit: str) -> str:
    """Question on the unit of the time."""
    return (
        f"is the unit of the time declared? (units={{'t': '{unit}'}}, --unit t={unit})"
    )


def _unit_question(gain: float, reference: str, name: str) -> str:
    """Question on the unit of one of two channels; empty if their ratio is that of no
    unit.
    """
    for ratio, unit in _RATIOS.items():
        if abs(gain / ratio - 1) < _NEAR:
            wrong, other = (
                (reference, name) if unit in ("g", "gal") else (name, reference)
            )
            return f"is {wrong} in {unit}? (or {other} in another unit)"
        if abs(gain * ratio - 1) < _NEAR:
            wrong, other = (
                (name, reference)
                if unit in ("g", "gal") and name[0] == "a"
                else (reference, name)
            )
            return f"is {wrong} in {unit}? (or {other} in another unit)"
    return ""


@dataclass
class Measured:
    """One record in words and numbers."""

    name: str
    n_dof: int
    n_samples: int
    fs: float
    channels: pd.DataFrame
    forced: tuple[int, ...] = ()
    unknown: tuple[int, ...] = ()
    base_moves: bool = False
    role: str = ""

    @property
    def facts(self) -> str:
        """Size, clock, forces and base of the record in one line."""
        text = (
            f"{self.n_dof} DOF{'s' if self.n_dof > 1 else ''}, {self.n_samples} samples"
            f" at {self.fs:g} Hz, "
        )
        text += f"{self.n_samples / self.fs:.4g} s"
        text += (
            f"; forced: DOF {', '.join(map(str, self.forced))}"
            if self.forced
            else "; no force measured"
        )
        if self.unknown:
            text += f"; force unknown on DOF {', '.join(map(str, self.unknown))}"
        text += "; the base moves" if self.base_moves else "; the base is at rest"
        return text + (f"; {self.role}" if self.role else "")

    @property
    def sentence(self) -> str:
        """The record in one line, its name first."""
        return f"{self.name}: {self.facts}"


def measured(
    record: Record, noise: Mapping[str, float] | None = None, role: str = ""
) -> Measured:
    """Summary of a record; ``noise`` is the estimated rms by channel, SI."""
    levels = dict(noise or {})
    rows = [
        (
            name,
            kind_of(record, name),
            size["unit"],
            size["rms"],
            size["peak"],
            levels.get(name, float("nan")),
        )
        for name, size in summary(record)["channels"].items()
    ]
    channels = pd.DataFrame(
        rows, columns=["channel", "what", "unit", "rms", "peak", "noise"]
    )
    size = (record.n_dof, record.n_samples, record.fs)
    return Measured(
        record.name,
        *size,
        channels,
        record.forced,
        record.unknown,
        record.base_moves,
        role,
    )
