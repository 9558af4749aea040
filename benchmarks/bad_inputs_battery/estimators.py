"""Bad input to ``NRFRegressor.fit``: columns, samples, forces, clock, parameters."""

# ruff: noqa: E501

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pysindy as ps

from pysindy_nrf import Chain, NRFRegressor, Record, laws
from pysindy_nrf.exceptions import (
    BiasWarning,
    DataQualityWarning,
    IdentifiabilityError,
    NRFError,
    RankWarning,
)

from .kind import Kind
from .material import NAMES, TIME, N, changed, features, table

SHUFFLED = np.random.default_rng(0).permutation(N)
MEMORY = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=1e3)]}


def fit(X: Any = None, F: Any = "measured", params: Any = None, **options: Any):
    """A call of fit and what is given to it."""
    x, f = features()
    x, f = (x if X is None else X), (f if isinstance(F, str) and F == "measured" else F)
    return lambda X, F, kw: NRFRegressor(**(params or {})).fit(X, F, **kw), (
        x,
        f,
        options,
    )


def columns() -> dict[str, tuple]:
    X, F = features()
    frame = table()
    return {
        "one column short": (
            fit(X[:, :8]),
            "X has 8 columns.*a multiple of 3 is needed",
            "a1, a2",
        ),
        "columns for another chain": (
            fit(params={"chain": Chain(4)}),
            "X has 9 columns.*12 are needed",
            "a4",
        ),
        "no columns": (fit(X[:, :0]), "X has no samples|X has 0 "),
        "no samples": (fit(X[:0], F[:0]), "no samples", "at least as many"),
        "one sample": (
            fit(X[:1], F[:1]),
            "1 samples are too few for the balance of DOF 2, which has 19 unknowns",
            "lower degree",
        ),
        "fewer samples than unknowns (degree too high)": (
            fit(X[:19], F[:19]),
            "19 samples are too few",
            "lower degree",
        ),
        "a single number": (fit(3.0), "0 dimensions", "one row per sample"),
        "a cube": (fit(X[None]), "3 dimensions", "one row per sample"),
        "a file name": (fit("data.csv"), "data.csv", "read_record|one row per sample"),
        "text with markup": (
            fit("<script>alert(1)</script>"),
            "script",
            "read_record|one row per sample",
        ),
        "a dictionary": (fit({"a1": X[:, 0]}), "0 dimensions|not hold numbers"),
        "ragged lists": (
            fit([[1.0, 2.0, 3.0], [1.0, 2.0]]),
            "dimensions|differ in length|numbers",
        ),
        "a million columns": (fit(np.zeros((2, 1_000_000))), "columns"),
        "a million DOFs": (
            fit(np.ones((2, 3_000_000), dtype=np.float32)),
            "columns|too few|masses a chain may have",
        ),
        "complex": (fit(X + 0j), "hannel a1 .* is complex", ".real"),
        "complex hidden in an object array": (
            fit(changed_object(X, 0, 4, 1 + 1j)),
            "Channel v2 .* does not hold numbers",
            "Convert it",
        ),
        "words in a column": (
            fit(frame.assign(v2="high")),
            "Channel v2 .* does not hold numbers",
            "Convert it",
        ),
        "decimal commas": (
            fit(frame.assign(s3=[f"0,{i}" for i in range(N)])),
            "Channel s3 .* does not hold numbers",
            "decimal point",
        ),
        "dates in a column": (
            fit(frame.assign(a1=pd.date_range("2024", periods=N))),
            "Channel a1 .* does not hold numbers|unknown",
        ),
        "dates in an array": (
            fit(X.astype("datetime64[s]")),
            "Channel a1 .* does not hold numbers",
            "Convert it",
        ),
        "durations in an array": (
            fit((1e9 * X).astype("timedelta64[ns]")),
            "Channel a1 .* does not hold numbers",
            "Convert it",
        ),
        "bytes": (
            fit(X.astype("S8")),
            "Channel a1 .* does not hold numbers",
            "Convert it",
        ),
        "truth values": (
            fit(X > 0),
            "Channel a1 .* holds boolean values",
            "Give the measured numbers",
        ),
        "unknown column": (
            fit(frame.assign(voltage=1.0)),
            "unknown column voltage",
            "covariates .* are passed beside X",
        ),
        "missing column": (
            fit(frame.drop(columns="v2")),
            "lacks v2",
            "Name the columns a1.., v1.., s1..",
        ),
        "absolute names for relative motion": (
            fit(frame.rename(columns={"s1": "x1", "s2": "x2", "s3": "x3"})),
            "lacks s1, s2, s3",
            "unknown column",
        ),
        "column twice": (
            fit(frame.set_axis([*NAMES[:-1], "s2"], axis=1)),
            "'s2' is in X more than once",
            "Rename or drop",
        ),
        "two-level columns": (
            fit(frame.set_axis(pd.MultiIndex.from_product([["x"], NAMES]), axis=1)),
            "lacks a1",
            "Name the columns",
        ),
        "numbered columns": (fit(pd.DataFrame(X)), "lacks a1", "Name the columns"),
        "a column with markup": (
            fit(frame.rename(columns={"s3": "<b>s3</b>"})),
            "lacks s3",
            "Name the columns",
        ),
        "an empty table": (fit(pd.DataFrame()), "lacks a1", "Name the columns"),
        "an empty list": (fit([]), "no samples|0 dim|1 dim|columns"),
        "a list of a record and an array": (
            fit([Record(F, X[:, :3], fs=1e3), X], None),
            "something else in it",
            "Record",
        ),
    }


def changed_object(X: np.ndarray, row: int, column: int, value: Any) -> np.ndarray:
    out = X.astype(object)
    out[row, column] = value
    return out


def samples() -> dict[str, tuple]:
    X, _ = features()
    return {
        "NaN inside": (
            fit(changed(X, [700, 701], 4, np.nan)),
            "Channel v2 is NaN in rows 700, 701",
            "Split the record there",
        ),
        "infinity": (
            fit(changed(X, 700, 8, np.inf)),
            "Channel s3 is infinite in row 700",
            "Repair or cut",
        ),
        "infinity at the edge": (
            fit(changed(X, 0, 0, -np.inf)),
            "Channel a1 is infinite in row 0",
            "Repair or cut",
        ),
        "None in an object array": (
            fit(changed_object(X, 80, 7, None)),
            "Channel s2 is NaN in row 80",
            "Split",
        ),
        "many NaN": (
            fit(changed(X, slice(300, 900, 2), 3, np.nan)),
            "Channel v1 is NaN in rows 300, 302, 304 and 297 more",
            "Split",
        ),
        "dead from the middle": (
            fit(changed(X, slice(None), 5, np.nan)),
            "Channel v3 holds nothing but NaN",
            "Leave it out",
        ),
        "masked samples": (
            fit(np.ma.masked_array(X, np.isclose(X, X[80, 7]))),
            "Channel s2 is NaN in row 80",
            "Split",
        ),
        "nothing left between the edges": (
            fit(
                changed(changed(X, slice(0, 800), 0, np.nan), slice(700, N), 1, np.nan)
            ),
            "no row is finite in every channel",
            "Check the edges",
        ),
        "constant displacement": (
            fit(changed(X, slice(None), 6, 1e-3)),
            "Channel s1 is constant",
            "dead sensor",
        ),
        "constant velocity": (
            fit(changed(X, slice(None), 4, 0.0)),
            "Channel v2 is constant",
            "dead sensor",
        ),
        "dead accelerometer": (
            fit(changed(X, slice(None), 2, 0.0)),
            "Channel a3 is constant",
            "dead sensor",
        ),
        "a structure at rest": (fit(0 * X), "Channel a1 is constant", "not excited"),
        "huge numbers": (fit(X * 1e200), "leave the range of a double", "units"),
        "tiny numbers": (fit(X * 1e-200), "leave the range of a double", "units"),
        "float16 that overflowed": (
            fit((X * 1e4).astype(np.float16)),
            "Channel a1 is infinite",
            "Repair or cut",
        ),
    }


def forces_and_clock() -> dict[str, tuple]:
    X, F = features()
    frame = table()
    a = X[:, :3]
    absolute = np.hstack([a, X[:, 3:6].cumsum(axis=1), X[:, 6:].cumsum(axis=1)])
    return {
        "no force": (fit(F=None), "No force is measured", "known_masses"),
        "force unknown everywhere": (
            fit(F=np.nan * F),
            "No force is measured",
            "known_masses",
        ),
        "forces of another chain": (
            fit(F=F[:, :2]),
            "forces F have 2 columns, 3 are needed",
            "F1, F2, F3",
        ),
        "one force for three floors": (
            fit(F=F[:, 1]),
            "forces F have 1 columns",
            "F1, F2, F3",
        ),
        "unequal lengths": (
            fit(F=F[:-7]),
            "F has 1493 samples, X has 1500",
            "same clock",
        ),
        "gap in the force": (
            fit(F=changed(F, 77, 1, np.nan)),
            "Channel F2 is NaN in row 77",
            "Split",
        ),
        "infinite force": (
            fit(F=changed(F, 77, 1, np.inf)),
            "Channel F2 is infinite in row 77",
            "Repair",
        ),
        "complex force": (fit(F=F + 1j), "hannel F1 .* is complex", ".real"),
        "unknown force names": (
            fit(F=pd.DataFrame(F, columns=["hammer", "b", "c"])),
            "F has the columns hammer, b, c",
            "Name them F1, F2, F3",
        ),
        "forces sorted otherwise": (
            fit(frame, pd.DataFrame(F, columns=["F1", "F2", "F3"]).iloc[::-1]),
            "same labels in another order",
            "Sort both",
        ),
        "force as text": (fit(F="F.csv"), "0 dimensions"),
        "time runs backwards": (
            fit(time=TIME[::-1]),
            "does not increase after row 0",
            "record= ids",
        ),
        "time stands still": (
            fit(time=np.where(np.arange(N) == 8, TIME[7], TIME)),
            "does not increase after row 7",
            "Sort|sort",
        ),
        "stacked records without ids": (
            fit(np.vstack([X, X]), np.vstack([F, F]), time=np.tile(TIME, 2)),
            "does not increase after row 1499",
            "record= ids",
        ),
        "time with NaN": (
            fit(time=np.where(np.arange(N) == 5, np.nan, TIME)),
            "time is not finite in row 5",
            "Repair",
        ),
        "time that was lost (NaT)": (
            fit(
                time=np.where(
                    np.arange(N) == 5,
                    np.datetime64("NaT"),
                    (TIME * 1e3).astype("datetime64[ms]"),
                )
            ),
            "time is not finite in row 5",
            "Repair",
        ),
        "time as text": (fit(time=["noon"] * N), "does not hold numbers", "Convert"),
        "time too short": (
            fit(time=TIME[:-1]),
            "time has 1499 values",
            "one time for each",
        ),
        "ids too few": (fit(record=[1, 2]), "record has 2 ids", "one id for each"),
        "ids with gaps": (
            fit(record=np.where(TIME > 1, np.nan, 1.0)),
            "record has no id in rows 1001",
            "one id for each",
        ),
        "base acceleration too short": (
            fit(base_acceleration=np.zeros(3)),
            "base_acceleration has 3 samples",
            "same clock",
        ),
        "base acceleration lost": (
            fit(base_acceleration=np.full(N, np.nan)),
            "base_acceleration holds nothing but NaN",
            "Leave it out",
        ),
        "covariate with NaN": (
            fit(covariates={"volt": np.where(TIME == TIME[9], np.nan, 1)}),
            "covariate volt is NaN in row 9",
            "Split|fill",
        ),
        "covariates that are no mapping": (
            fit(covariates=[TIME]),
            "covariates",
            "mapping|name",
        ),
        "covariate missing": (
            fit(
                params={
                    "laws": {1: [laws.PowerSeries(1), laws.CovariateFriction("volt")]}
                }
            ),
            "needs the covariate 'volt'",
            "covariates=",
        ),
        "shuffled rows, a law with memory": (
            fit(X[SHUFFLED], F[SHUFFLED], {"laws": MEMORY, "dt": 1e-3}),
            "s1 does not move the way its rate v1 points",
            "keep the samples",
        ),
        "interleaved records, a law with memory": (
            fit(params={"laws": MEMORY, "dt": 1e-3}, record=np.arange(N) % 2),
            "rows of a record do not follow",
            "never shuffle",
        ),
        "a moving base without its motion": (
            fit(
                absolute,
                params={"coordinates": "absolute"},
                base_acceleration=np.sin(TIME),
            ),
            "needs the columns xdot0 and x0",
            "relative to the ground",
        ),
        "force beside records": (
            fit(Record(F, a, fs=1e3), F),
            "F was given beside records",
            "Leave F out",
        ),
        "ids beside records": (
            fit(Record(F, a, fs=1e3), None, record=np.zeros(N)),
            "record was given beside records",
            "Leave record out",
        ),
        "records of two chains": (
            fit([Record(F, a, fs=1e3), Record(F[:, :2], a[:, :2], fs=1e3)], None),
            "has 2 DOFs, 3 are needed",
            "one chain",
        ),
    }


def parameters() -> dict[str, tuple]:
    return {
        **{
            f"degree {degree!r}": (
                fit(params={"degree": degree}),
                "is not a whole number|is not a box",
                "Give",
            )
            for degree in (2.5, -1, True, "3", None, (1, 2, 3), (1, -2), [3], np.nan)
        },
        "degree 0 finds no storey": (
            fit(params={"degree": 0}),
            "m3 cannot be found",
            "hit floor 3",
        ),
        "degree 1000000": (
            fit(params={"degree": 10**6}),
            "degree=1000000 is above the highest power",
            "lower degree",
        ),
        "degree too high for the record": (
            fit(params={"degree": 40}),
            "1500 samples are too few .* unknowns",
            "lower degree",
        ),
        "order of a storey that is not there": (
            fit(params={"orders": {"storey 7": 2}}),
            "'storey 7' does not exist",
            "storey 1, storey 2, storey 3",
        ),
        "order at markup": (
            fit(params={"orders": {"<img src=x>": 2}}),
            "is not a site",
            "storey 2",
        ),
        "orders that are no mapping": (
            fit(params={"orders": "storey 2"}),
            "orders='storey 2' is not a mapping",
            "orders={",
        ),
        "orders and laws at one storey": (
            fit(params={"orders": {1: 2}, "laws": MEMORY}),
            "storey 1 has an order and laws",
            "not in both",
        ),
        "law that is none": (
            fit(params={"laws": {"storey 1": ["dahl"]}}),
            "'dahl', which is not a force law",
            "pysindy_nrf.laws",
        ),
        "law as a class": (
            fit(params={"laws": {"storey 1": laws.Dahl}}),
            "not a force law",
            "pysindy_nrf.laws",
        ),
        "laws that are no mapping": (
            fit(params={"laws": [laws.Dahl()]}),
            "is not a mapping",
            "laws={",
        ),
        "the same term twice": (
            fit(params={"laws": {1: [laws.PowerSeries(3), laws.Duffing()]}}),
            "both hold the term 's'",
            "leave one out",
        ),
        "law at a sensor": (
            fit(params={"laws": {"sensor a2": laws.LinearElastic()}}),
            "not a place for a force law",
            "storey",
        ),
        "known mass of no DOF": (
            fit(params={"known_masses": {4: 1.0}}),
            "known_masses names DOF 4",
            "DOFs 1 to 3",
        ),
        "known mass below zero": (
            fit(params={"known_masses": {1: -4.0}}),
            "is not a mass",
            "kg",
        ),
        "known mass NaN": (
            fit(params={"known_masses": {1: np.nan}}),
            "is not a mass",
            "kg",
        ),
        "known mass as text": (
            fit(params={"known_masses": {1: "ten"}}),
            "'ten' is not a mass",
            "kg",
        ),
        "known masses as a list": (
            fit(params={"known_masses": [10, 12]}),
            "is not a mapping",
            "known_masses={",
        ),
        "unknown strategy": (
            fit(params={"strategy": "parallel"}),
            "strategy='parallel'",
            "auto, complete, sequential, joint",
        ),
        "complete without the forces": (
            fit(params={"strategy": "complete"}),
            "none is measured on DOF 1, 3",
            "sequential",
        ),
        "unknown coordinates": (
            fit(params={"coordinates": "polar"}),
            "coordinates='polar'",
            "'relative' or 'absolute'",
        ),
        "unknown estimation": (
            fit(params={"estimation": "magic"}),
            "estimation='magic'",
            "ls",
        ),
        "chain that is none": (
            fit(params={"chain": 3}),
            "chain=3 is not a Chain",
            r"Chain\(3",
        ),
        "optimizer that is none": (
            fit(params={"optimizer": "STLSQ"}),
            "'STLSQ' is not an optimizer",
            "instance",
        ),
        "optimizer as a class": (
            fit(params={"optimizer": ps.STLSQ}),
            "is not an optimizer",
            "instance",
        ),
        "a threshold that leaves nothing": (
            fit(params={"optimizer": ps.STLSQ(threshold=1e3)}),
            "right-hand side is zero throughout",
            "lower its threshold",
        ),
        "constraints that are none": (
            fit(params={"constraints": ["m1 > 0"]}),
            "constraint",
            "Parameter",
        ),
        "band without a clock": (
            fit(params={"band": (1, 50)}),
            "band= needs the sampling step",
            "dt=",
        ),
        "band above Nyquist": (
            fit(params={"band": (1, 900), "dt": 1e-3}),
            "not below the Nyquist frequency 500 Hz",
            "Lower it",
        ),
        "band upside down": (
            fit(params={"band": (50, 1), "dt": 1e-3}),
            "is empty",
            "lo < hi",
        ),
        "band that is none": (
            fit(params={"band": 40, "dt": 1e-3}),
            "not a pair",
            r"\(lo, hi\)",
        ),
        "band of text": (
            fit(params={"band": ("1 Hz", "50 Hz"), "dt": 1e-3}),
            "band",
            "Hz",
        ),
        "band with NaN": (
            fit(params={"band": (np.nan, 50), "dt": 1e-3}),
            "band",
            "Hz|lo",
        ),
        "band on an uneven clock": (
            fit(params={"band": (1, 50)}, time=np.maximum(TIME, 2 * TIME - 0.999)),
            "step changes after row 999",
            "Split",
        ),
        **{
            f"dt {dt!r}": (fit(params={"dt": dt}), "is not a sampling step", "positive")
            for dt in (0, -1e-3, np.nan, np.inf, "1 ms", True)
        },
    }


def harmonic() -> tuple[np.ndarray, np.ndarray]:
    """The steady state of a linear chain under one sine: drift, rate and acceleration
    are dependent.
    """
    t = np.arange(2000) * 1e-3
    w, k, c, m = 2 * np.pi * 5.0, 4e4, 50.0, 10.0
    x = np.real(100.0 / (k - m * w * w + 1j * w * c) * np.exp(1j * w * t))
    v = np.real(1j * w * 100.0 / (k - m * w * w + 1j * w * c) * np.exp(1j * w * t))
    return np.column_stack([-w * w * x, v, x]), 100.0 * np.cos(w * t)[:, None]


def warned() -> dict[str, tuple]:
    """What can be computed, but is likely wrong: a warning says so."""
    X, F = features()
    absolute = np.hstack([X[:, :3], X[:, 3:6].cumsum(axis=1), X[:, 6:].cumsum(axis=1)])
    return {
        "force with the wrong sign": (
            fit(F=-F),
            "m2 = -.* is not positive",
            "wrong sign",
        ),
        "acceleration with the wrong sign": (
            fit(changed(X, slice(None), 1, -X[:, 1])),
            "m2|balance of DOF 2|Balance of DOF 2",
        ),
        "two drifts swapped": (fit(X[:, [0, 1, 2, 3, 4, 5, 6, 8, 7]]), "likely biased"),
        "two accelerations swapped": (
            fit(X[:, [2, 1, 0, *range(3, 9)]]),
            "likely biased|not positive",
        ),
        "an acceleration copied from another": (
            fit(changed(X, slice(None), 2, X[:, 1])),
            "likely biased",
        ),
        "displacement clipped": (
            fit(np.hstack([X[:, :6], np.clip(X[:, 6:], -2e-3, 2e-3)])),
            "likely biased",
        ),
        "absolute given as relative": (fit(absolute), "likely biased"),
        "acceleration delayed by 3 ms": (
            fit(np.hstack([np.roll(X[:, :3], 3, axis=0), X[:, 3:]])),
            "likely biased",
        ),
        "too low a degree": (fit(params={"degree": 1}), "likely biased"),
    }


def kinds() -> list[Kind]:
    """All kinds of this room."""
    out = [
        Kind("estimator", name, act, given, NRFError, tuple(words))
        for part in (columns(), samples(), forces_and_clock(), parameters())
        for name, ((act, given), *words) in part.items()
    ]
    out += [
        Kind("estimator", name, act, given, BiasWarning, tuple(words))
        for name, ((act, given), *words) in warned().items()
    ]
    act, given = fit(*harmonic(), params={"degree": 1})
    words = (
        "m1 cannot be told from the storey's stiffness",
        "excite several frequencies",
    )
    out.append(
        Kind(
            "estimator",
            "steady harmonic excitation",
            act,
            given,
            IdentifiabilityError,
            words,
        )
    )
    act, given = fit(*harmonic(), params={"degree": 3, "known_masses": {1: 10.0}})
    words = ("linearly dependent", "excite more frequencies")
    out.append(
        Kind(
            "estimator",
            "steady harmonic excitation, cubic, mass known",
            act,
            given,
            RankWarning,
            words,
        )
    )
    act, given = fit(changed(features()[0], slice(500, None), 4, np.nan))
    words = (
        "leave 500 of .* rows; channel v2 is measured in 500",
        "Cut the record|leave v2 out",
    )
    out.append(
        Kind(
            "estimator", "a sensor that fell out", act, given, DataQualityWarning, words
        )
    )
    return out
