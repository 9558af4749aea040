"""Bad input to ``close_loop``, detection and comparison."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from pysindy_nrf import NRFRegressor, Record, close_loop, compare_with_sindy, laws
from pysindy_nrf.diagnosis.evidence import detect

from .kind import Kind, refused
from .material import STEP, features, good


def loop(records: Any, **options: Any) -> partial:
    """A closed loop of one step at most."""
    return partial(close_loop, records, **({"max_steps": 1} | options))


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from records()
    yield from settings()
    yield from comparisons()


def records() -> Iterator[Kind]:
    """What is searched or held out."""
    record = good(0.01, 4000)
    X, _ = features()
    of_two_floors = Record(
        record.force[:, :2], record.acceleration[:, :2], fs=1e3, name="of two floors"
    )
    idle = Record(
        acceleration=record.acceleration, displacement=record.displacement, fs=1e3
    )

    yield refused("no record", loop([]), "no record to search", "Pass a Record")
    yield refused("arrays for records", loop(X), "not a Record", "Record")
    yield refused(
        "nothing for records", loop(None), "no record to search", "Pass a Record"
    )
    yield refused(
        "records of two chains",
        loop([record, of_two_floors]),
        "has 2 DOFs, 3 are needed",
        "one chain",
    )
    yield refused(
        "a held-out record of another chain",
        loop(record, heldout=of_two_floors),
        "has 2 DOFs, 3 are needed",
        "one chain",
    )
    yield refused(
        "a held-out array",
        loop(record, heldout=X),
        "heldout holds something that is not a Record",
        "Build",
    )
    yield refused(
        "a record of 40 ms",
        loop(good().rows(slice(0, 40))),
        "too short to be split",
        "longer records",
    )
    yield refused(
        "no force and no known mass",
        loop(idle),
        "No force is measured",
        "known_masses",
    )


def settings() -> Iterator[Kind]:
    """Band, catalogue, baseline and seed of the search."""
    record = good(0.01, 4000)
    elsewhere = NRFRegressor(laws={9: laws.LinearElastic()})

    yield refused("band above Nyquist", loop(record, band=(1, 900)), "Nyquist", "Lower")
    yield refused("band upside down", loop(record, band=(50, 1)), "is empty", "lo < hi")
    yield refused(
        "band that is none", loop(record, band="all"), "not a pair", r"\(lo, hi\)"
    )
    yield refused(
        "a catalogue of words",
        loop(record, catalogue=["friction"]),
        "friction",
        "pysindy_nrf.laws|ForceLaw|law",
    )
    yield refused(
        "a catalogue that is a number", loop(record, catalogue=3), "catalogue", "law"
    )
    yield refused(
        "a baseline that is none",
        loop(record, baseline="linear"),
        "baseline",
        "NRFRegressor",
    )
    yield refused(
        "a baseline for another chain",
        loop(record, baseline=elsewhere),
        "'storey 9' does not exist",
        "storey 1",
    )
    yield refused(
        "a baseline without degree",
        loop(record, baseline=NRFRegressor(degree=-1)),
        "is not a whole number",
        "Give",
    )
    yield refused(
        "half a step", loop(record, max_steps=0.5), "max_steps=0.5", "whole number"
    )
    yield refused(
        "minus one step", loop(record, max_steps=-1), "max_steps=-1", "whole number"
    )
    yield refused(
        "a seed in words",
        loop(record, random_state="lucky"),
        "random_state='lucky' is no seed",
        "whole number .*Generator",
    )


def detected(X: np.ndarray) -> Any:
    """Detection on motions in place of a residual."""
    return detect(NRFRegressor().fit(*features()).model_, X)


def comparisons() -> Iterator[Kind]:
    """Detection and the comparison with SINDy."""
    X, F = features()
    with_gap = np.where(X == X[50, 2], np.nan, X)

    yield refused(
        "detection on arrays",
        partial(detected, X),
        "is not a residual",
        "residual_of",
    )
    yield refused(
        "comparison without a clock",
        partial(compare_with_sindy, X, F, dt=0.0),
        "dt",
        "positive|s",
    )
    yield refused(
        "comparison of other lengths",
        partial(compare_with_sindy, X, F[:-5], dt=STEP),
        "F has 1495 samples",
        "same clock",
    )
    yield refused(
        "comparison with a gap",
        partial(compare_with_sindy, with_gap, F, dt=STEP),
        "a3 is NaN in row 50",
        "Split",
    )
