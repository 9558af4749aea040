"""Bad input to ``Record`` and to what works on records."""

# ruff: noqa: E501

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import KinematicSmoother, Record
from pysindy_nrf.exceptions import DataQualityWarning, NRFError
from pysindy_nrf.records.checks.channel_checks import check_channels
from pysindy_nrf.simulation.noise import add_noise

from .kind import Kind
from .material import NAMES, TIME, N, changed, channels, good, table


def rec(**changes: Any):
    """A record with some of its arguments replaced."""
    return lambda given: Record(**given), (channels(**changes),)


def clock(time: Any, **changes: Any):
    return rec(fs=None, time=time, **changes)


def refused() -> dict[str, tuple]:
    g = good()
    a, F = g.acceleration, g.force
    frame = table()
    jitter = 4e-4 * np.random.default_rng(0).uniform(size=N)
    plain = lambda what, *given: (what, given)  # noqa: E731
    return {
        "no motion": (
            (lambda F: Record(force=F, fs=1e3), (F.copy(),)),
            "has no motion",
            "acceleration, velocity or displacement",
        ),
        "no clock": (rec(fs=None), "has no clock", "fs="),
        **{
            f"fs {fs!r}": (rec(fs=fs), "is not a sampling rate", "Hz")
            for fs in (0, -10, np.nan, np.inf, "fast", [1e3, 1e3])
        },
        "fs and a time, fs wrong": (
            rec(fs="fast", time=TIME),
            "is not a sampling rate",
            "Hz",
        ),
        "fs contradicts the time": (
            rec(fs=500.0, time=TIME),
            "contradicts the time, which has 1000 Hz",
            "Leave one out",
        ),
        "unequal lengths": (rec(force=F[:-1]), "force 1499", "one clock"),
        "unequal widths": (
            rec(force=F[:, :2]),
            "acceleration has 3 columns, .*force has 2",
            "one column for each DOF",
        ),
        "one sample": (
            rec(acceleration=a[:1], displacement=None, force=None),
            "has 1 samples",
            "two",
        ),
        "no sample": (
            rec(acceleration=a[:0], displacement=None, force=None),
            "has 0 samples",
            "two",
        ),
        "no DOF": (
            rec(acceleration=a[:, :0], displacement=None, force=None),
            "has 0 DOFs",
            "transpose",
        ),
        "a million DOFs": (
            rec(
                acceleration=np.ones((2, 1_000_000), dtype=np.float32),
                displacement=None,
                force=None,
            ),
            "has 1000000 DOFs",
            "transpose",
        ),
        "every motion NaN": (
            rec(acceleration=np.nan * a, displacement=None),
            "has no motion, every channel is NaN",
            "measured",
        ),
        "NaN inside": (
            rec(acceleration=changed(a, 9, 1, np.nan), name="run 4"),
            "a2 of record 'run 4' is NaN in row 9",
            "Split",
        ),
        "infinity": (
            rec(base_acceleration=np.where(TIME == TIME[3], np.inf, 0)),
            "ag .* is infinite in row 3",
            "Repair",
        ),
        "complex displacement": (
            rec(displacement=g.displacement + 0j),
            "x1 .* is complex",
            ".real",
        ),
        "text as acceleration": (
            rec(acceleration=np.full((N, 3), "x")),
            "a1 .* does not hold numbers",
            "Convert",
        ),
        "a covariate in words": (
            rec(covariates={"mode": ["up"] * N}),
            "mode .* does not hold numbers",
            "Convert",
        ),
        "a covariate of another length": (
            rec(covariates={"volt": [1, 2]}),
            "covariate volt 2",
            "one clock",
        ),
        "a covariate that is a matrix": (
            rec(covariates={"volt": a}),
            "covariate volt have 3 columns",
            "Expected",
        ),
        "covariates that are no mapping": (
            rec(covariates=[TIME]),
            "covariates are not a mapping",
            "by name",
        ),
        "duplicate time stamps": (
            clock(np.maximum(TIME, TIME[4])),
            "stands still after row 0",
            "drop repeated",
        ),
        "reversed time": (clock(TIME[::-1]), "runs backwards after row 0", "Sort"),
        "gap in the time": (
            clock(TIME + (TIME > 0.5)),
            "clock is uneven, 1.001 s after row 500",
            "Split|resample",
        ),
        "jitter": (clock(TIME + jitter), "clock is uneven", "resample"),
        "a time with NaN": (
            clock(np.where(TIME == TIME[7], np.nan, TIME)),
            "not finite in row 7",
            "Repair",
        ),
        "a time with NaT": (
            clock(
                np.where(
                    TIME == TIME[7],
                    np.datetime64("NaT"),
                    (1e3 * TIME).astype("datetime64[ms]"),
                )
            ),
            "not finite in row 7",
            "Repair",
        ),
        "times without end": (
            clock(1e308 * np.linspace(-1, 1, len(TIME))),
            "is not a time in seconds",
            "Check its unit",
        ),
        "one time far off": (
            clock(np.where(TIME == TIME[-1], 1e308, TIME)),
            "clock is uneven",
            "Split|resample",
        ),
        "too few times": (
            clock(TIME[:-3]),
            "1497 times for 1500 samples",
            "one time for each",
        ),
        "unknown coordinates": (
            rec(coordinates="local"),
            "coordinates='local'",
            "relative",
        ),
        "a table without motions": (
            plain(Record.from_frame, pd.DataFrame({"t": TIME, "load": 0.0})),
            "No column of .* is a motion",
            "a1..",
        ),
        "an empty table": (
            plain(Record.from_frame, pd.DataFrame()),
            "No column",
            "a1..",
        ),
        "a table with a channel twice": (
            plain(
                lambda t: Record.from_frame(t, fs=1e3),
                frame.set_axis([*NAMES[:-1], "v1"], axis=1),
            ),
            "'v1' is in the table more than once",
            "Rename",
        ),
        "a table with two-level columns": (
            plain(
                lambda t: Record.from_frame(t, fs=1e3),
                frame.set_axis(pd.MultiIndex.from_product([["x"], NAMES]), axis=1),
            ),
            "No column of .* is a motion",
            "a1..",
        ),
        "a table with a million DOFs in a name": (
            plain(
                lambda t: Record.from_frame(t, fs=1e3),
                pd.DataFrame({"a1": TIME, "a1000000": TIME}),
            ),
            "names DOF 1000000",
            "Rename",
        ),
        "two spellings of one channel": (
            plain(
                lambda t: Record.from_frame(t, fs=1e3),
                pd.DataFrame({"a1": a[:, 0], "A_1": a[:, 1]}),
            ),
            "both mean a1",
            "Rename or drop",
        ),
        "an array as a table": (
            plain(lambda t: Record.from_frame(t, fs=1e3), a.copy()),
            "ndarray is not a table",
            "DataFrame",
        ),
        "rows with a step": (
            plain(lambda r: r.rows(slice(0, 100, 2)), g),
            "not a part",
            "consecutive",
        ),
        "rows that are not there": (
            plain(lambda r: r.rows(slice(9000, 9100)), g),
            "not a part",
            "consecutive",
        ),
        "a window outside": (
            plain(lambda r: r.window(50, 60), g),
            "no samples from 50 to 60 s",
            "lasts from 0 to 1.499 s",
        ),
        "features without velocity": (
            (lambda given: Record(**given).to_features(smooth=False), (channels(),)),
            "lacks v1",
            "smooth=True",
        ),
        "features of a floor without a channel": (
            (
                lambda given: Record(**given).to_features(),
                (
                    channels(
                        acceleration=changed(a, slice(None), 1, np.nan),
                        displacement=None,
                    ),
                ),
            ),
            "DOF 2 of record 'test 7' has no motion channel",
            "Measure a2",
        ),
        "a smoother that is none": (
            plain(lambda r: r.to_features(smooth="spline"), g),
            "smooth='spline' is unknown",
            "True, False",
        ),
        "a smoother with a band above Nyquist": (
            plain(lambda r: r.to_features(smooth=KinematicSmoother(band=(1, 900))), g),
            "Nyquist",
            "Lower",
        ),
        "too short to fuse": (
            (
                lambda given: Record(**given).to_features(),
                (
                    channels(
                        **{
                            k: v[:3]
                            for k, v in channels().items()
                            if isinstance(v, np.ndarray)
                        }
                    ),
                ),
            ),
            "samples",
            "longer|more",
        ),
        "negative noise": (
            plain(lambda r: add_noise(r, -0.1), g),
            "not a share of the RMS",
            "0.05",
        ),
        "noise on a channel that is not there": (
            plain(lambda r: add_noise(r, 0.1, channels=["a9"]), g),
            "a9",
        ),
    }


def rough(noise: float = 0.002) -> dict[str, Any]:
    """Noisy channels as they come from a converter."""
    r = good(noise, 4000)
    return {
        "force": r.force.copy(),
        "acceleration": r.acceleration.copy(),
        "displacement": r.displacement.copy(),
        "fs": 1e3,
        "name": "test 7",
    }


def asked(given: dict[str, Any]) -> Any:
    return check_channels(Record(**given), warn=True)


def unasked(given: dict[str, Any]) -> Any:
    return Record(**given).to_features()


def spoilt(channel: str, dof: int, change: Any, act: Any = asked) -> tuple:
    given = rough()
    array = given[channel]
    array[:, dof - 1] = change(array[:, dof - 1])
    return act, (given,)


def quality() -> dict[str, tuple]:
    """Channels that look wrong when they are asked."""

    def spike(y):
        y = y.copy()
        y[1234] += 60 * y.std()
        return y

    def dying(y):
        return np.where(np.arange(len(y)) > 2500, y[2500], y)

    def quantised(y):
        step = 0.3 * y.std()
        return step * np.round(y / step)

    copied = rough()
    copied["acceleration"][:, 2] = copied["acceleration"][:, 0]
    return {
        "clipped channel": (
            spoilt("acceleration", 2, lambda y: np.clip(y, -y.std(), y.std())),
            "a2 is cut off",
            "larger one|larger range",
        ),
        "dead channel": (
            spoilt("displacement", 3, lambda y: 0 * y + 1e-3),
            "x3 is constant",
            "Leave it out",
        ),
        "channel that dies": (
            spoilt("displacement", 1, dying),
            "x1 does not change for 1",
            "Cut the record",
        ),
        "quantised channel": (
            spoilt("acceleration", 1, quantised),
            "a1 moves in steps",
            "smaller measuring range",
        ),
        "spike": (
            spoilt("acceleration", 3, spike),
            "a3 has 1 single samples far off, the first in row 1234",
            "neighbours",
        ),
        "copied channel": (
            (lambda given: check_channels(Record(**given), warn=True), (copied,)),
            "a3 is the same as a1",
            "wiring",
        ),
    }


def on_the_way() -> dict[str, tuple]:
    """The same without being asked, on the way to the features."""
    rows = quality()
    return {
        f"{name}, found on the way to the features": ((unasked, given), *words)
        for name, ((_, given), *words) in rows.items()
        if name != "dead channel"  # that one is refused
    }


def quiet(given: dict[str, Any]) -> bool:
    """Whether good channels pass without a word."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        unasked(given)
    return not said


def features_of(**changes: Any):
    """Features of a noisy record in which channels contradict each other."""
    return lambda given: Record(**given).to_features(), (rough() | changes,)


def contradictions() -> dict[str, tuple]:
    """Channels that contradict each other's kinematics, found on the way to the
    features.
    """
    g = rough()
    a, x = g["acceleration"], g["displacement"]
    swapped = a[:, [1, 0, 2]]
    late = np.column_stack([np.roll(a[:, 0], 2), a[:, 1:]])
    return {
        "displacement in mm beside acceleration in m/s^2": (
            features_of(displacement=1e3 * x),
            "x1|x2|x3",
            "mm|unit|1000",
        ),
        "one displacement in mm": (
            features_of(displacement=x * np.array([1.0, 1e3, 1.0])),
            "x2",
            "mm|unit|1000",
        ),
        "acceleration in g": (
            features_of(acceleration=a / 9.80665),
            "a1|a2|a3",
            r"\bg\b|unit",
        ),
        "one acceleration delayed by 2 ms": (
            features_of(acceleration=late),
            "x1 is .* early against a1",
            "alignment",
        ),
        "one acceleration with the wrong sign": (
            features_of(acceleration=a * np.array([1.0, -1.0, 1.0])),
            "x2 (has the opposite sign|does not follow)",
            "alignment",
        ),
        "two accelerations swapped": (
            features_of(acceleration=swapped),
            "a1|a2|DOF 1|DOF 2",
            "swap|column|wiring|channel",
        ),
        "one acceleration copied from another": (
            features_of(acceleration=a[:, [0, 0, 2]]),
            "a2|a1",
            "copied|same|wiring|copy",
        ),
        "one displacement copied from another": (
            features_of(displacement=x[:, [0, 1, 1]]),
            "x3|x2",
            "copied|same|wiring|copy",
        ),
    }


def kinds() -> list[Kind]:
    """All kinds of this room."""
    out = [
        Kind("record", name, act, given, NRFError, tuple(words))
        for name, ((act, given), *words) in refused().items()
    ]
    out += [
        Kind("record", name, act, given, DataQualityWarning, tuple(words))
        for part in (quality(), on_the_way(), contradictions())
        for name, ((act, given), *words) in part.items()
    ]
    dead = spoilt("displacement", 3, lambda y: 0 * y + 1e-3, unasked)
    words = ("Channel x3 of DOF 3 is constant", "leave the channel out")
    out.append(
        Kind(
            "record", "dead channel on the way to the features", *dead, NRFError, words
        )
    )
    out += [
        Kind(
            "record",
            f"good channels with {100 * noise:g} % noise",
            quiet,
            (rough(noise),),
            lambda passed: passed is True,
        )
        for noise in (0.0, 0.002, 0.05)
    ]
    return out
