"""Bad input to ``NRFRegressor.fit``: columns, samples, forces, clock, parameters."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import pysindy as ps

from pysindy_nrf import Chain, NRFRegressor, Record, laws
from pysindy_nrf.exceptions import (
    BiasWarning,
    DataQualityWarning,
    IdentifiabilityError,
    RankWarning,
)

from .kind import Kind, refused
from .material import N_SAMPLES, NAMES, TIME, absolute, changed, features, table

ALL_ROWS = slice(None)
WITH_MEMORY = {"storey 1": [laws.PowerSeries(1), laws.Dahl(sigma=1e3)]}
NOT_NUMBERS = "Channel a1 .* does not hold numbers"


def fit(X: Any, F: Any = None, **metadata: Any) -> partial:
    """A fit with default parameters."""
    return partial(NRFRegressor().fit, X, F, **metadata)


def fit_motion(X: Any) -> partial:
    """A fit of some motion to good forces."""
    return fit(X, features()[1])


def fit_force(F: Any, **metadata: Any) -> partial:
    """A fit of good motion to some forces."""
    return fit(features()[0], F, **metadata)


def fit_good(**metadata: Any) -> partial:
    """A fit of good motion to good forces, with something beside them."""
    return fit(*features(), **metadata)


def fit_with(**parameters: Any) -> partial:
    """A fit of good numbers with some parameters of the regressor."""
    return partial(NRFRegressor(**parameters).fit, *features())


def with_object(X: np.ndarray, row: int, column: int, value: Any) -> np.ndarray:
    """The numbers as objects, one of them something else."""
    out = X.astype(object)
    out[row, column] = value
    return out


# -- columns -------------------------------------------------------------------


def shapes() -> Iterator[Kind]:
    """Arrays of other shapes, and what is no array."""
    X, F = features()

    yield refused(
        "one column short",
        fit_motion(X[:, :8]),
        "X has 8 columns.*a multiple of 3 is needed",
        "a1, a2",
    )
    yield refused(
        "columns for another chain",
        fit_with(chain=Chain(4)),
        "X has 9 columns.*12 are needed",
        "a4",
    )
    yield refused("no columns", fit_motion(X[:, :0]), "X has no samples|X has 0 ")
    yield refused("no samples", fit(X[:0], F[:0]), "no samples", "at least as many")
    yield refused(
        "one sample",
        fit(X[:1], F[:1]),
        "1 samples are too few for the balance of DOF 2, which has 19 unknowns",
        "lower degree",
    )
    yield refused(
        "fewer samples than unknowns (degree too high)",
        fit(X[:19], F[:19]),
        "19 samples are too few",
        "lower degree",
    )
    yield refused(
        "a single number", fit_motion(3.0), "0 dimensions", "one row per sample"
    )
    yield refused("a cube", fit_motion(X[None]), "3 dimensions", "one row per sample")
    yield refused(
        "ragged lists",
        fit_motion([[1.0, 2.0, 3.0], [1.0, 2.0]]),
        "dimensions|differ in length|numbers",
    )
    yield refused("a million columns", fit_motion(np.zeros((2, 1_000_000))), "columns")
    yield refused(
        "a million DOFs",
        fit_motion(np.ones((2, 3_000_000), dtype=np.float32)),
        "columns|too few|masses a chain may have",
    )


def other_objects() -> Iterator[Kind]:
    """What is neither an array nor a table."""
    X, F = features()

    yield refused(
        "a file name",
        fit_motion("data.csv"),
        "data.csv",
        "read_record|one row per sample",
    )
    yield refused(
        "text with markup",
        fit_motion("<script>alert(1)</script>"),
        "script",
        "read_record|one row per sample",
    )
    yield refused(
        "a dictionary", fit_motion({"a1": X[:, 0]}), "0 dimensions|not hold numbers"
    )
    yield refused("an empty list", fit_motion([]), "no samples|0 dim|1 dim|columns")
    yield refused(
        "a list of a record and an array",
        fit([Record(F, X[:, :3], fs=1e3), X]),
        "something else in it",
        "Record",
    )


def types() -> Iterator[Kind]:
    """Columns that are no real numbers."""
    X, _ = features()
    frame = table()

    yield refused("complex", fit_motion(X + 0j), "hannel a1 .* is complex", ".real")
    yield refused(
        "complex hidden in an object array",
        fit_motion(with_object(X, 0, 4, 1 + 1j)),
        "Channel v2 .* does not hold numbers",
        "Convert it",
    )
    yield refused(
        "words in a column",
        fit_motion(frame.assign(v2="high")),
        "Channel v2 .* does not hold numbers",
        "Convert it",
    )
    yield refused(
        "decimal commas",
        fit_motion(frame.assign(s3=[f"0,{i}" for i in range(N_SAMPLES)])),
        "Channel s3 .* does not hold numbers",
        "decimal point",
    )
    dates = pd.date_range("2024", periods=N_SAMPLES)
    yield refused(
        "dates in a column",
        fit_motion(frame.assign(a1=dates)),
        f"{NOT_NUMBERS}|unknown",
    )
    yield refused(
        "dates in an array",
        fit_motion(X.astype("datetime64[s]")),
        NOT_NUMBERS,
        "Convert it",
    )
    yield refused(
        "durations in an array",
        fit_motion((1e9 * X).astype("timedelta64[ns]")),
        NOT_NUMBERS,
        "Convert it",
    )
    yield refused("bytes", fit_motion(X.astype("S8")), NOT_NUMBERS, "Convert it")
    yield refused(
        "truth values",
        fit_motion(X > 0),
        "Channel a1 .* holds boolean values",
        "Give the measured numbers",
    )


def names() -> Iterator[Kind]:
    """Tables whose columns have other names."""
    frame = table()
    positions = {"s1": "x1", "s2": "x2", "s3": "x3"}
    two_levels = pd.MultiIndex.from_product([["x"], NAMES])

    yield refused(
        "unknown column",
        fit_motion(frame.assign(voltage=1.0)),
        "unknown column voltage",
        "covariates .* are passed in addition to X",
    )
    yield refused(
        "missing column",
        fit_motion(frame.drop(columns="v2")),
        "lacks v2",
        "Name the columns a1.., v1.., s1..",
    )
    yield refused(
        "absolute names for relative motion",
        fit_motion(frame.rename(columns=positions)),
        "lacks s1, s2, s3",
        "unknown column",
    )
    yield refused(
        "column twice",
        fit_motion(frame.set_axis([*NAMES[:-1], "s2"], axis=1)),
        "'s2' is in X more than once",
        "Rename or drop",
    )
    yield refused(
        "two-level columns",
        fit_motion(frame.set_axis(two_levels, axis=1)),
        "lacks a1",
        "Name the columns",
    )
    yield refused(
        "numbered columns",
        fit_motion(pd.DataFrame(frame.to_numpy())),
        "lacks a1",
        "Name the columns",
    )
    yield refused(
        "a column with markup",
        fit_motion(frame.rename(columns={"s3": "<b>s3</b>"})),
        "lacks s3",
        "Name the columns",
    )
    yield refused(
        "an empty table", fit_motion(pd.DataFrame()), "lacks a1", "Name the columns"
    )


# -- samples -------------------------------------------------------------------


def gaps() -> Iterator[Kind]:
    """Samples that are missing or infinite."""
    X, _ = features()
    early = changed(X, slice(0, 800), 0, np.nan)
    nothing_left = changed(early, slice(700, N_SAMPLES), 1, np.nan)

    yield refused(
        "NaN inside",
        fit_motion(changed(X, [700, 701], 4, np.nan)),
        "Channel v2 is NaN in rows 700, 701",
        "Split the record there",
    )
    yield refused(
        "infinity",
        fit_motion(changed(X, 700, 8, np.inf)),
        "Channel s3 is infinite in row 700",
        "Repair or cut",
    )
    yield refused(
        "infinity at the edge",
        fit_motion(changed(X, 0, 0, -np.inf)),
        "Channel a1 is infinite in row 0",
        "Repair or cut",
    )
    yield refused(
        "None in an object array",
        fit_motion(with_object(X, 80, 7, None)),
        "Channel s2 is NaN in row 80",
        "Split",
    )
    yield refused(
        "many NaN",
        fit_motion(changed(X, slice(300, 900, 2), 3, np.nan)),
        "Channel v1 is NaN in rows 300, 302, 304 and 297 more",
        "Split",
    )
    yield refused(
        "dead from the middle",
        fit_motion(changed(X, ALL_ROWS, 5, np.nan)),
        "Channel v3 holds nothing but NaN",
        "Leave it out",
    )
    yield refused(
        "masked samples",
        fit_motion(np.ma.masked_array(X, np.isclose(X, X[80, 7]))),
        "Channel s2 is NaN in row 80",
        "Split",
    )
    yield refused(
        "nothing left between the edges",
        fit_motion(nothing_left),
        "no row is finite in every channel",
        "Check the edges",
    )


def sizes() -> Iterator[Kind]:
    """Channels that are constant, or of no physical size."""
    X, _ = features()

    yield refused(
        "constant displacement",
        fit_motion(changed(X, ALL_ROWS, 6, 1e-3)),
        "Channel s1 is constant",
        "dead sensor",
    )
    yield refused(
        "constant velocity",
        fit_motion(changed(X, ALL_ROWS, 4, 0.0)),
        "Channel v2 is constant",
        "dead sensor",
    )
    yield refused(
        "dead accelerometer",
        fit_motion(changed(X, ALL_ROWS, 2, 0.0)),
        "Channel a3 is constant",
        "dead sensor",
    )
    yield refused(
        "a structure at rest",
        fit_motion(0 * X),
        "Channel a1 is constant",
        "not excited",
    )
    yield refused(
        "huge numbers", fit_motion(X * 1e200), "leave the range of a double", "units"
    )
    yield refused(
        "tiny numbers", fit_motion(X * 1e-200), "leave the range of a double", "units"
    )
    yield refused(
        "float16 that overflowed",
        fit_motion((X * 1e4).astype(np.float16)),
        "Channel a1 is infinite",
        "Repair or cut",
    )


# -- forces and clock ----------------------------------------------------------


def forces() -> Iterator[Kind]:
    """Forces that are missing, of another chain, or no real numbers."""
    X, F = features()
    named = pd.DataFrame(F, columns=["F1", "F2", "F3"])

    yield refused("no force", fit(X), "No force is measured", "known_masses")
    yield refused(
        "force unknown everywhere",
        fit_force(np.nan * F),
        "No force is measured",
        "known_masses",
    )
    yield refused(
        "forces of another chain",
        fit_force(F[:, :2]),
        "forces F have 2 columns, 3 are needed",
        "F1, F2, F3",
    )
    yield refused(
        "one force for three floors",
        fit_force(F[:, 1]),
        "forces F have 1 columns",
        "F1, F2, F3",
    )
    yield refused(
        "unequal lengths",
        fit_force(F[:-7]),
        "F has 1493 samples, X has 1500",
        "same clock",
    )
    yield refused(
        "gap in the force",
        fit_force(changed(F, 77, 1, np.nan)),
        "Channel F2 is NaN in row 77",
        "Split",
    )
    yield refused(
        "infinite force",
        fit_force(changed(F, 77, 1, np.inf)),
        "Channel F2 is infinite in row 77",
        "Repair",
    )
    yield refused(
        "complex force", fit_force(F + 1j), "hannel F1 .* is complex", ".real"
    )
    yield refused(
        "unknown force names",
        fit_force(named.set_axis(["hammer", "b", "c"], axis=1)),
        "F has the columns hammer, b, c",
        "Name them F1, F2, F3",
    )
    yield refused(
        "forces sorted otherwise",
        fit(table(), named.iloc[::-1]),
        "same labels in another order",
        "Sort both",
    )
    yield refused("force as text", fit_force("F.csv"), "0 dimensions")


def clocks() -> Iterator[Kind]:
    """Times that do not run evenly forward."""
    X, F = features()
    milliseconds = (TIME * 1e3).astype("datetime64[ms]")
    sixth = np.arange(N_SAMPLES) == 5

    yield refused(
        "time runs backwards",
        fit_good(time=TIME[::-1]),
        "does not increase after row 0",
        "record= ids",
    )
    yield refused(
        "time stands still",
        fit_good(time=np.where(np.arange(N_SAMPLES) == 8, TIME[7], TIME)),
        "does not increase after row 7",
        "Sort|sort",
    )
    yield refused(
        "stacked records without ids",
        fit(np.vstack([X, X]), np.vstack([F, F]), time=np.tile(TIME, 2)),
        "does not increase after row 1499",
        "record= ids",
    )
    yield refused(
        "time with NaN",
        fit_good(time=np.where(sixth, np.nan, TIME)),
        "time is not finite in row 5",
        "Repair",
    )
    yield refused(
        "time that was lost (NaT)",
        fit_good(time=np.where(sixth, np.datetime64("NaT"), milliseconds)),
        "time is not finite in row 5",
        "Repair",
    )
    yield refused(
        "time as text",
        fit_good(time=["noon"] * N_SAMPLES),
        "does not hold numbers",
        "Convert",
    )
    yield refused(
        "time too short",
        fit_good(time=TIME[:-1]),
        "time has 1499 values",
        "one time for each",
    )


def metadata() -> Iterator[Kind]:
    """Ids, base motion and covariates that do not fit the samples."""
    volt_law = {1: [laws.PowerSeries(1), laws.CovariateFriction("volt")]}
    volt = np.where(TIME == TIME[9], np.nan, 1)

    yield refused(
        "ids too few", fit_good(record=[1, 2]), "record has 2 ids", "one id for each"
    )
    yield refused(
        "ids with gaps",
        fit_good(record=np.where(TIME > 1, np.nan, 1.0)),
        "record has no id in rows 1001",
        "one id for each",
    )
    yield refused(
        "base acceleration too short",
        fit_good(base_acceleration=np.zeros(3)),
        "base_acceleration has 3 samples",
        "same clock",
    )
    yield refused(
        "base acceleration lost",
        fit_good(base_acceleration=np.full(N_SAMPLES, np.nan)),
        "base_acceleration holds nothing but NaN",
        "Leave it out",
    )
    yield refused(
        "a moving base without its motion",
        partial(
            NRFRegressor(coordinates="absolute").fit,
            absolute(features()[0]),
            features()[1],
            base_acceleration=np.sin(TIME),
        ),
        "needs the columns xdot0 and x0",
        "relative to the ground",
    )
    yield refused(
        "covariate with NaN",
        fit_good(covariates={"volt": volt}),
        "covariate volt is NaN in row 9",
        "Split|fill",
    )
    yield refused(
        "covariates that are no mapping",
        fit_good(covariates=[TIME]),
        "covariates",
        "mapping|name",
    )
    yield refused(
        "covariate missing",
        fit_with(laws=volt_law),
        "needs the covariate 'volt'",
        "covariates=",
    )


def order_of_rows() -> Iterator[Kind]:
    """Rows out of order under a law with memory; data given twice."""
    X, F = features()
    shuffled = np.random.default_rng(0).permutation(N_SAMPLES)
    remembering = NRFRegressor(laws=WITH_MEMORY, dt=1e-3)
    a = X[:, :3]
    record = Record(F, a, fs=1e3)
    of_two_floors = Record(F[:, :2], a[:, :2], fs=1e3)

    yield refused(
        "shuffled rows, a law with memory",
        partial(remembering.fit, X[shuffled], F[shuffled]),
        "s1 does not move the way its rate v1 points",
        "keep the samples",
    )
    yield refused(
        "interleaved records, a law with memory",
        partial(remembering.fit, X, F, record=np.arange(N_SAMPLES) % 2),
        "rows of a record do not follow",
        "never shuffle",
    )
    yield refused(
        "force beside records",
        fit(record, F),
        "F was given in addition to records",
        "Leave F out",
    )
    yield refused(
        "ids beside records",
        fit(record, record=np.zeros(N_SAMPLES)),
        "record was given in addition to records",
        "Leave record out",
    )
    yield refused(
        "records of two chains",
        fit([record, of_two_floors]),
        "has 2 DOFs, 3 are needed",
        "one chain",
    )


# -- parameters of the regressor -----------------------------------------------


def degrees() -> Iterator[Kind]:
    """Degrees and orders of the storeys."""
    for degree in (2.5, -1, True, "3", None, (1, 2, 3), (1, -2), [3], np.nan):
        yield refused(
            f"degree {degree!r}",
            fit_with(degree=degree),
            "is not a whole number|is not a box",
            "Give",
        )
    yield refused(
        "degree 0 finds no storey",
        fit_with(degree=0),
        "m3 cannot be found",
        "hit floor 3",
    )
    yield refused(
        "degree 1000000",
        fit_with(degree=10**6),
        "degree=1000000 is above the highest power",
        "lower degree",
    )
    yield refused(
        "degree too high for the record",
        fit_with(degree=40),
        "1500 samples are too few .* unknowns",
        "lower degree",
    )
    yield refused(
        "order of a storey that is not there",
        fit_with(orders={"storey 7": 2}),
        "'storey 7' does not exist",
        "storey 1, storey 2, storey 3",
    )
    yield refused(
        "order at markup",
        fit_with(orders={"<img src=x>": 2}),
        "is not a site",
        "storey 2",
    )
    yield refused(
        "orders that are no mapping",
        fit_with(orders="storey 2"),
        "orders='storey 2' is not a mapping",
        "orders={",
    )
    yield refused(
        "orders and laws at one storey",
        fit_with(orders={1: 2}, laws=WITH_MEMORY),
        "storey 1 has an order and laws",
        "not in both",
    )


def force_laws() -> Iterator[Kind]:
    """Laws that are none, or at no place for one."""
    yield refused(
        "law that is none",
        fit_with(laws={"storey 1": ["dahl"]}),
        "'dahl', which is not a force law",
        "pysindy_nrf.laws",
    )
    yield refused(
        "law as a class",
        fit_with(laws={"storey 1": laws.Dahl}),
        "not a force law",
        "pysindy_nrf.laws",
    )
    yield refused(
        "laws that are no mapping",
        fit_with(laws=[laws.Dahl()]),
        "is not a mapping",
        "laws={",
    )
    yield refused(
        "the same term twice",
        fit_with(laws={1: [laws.PowerSeries(3), laws.Duffing()]}),
        "both hold the term 's'",
        "leave one out",
    )
    yield refused(
        "law at a sensor",
        fit_with(laws={"sensor a2": laws.LinearElastic()}),
        "not a place for a force law",
        "storey",
    )


def masses() -> Iterator[Kind]:
    """Known masses of no DOF, or that are none."""
    yield refused(
        "known mass of no DOF",
        fit_with(known_masses={4: 1.0}),
        "known_masses names DOF 4",
        "DOFs 1 to 3",
    )
    yield refused(
        "known mass below zero",
        fit_with(known_masses={1: -4.0}),
        "is not a mass",
        "kg",
    )
    yield refused(
        "known mass NaN", fit_with(known_masses={1: np.nan}), "is not a mass", "kg"
    )
    yield refused(
        "known mass as text",
        fit_with(known_masses={1: "ten"}),
        "'ten' is not a mass",
        "kg",
    )
    yield refused(
        "known masses as a list",
        fit_with(known_masses=[10, 12]),
        "is not a mapping",
        "known_masses={",
    )


def methods() -> Iterator[Kind]:
    """Strategies, estimators and optimizers that are none."""
    yield refused(
        "unknown strategy",
        fit_with(strategy="parallel"),
        "strategy='parallel'",
        "auto, complete, sequential, joint",
    )
    yield refused(
        "complete without the forces",
        fit_with(strategy="complete"),
        "none is measured on DOF 1, 3",
        "sequential",
    )
    yield refused(
        "unknown coordinates",
        fit_with(coordinates="polar"),
        "coordinates='polar'",
        "'relative' or 'absolute'",
    )
    yield refused(
        "unknown estimation", fit_with(estimation="magic"), "estimation='magic'", "ls"
    )
    yield refused(
        "chain that is none", fit_with(chain=3), "chain=3 is not a Chain", r"Chain\(3"
    )
    yield refused(
        "optimizer that is none",
        fit_with(optimizer="STLSQ"),
        "'STLSQ' is not an optimizer",
        "instance",
    )
    yield refused(
        "optimizer as a class",
        fit_with(optimizer=ps.STLSQ),
        "is not an optimizer",
        "instance",
    )
    yield refused(
        "a threshold that leaves nothing",
        fit_with(optimizer=ps.STLSQ(threshold=1e3)),
        "right-hand side is zero throughout",
        "lower its threshold",
    )
    yield refused(
        "constraints that are none",
        fit_with(constraints=["m1 > 0"]),
        "constraint",
        "Parameter",
    )


def bands() -> Iterator[Kind]:
    """Frequency bands and sampling steps."""
    X, F = features()
    uneven = np.maximum(TIME, 2 * TIME - 0.999)

    yield refused(
        "band without a clock",
        fit_with(band=(1, 50)),
        "band= needs the sampling step",
        "dt=",
    )
    yield refused(
        "band above Nyquist",
        fit_with(band=(1, 900), dt=1e-3),
        "not below the Nyquist frequency 500 Hz",
        "Lower it",
    )
    yield refused(
        "band upside down", fit_with(band=(50, 1), dt=1e-3), "is empty", "lo < hi"
    )
    yield refused(
        "band that is none", fit_with(band=40, dt=1e-3), "not a pair", r"\(lo, hi\)"
    )
    yield refused(
        "band of text", fit_with(band=("1 Hz", "50 Hz"), dt=1e-3), "band", "Hz"
    )
    yield refused(
        "band with NaN", fit_with(band=(np.nan, 50), dt=1e-3), "band", "Hz|lo"
    )
    yield refused(
        "band on an uneven clock",
        partial(NRFRegressor(band=(1, 50)).fit, X, F, time=uneven),
        "step changes after row 999",
        "Split",
    )
    for dt in (0, -1e-3, np.nan, np.inf, "1 ms", True):
        yield refused(
            f"dt {dt!r}", fit_with(dt=dt), "is not a sampling step", "positive"
        )


# -- what is warned of, and what no test can tell ------------------------------


def doubtful() -> Iterator[Kind]:
    """What can be computed, but is likely wrong: a warning says so."""
    X, F = features()
    clipped = np.hstack([X[:, :6], np.clip(X[:, 6:], -2e-3, 2e-3)])
    delayed = np.hstack([np.roll(X[:, :3], 3, axis=0), X[:, 3:]])

    def warned(name: str, call: partial, *words: str) -> Kind:
        return Kind(name, call, BiasWarning, words)

    yield warned(
        "force with the wrong sign",
        fit_force(-F),
        "m2 = -.* is not positive",
        "wrong sign",
    )
    yield warned(
        "acceleration with the wrong sign",
        fit_motion(changed(X, ALL_ROWS, 1, -X[:, 1])),
        "m2|balance of DOF 2|Balance of DOF 2",
    )
    yield warned(
        "two drifts swapped",
        fit_motion(X[:, [0, 1, 2, 3, 4, 5, 6, 8, 7]]),
        "likely biased",
    )
    yield warned(
        "two accelerations swapped",
        fit_motion(X[:, [2, 1, 0, 3, 4, 5, 6, 7, 8]]),
        "likely biased|not positive",
    )
    yield warned(
        "an acceleration copied from another",
        fit_motion(changed(X, ALL_ROWS, 2, X[:, 1])),
        "likely biased",
    )
    yield warned("displacement clipped", fit_motion(clipped), "likely biased")
    yield warned("absolute given as relative", fit_motion(absolute(X)), "likely biased")
    yield warned("acceleration delayed by 3 ms", fit_motion(delayed), "likely biased")
    yield warned("too low a degree", fit_with(degree=1), "likely biased")

    lost = changed(X, slice(500, None), 4, np.nan)
    yield Kind(
        "a sensor that fell out",
        fit_motion(lost),
        DataQualityWarning,
        (
            "leave 500 of .* rows; channel v2 is measured in 500",
            "Cut the record|leave v2 out",
        ),
    )


def one_sine() -> Iterator[Kind]:
    """Steady motion under one sine: drift, rate and acceleration are dependent."""
    t = np.arange(2000) * 1e-3
    omega = 2 * np.pi * 5.0
    mass = 10.0  # kg
    force = 100.0  # N
    dynamic = 4e4 - mass * omega * omega + 50j * omega  # N/m
    x = np.real(force / dynamic * np.exp(1j * omega * t))
    v = np.real(1j * omega * force / dynamic * np.exp(1j * omega * t))
    X = np.column_stack([-omega * omega * x, v, x])
    F = force * np.cos(omega * t)[:, None]

    yield Kind(
        "steady harmonic excitation",
        partial(NRFRegressor(degree=1).fit, X, F),
        IdentifiabilityError,
        (
            "m1 cannot be separated from a stiffness",
            "excite several frequencies",
        ),
    )
    yield Kind(
        "steady harmonic excitation, cubic, mass known",
        partial(NRFRegressor(degree=3, known_masses={1: mass}).fit, X, F),
        RankWarning,
        ("linearly dependent", "excite more frequencies"),
    )


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from shapes()
    yield from other_objects()
    yield from types()
    yield from names()
    yield from gaps()
    yield from sizes()
    yield from forces()
    yield from clocks()
    yield from metadata()
    yield from order_of_rows()
    yield from degrees()
    yield from force_laws()
    yield from masses()
    yield from methods()
    yield from bands()
    yield from doubtful()
    yield from one_sine()
