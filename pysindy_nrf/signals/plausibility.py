"""What looks wrong with a record before anything is solved: units, signs, delays, channels."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ..data.record import Record
from ..exceptions import NRFError

# Size of a motion or force above which a unit is likelier wrong than the structure violent.
_LARGE = {"a": (1e5, "m/s^2"), "v": (50.0, "m/s"), "x": (10.0, "m"), "F": (1e9, "N")}
# Ratios of two channels of one motion that betray a unit.
_RATIOS = {9.80665: "g", 1e3: "mm", 1e2: "cm", 1e6: "µm", 39.3701: "inches", 3.28084: "feet", 100 / 9.80665: "gal"}
# The same of an acceleration with the displacement (m) that it makes of its strongest line: light frames shake hard.
_BRISK, _WIDE = 500.0, 0.3
# Times its scatter that a gain must be away from 1 (and the least that is said), and by which it is said without that.
_SURE, _LEAST, _FAR = 2.0, 0.02, 0.2
_NEAR = 0.12  # relative distance within which a ratio is recognised
_SLOW = 8.0  # Hz, at which nobody measures accelerations of a structure
_CLOCKS = {1e-3: "ms", 1e-6: "µs"}  # ratios of the true time and the one that was read


def doubts(record: Record) -> list[str]:
    """What looks wrong with a record."""
    from .channel_checks import check_channels

    out = _large(record) + _contradictions(record)
    if not out and record.fs < _SLOW and any(name[0] == "a" and name[1:].isdigit() for name in record.channels()):
        out = [f"accelerations at {record.fs:.3g} Hz: {_declared('ms')}"]
    return out + list(check_channels(record)["message"])


def _large(record: Record) -> list[str]:
    out = []
    for name, line in record.channels().items():
        kind = name[0] if name in ("ag", "vg", "xg") or name[1:].isdigit() else ""
        if kind in _LARGE:
            most, unit = _LARGE[kind]
            peak = float(np.nanmax(np.abs(line)))
            if peak > most or (kind == "a" and peak > _BRISK and peak > _WIDE * _pace(line, record.fs) ** 2):
                out.append(f"{name} reaches {peak:.3g} {unit}: is its unit declared?")
    return out


def _pace(line: np.ndarray, fs: float) -> float:
    """Circular frequency of the strongest line, 1/s."""
    y = line[np.isfinite(line)]
    return 2 * np.pi * fs / len(y) * (1 + int(np.argmax(np.abs(np.fft.rfft(y - y.mean()))[1:])))


def _contradictions(record: Record) -> list[str]:
    from .alignment import channel_alignment

    try:
        table = channel_alignment(record)
    except NRFError:  # no DOF has two kinds of channels
        return []
    out = []
    clock, several = _wrong_clock(table)
    gains = table["gain"].astype(float)
    betrayed = {n: _betrayed(gains[n], str(table.at[n, "reference"]), str(n)) for n in gains.index[np.isfinite(gains)]}
    if clock and (several or not all(betrayed.values())):  # no unit of a channel explains as much
        return [f"the motions contradict each other as if the time were in {clock}: {_declared(clock)}"]
    for name, row in table.iterrows():
        if row["aligned"]:
            continue
        gain, unit = float(row["gain"]), betrayed.get(name, "")
        if unit:
            unit += f"; or is the time in {clock}? {_declared(clock)}" if clock else ""
            out.append(f"{name} is {gain:.2g} times as large as {row['reference']} says: {unit}")
        elif not np.isfinite(gain) or abs(gain - 1) > _FAR or row["sign"] < 0 or abs(row["samples"]) > 0.5:
            out.append(str(row["message"]))
        elif abs(np.log(gain)) > max(_LEAST, _SURE * row["scatter"]):
            says = f"{name} is {gain:.3g} times as large as {row['reference']} says"
            out.append(f"{says}: is the calibration of one of them wrong?")
    return out


def _wrong_clock(table: pd.DataFrame) -> tuple[str, bool]:
    """The unit of the time that would explain all gains, and whether rates and displacements agree on it."""
    orders = pd.Series(range(3), list("xva"))
    steps = orders[table["reference"].str[0]].to_numpy() - orders[table.index.str[0]].to_numpy()
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = table["gain"].to_numpy(dtype=float) ** (1.0 / steps)  # of the times
    for wrong, unit in _CLOCKS.items():
        if np.isfinite(ratio).all() and (np.abs(ratio / wrong - 1) < _NEAR).all():
            return unit, len(set(steps)) > 1
    return "", False


def _declared(unit: str) -> str:
    return f"is the unit of the time declared? (units={{'t': '{unit}'}}, --unit t={unit})"


def _betrayed(gain: float, reference: str, name: str) -> str:
    for ratio, unit in _RATIOS.items():
        if abs(gain / ratio - 1) < _NEAR:
            wrong, other = (reference, name) if unit in ("g", "gal") else (name, reference)
            return f"is {wrong} in {unit}? (or {other} in another unit)"
        if abs(gain * ratio - 1) < _NEAR:
            wrong, other = (name, reference) if unit in ("g", "gal") and name[0] == "a" else (reference, name)
            return f"is {wrong} in {unit}? (or {other} in another unit)"
    return ""
