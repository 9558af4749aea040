"""Bad input to ``Record`` and to what works on records."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import KinematicSmoother, Record
from pysindy_nrf.exceptions import DataQualityWarning
from pysindy_nrf.records.checks.channel_checks import check_channels
from pysindy_nrf.simulation.noise import add_noise

from .kind import Kind, refused
from .material import N_SAMPLES, NAMES, TIME, changed, channels, good, table

NOISE = 0.002  # share of each channel's rms, as of a good converter
LONG = 4000  # samples of the records whose channels are checked


def record(**changes: Any) -> partial:
    """A record with some of its arguments replaced."""
    return partial(Record, **channels(**changes))


def accelerations(a: np.ndarray) -> partial:
    """A record of accelerations alone."""
    return record(acceleration=a, displacement=None, force=None)


def timed(time: Any) -> partial:
    """A record whose clock is a column of times."""
    return record(fs=None, time=time)


def from_table(frame: Any) -> partial:
    """A record from a table, sampled at 1 kHz."""
    return partial(Record.from_frame, frame, fs=1e3)


def features_of(arrays: dict[str, Any]) -> Any:
    """Features of a record with these channels."""
    return Record(**arrays).to_features()


def with_warnings(arrays: dict[str, Any]) -> Any:
    """Checks of a record's channels, which warn."""
    return check_channels(Record(**arrays), warn=True)


# -- what is refused -----------------------------------------------------------


def clocks() -> Iterator[Kind]:
    """Sampling rates and times."""
    yield refused("no clock", record(fs=None), "has no clock", "fs=")
    for fs in (0, -10, np.nan, np.inf, "fast", [1e3, 1e3]):
        yield refused(f"fs {fs!r}", record(fs=fs), "is not a sampling rate", "Hz")

    yield refused(
        "fs and a time, fs wrong",
        record(fs="fast", time=TIME),
        "is not a sampling rate",
        "Hz",
    )
    yield refused(
        "fs contradicts the time",
        record(fs=500.0, time=TIME),
        "contradicts the time, which has 1000 Hz",
        "Leave one out",
    )
    yield refused(
        "duplicate time stamps",
        timed(np.maximum(TIME, TIME[4])),
        "stands still after row 0",
        "drop repeated",
    )
    yield refused(
        "reversed time", timed(TIME[::-1]), "runs backwards after row 0", "Sort"
    )
    yield refused(
        "gap in the time",
        timed(TIME + (TIME > 0.5)),
        "clock is uneven, 1.001 s after row 500",
        "Split|resample",
    )

    jitter = 4e-4 * np.random.default_rng(0).uniform(size=N_SAMPLES)
    yield refused("jitter", timed(TIME + jitter), "clock is uneven", "resample")
    yield refused(
        "a time with NaN",
        timed(np.where(TIME == TIME[7], np.nan, TIME)),
        "not finite in row 7",
        "Repair",
    )
    stamps = (1e3 * TIME).astype("datetime64[ms]")
    yield refused(
        "a time with NaT",
        timed(np.where(TIME == TIME[7], np.datetime64("NaT"), stamps)),
        "not finite in row 7",
        "Repair",
    )
    yield refused(
        "times without end",
        timed(1e308 * np.linspace(-1, 1, len(TIME))),
        "is not a time in seconds",
        "Check its unit",
    )
    yield refused(
        "one time far off",
        timed(np.where(TIME == TIME[-1], 1e308, TIME)),
        "clock is uneven",
        "Split|resample",
    )
    yield refused(
        "too few times",
        timed(TIME[:-3]),
        "1497 times for 1500 samples",
        "one time for each",
    )


def shapes() -> Iterator[Kind]:
    """Channels of other sizes, or none."""
    a, F = good().acceleration, good().force

    yield refused(
        "no motion",
        partial(Record, force=F.copy(), fs=1e3),
        "has no motion",
        "acceleration, velocity or displacement",
    )
    yield refused("unequal lengths", record(force=F[:-1]), "force 1499", "one clock")
    yield refused(
        "unequal widths",
        record(force=F[:, :2]),
        "acceleration has 3 columns, .*force has 2",
        "one column for each DOF",
    )
    yield refused("one sample", accelerations(a[:1]), "has 1 samples", "two")
    yield refused("no sample", accelerations(a[:0]), "has 0 samples", "two")
    yield refused("no DOF", accelerations(a[:, :0]), "has 0 DOFs", "transpose")
    yield refused(
        "a million DOFs",
        accelerations(np.ones((2, 1_000_000), dtype=np.float32)),
        "has 1000000 DOFs",
        "transpose",
    )
    yield refused(
        "every motion NaN",
        record(acceleration=np.nan * a, displacement=None),
        "has no motion, every channel is NaN",
        "measured",
    )


def values() -> Iterator[Kind]:
    """Samples that are no finite real numbers."""
    a, x = good().acceleration, good().displacement

    yield refused(
        "NaN inside",
        record(acceleration=changed(a, 9, 1, np.nan), name="run 4"),
        "a2 of record 'run 4' is NaN in row 9",
        "Split",
    )
    yield refused(
        "infinity",
        record(base_acceleration=np.where(TIME == TIME[3], np.inf, 0)),
        "ag .* is infinite in row 3",
        "Repair",
    )
    yield refused(
        "complex displacement",
        record(displacement=x + 0j),
        "x1 .* is complex",
        ".real",
    )
    yield refused(
        "text as acceleration",
        record(acceleration=np.full((N_SAMPLES, 3), "x")),
        "a1 .* does not hold numbers",
        "Convert",
    )
    yield refused(
        "a covariate in words",
        record(covariates={"mode": ["up"] * N_SAMPLES}),
        "mode .* does not hold numbers",
        "Convert",
    )
    yield refused(
        "a covariate of another length",
        record(covariates={"volt": [1, 2]}),
        "covariate volt 2",
        "one clock",
    )
    yield refused(
        "a covariate that is a matrix",
        record(covariates={"volt": a}),
        "covariate volt have 3 columns",
        "Expected",
    )
    yield refused(
        "covariates that are no mapping",
        record(covariates=[TIME]),
        "covariates are not a mapping",
        "by name",
    )
    yield refused(
        "unknown coordinates",
        record(coordinates="local"),
        "coordinates='local'",
        "relative",
    )


def tables() -> Iterator[Kind]:
    """Tables whose columns do not make a record."""
    a, frame = good().acceleration, table()
    two_levels = pd.MultiIndex.from_product([["x"], NAMES])

    yield refused(
        "a table without motions",
        partial(Record.from_frame, pd.DataFrame({"t": TIME, "load": 0.0})),
        "No column of .* is a motion",
        "a1..",
    )
    yield refused(
        "an empty table",
        partial(Record.from_frame, pd.DataFrame()),
        "No column",
        "a1..",
    )
    yield refused(
        "a table with a channel twice",
        from_table(frame.set_axis([*NAMES[:-1], "v1"], axis=1)),
        "'v1' is in the table more than once",
        "Rename",
    )
    yield refused(
        "a table with two-level columns",
        from_table(frame.set_axis(two_levels, axis=1)),
        "No column of .* is a motion",
        "a1..",
    )
    yield refused(
        "a table with a million DOFs in a name",
        from_table(pd.DataFrame({"a1": TIME, "a1000000": TIME})),
        "names DOF 1000000",
        "Rename",
    )
    yield refused(
        "two spellings of one channel",
        from_table(pd.DataFrame({"a1": a[:, 0], "A_1": a[:, 1]})),
        "both mean a1",
        "Rename or drop",
    )
    yield refused(
        "an array as a table",
        from_table(a.copy()),
        "ndarray is not a table",
        "DataFrame",
    )


def parts_and_features() -> Iterator[Kind]:
    """Windows that are not there; features that the channels do not give."""
    a = good().acceleration
    without_a2 = changed(a, slice(None), 1, np.nan)

    yield refused(
        "rows with a step",
        partial(Record.rows, good(), slice(0, 100, 2)),
        "not a part",
        "consecutive",
    )
    yield refused(
        "rows that are not there",
        partial(Record.rows, good(), slice(9000, 9100)),
        "not a part",
        "consecutive",
    )
    yield refused(
        "a window outside",
        partial(Record.window, good(), 50, 60),
        "no samples from 50 to 60 s",
        "lasts from 0 to 1.499 s",
    )
    yield refused(
        "features without velocity",
        partial(Record.to_features, Record(**channels()), smooth=False),
        "lacks v1",
        "smooth=True",
    )
    yield refused(
        "features of a floor without a channel",
        partial(features_of, channels(acceleration=without_a2, displacement=None)),
        "DOF 2 of record 'test 7' has no motion channel",
        "Measure a2",
    )
    yield refused(
        "a smoother that is none",
        partial(Record.to_features, good(), smooth="spline"),
        "smooth='spline' is unknown",
        "True, False",
    )
    too_wide = KinematicSmoother(band=(1, 900))
    yield refused(
        "a smoother with a band above Nyquist",
        partial(Record.to_features, good(), smooth=too_wide),
        "Nyquist",
        "Lower",
    )
    yield refused(
        "too short to fuse",
        partial(Record.to_features, good().rows(slice(0, 3))),
        "samples",
        "longer|more",
    )
    yield refused(
        "negative noise",
        partial(add_noise, good(), -0.1),
        "not a share of the RMS",
        "0.05",
    )
    yield refused(
        "noise on a channel that is not there",
        partial(add_noise, good(), 0.1, channels=["a9"]),
        "a9",
    )


# -- what is warned of ---------------------------------------------------------


def spoilt(channel: str, dof: int, change: Callable) -> dict[str, Any]:
    """Channels of which one is not what a good converter gives."""
    arrays = channels(NOISE, LONG)
    column = arrays[channel][:, dof - 1]
    arrays[channel][:, dof - 1] = change(column)
    return arrays


def clipped(y: np.ndarray) -> np.ndarray:
    return np.clip(y, -y.std(), y.std())


def dead(y: np.ndarray) -> np.ndarray:
    return 0 * y + 1e-3


def dying(y: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(y)) > 2500, y[2500], y)


def quantised(y: np.ndarray) -> np.ndarray:
    step = 0.3 * y.std()
    return step * np.round(y / step)


def with_spike(y: np.ndarray) -> np.ndarray:
    out = y.copy()
    out[1234] += 60 * y.std()
    return out


def copied() -> dict[str, Any]:
    """Channels of which one has the values of another."""
    arrays = channels(NOISE, LONG)
    arrays["acceleration"][:, 2] = arrays["acceleration"][:, 0]
    return arrays


def poor_channels(act: Callable) -> Iterator[Kind]:
    """Channels that look wrong, when asked for or on the way to the features."""

    def warned(name: str, arrays: dict[str, Any], *words: str) -> Kind:
        way = "" if act is with_warnings else ", found on the way to the features"
        return Kind(name + way, partial(act, arrays), DataQualityWarning, words)

    yield warned(
        "clipped channel",
        spoilt("acceleration", 2, clipped),
        "a2 is cut off",
        "larger one|larger range",
    )
    if act is with_warnings:  # a fusion refuses it
        yield warned(
            "dead channel",
            spoilt("displacement", 3, dead),
            "x3 is constant",
            "Leave it out",
        )
    yield warned(
        "channel that dies",
        spoilt("displacement", 1, dying),
        "x1 does not change for 1",
        "Cut the record",
    )
    yield warned(
        "quantised channel",
        spoilt("acceleration", 1, quantised),
        "a1 moves in steps",
        "smaller measuring range",
    )
    yield warned(
        "spike",
        spoilt("acceleration", 3, with_spike),
        "a3 has 1 single samples far off, the first in row 1234",
        "neighbours",
    )
    yield warned("copied channel", copied(), "a3 is the same as a1", "wiring")


def contradictions() -> Iterator[Kind]:
    """Channels that contradict each other, found on the way to the features."""
    arrays = channels(NOISE, LONG)
    a, x = arrays["acceleration"], arrays["displacement"]
    late = np.column_stack([np.roll(a[:, 0], 2), a[:, 1:]])

    def warned(name: str, changes: dict[str, Any], *words: str) -> Kind:
        call = partial(features_of, channels(NOISE, LONG, **changes))
        return Kind(name, call, DataQualityWarning, words)

    yield warned(
        "displacement in mm beside acceleration in m/s^2",
        {"displacement": 1e3 * x},
        "x1|x2|x3",
        "mm|unit|1000",
    )
    yield warned(
        "one displacement in mm",
        {"displacement": x * np.array([1.0, 1e3, 1.0])},
        "x2",
        "mm|unit|1000",
    )
    yield warned(
        "acceleration in g",
        {"acceleration": a / 9.80665},
        "a1|a2|a3",
        r"\bg\b|unit",
    )
    yield warned(
        "one acceleration delayed by 2 ms",
        {"acceleration": late},
        "x1 is .* early against a1",
        "alignment",
    )
    yield warned(
        "one acceleration with the wrong sign",
        {"acceleration": a * np.array([1.0, -1.0, 1.0])},
        "x2 (has the opposite sign|does not follow)",
        "alignment",
    )
    yield warned(
        "two accelerations swapped",
        {"acceleration": a[:, [1, 0, 2]]},
        "a1|a2|DOF 1|DOF 2",
        "swap|column|wiring|channel",
    )
    yield warned(
        "one acceleration copied from another",
        {"acceleration": a[:, [0, 0, 2]]},
        "a2|a1",
        "copied|same|wiring|copy",
    )
    yield warned(
        "one displacement copied from another",
        {"displacement": x[:, [0, 1, 1]]},
        "x3|x2",
        "copied|same|wiring|copy",
    )


# -- what passes ---------------------------------------------------------------


def without_warning(arrays: dict[str, Any]) -> bool:
    """Whether good channels pass without a word."""
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        features_of(arrays)
    return not raised


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from clocks()
    yield from shapes()
    yield from values()
    yield from tables()
    yield from parts_and_features()

    yield from poor_channels(with_warnings)
    yield from poor_channels(features_of)
    yield from contradictions()
    yield refused(
        "dead channel on the way to the features",
        partial(features_of, spoilt("displacement", 3, dead)),
        "Channel x3 of DOF 3 is constant",
        "leave the channel out",
    )

    for noise in (0.0, NOISE, 0.05):
        name = f"good channels with {100 * noise:g} % noise"
        call = partial(without_warning, channels(noise, LONG))
        yield Kind(name, call, lambda passes: passes is True)
