"""Bad input to ``close_loop``, detection, comparison and the rest of the search."""

# ruff: noqa: E501

from __future__ import annotations

from typing import Any

import numpy as np

from pysindy_nrf import NRFRegressor, Record, close_loop, compare_with_sindy, laws
from pysindy_nrf.discrepancy.residual import detect
from pysindy_nrf.exceptions import NRFError

from .kind import Kind
from .material import STEP, channels, features, good


def loop(records: Any, **options: Any) -> tuple:
    return lambda records, o: close_loop(records, **{"max_steps": 1} | o), (
        records,
        options,
    )


def kinds() -> list[Kind]:
    """All kinds of this room."""
    rec = good(0.01, 4000)
    short = Record(
        **{k: v[:40] if isinstance(v, np.ndarray) else v for k, v in channels().items()}
    )
    two = Record(
        rec.force[:, :2], rec.acceleration[:, :2], fs=1e3, name="of two floors"
    )
    idle = Record(acceleration=rec.acceleration, displacement=rec.displacement, fs=1e3)
    X, F = features()
    rows = {
        "no record": (loop([]), "no record to search", "Pass a Record"),
        "arrays for records": (loop(X), "not a Record", "Record"),
        "nothing for records": (loop(None), "no record to search", "Pass a Record"),
        "records of two chains": (
            loop([rec, two]),
            "has 2 DOFs, 3 are needed",
            "one chain",
        ),
        "a held-out record of another chain": (
            loop(rec, heldout=two),
            "has 2 DOFs, 3 are needed",
            "one chain",
        ),
        "a held-out array": (
            loop(rec, heldout=X),
            "heldout holds something that is not a Record",
            "Build",
        ),
        "a record of 40 ms": (loop(short), "too short to be split", "longer records"),
        "no force and no known mass": (
            loop(idle),
            "No force is measured",
            "known_masses",
        ),
        "band above Nyquist": (loop(rec, band=(1, 900)), "Nyquist", "Lower"),
        "band upside down": (loop(rec, band=(50, 1)), "is empty", "lo < hi"),
        "band that is none": (loop(rec, band="all"), "not a pair", r"\(lo, hi\)"),
        "a catalogue of words": (
            loop(rec, catalogue=["friction"]),
            "friction",
            "pysindy_nrf.laws|ForceLaw|law",
        ),
        "a catalogue that is a number": (loop(rec, catalogue=3), "catalogue", "law"),
        "a baseline that is none": (
            loop(rec, baseline="linear"),
            "baseline",
            "NRFRegressor",
        ),
        "a baseline for another chain": (
            loop(rec, baseline=NRFRegressor(laws={9: laws.LinearElastic()})),
            "'storey 9' does not exist",
            "storey 1",
        ),
        "a baseline without degree": (
            loop(rec, baseline=NRFRegressor(degree=-1)),
            "is not a whole number",
            "Give",
        ),
        "half a step": (loop(rec, max_steps=0.5), "max_steps=0.5", "whole number"),
        "minus one step": (loop(rec, max_steps=-1), "max_steps=-1", "whole number"),
        "a seed in words": (
            loop(rec, random_state="lucky"),
            "random_state='lucky' is no seed",
            "whole number .*Generator",
        ),
        "detection on arrays": (
            (lambda X: detect(NRFRegressor().fit(*features()).model_, X), (X,)),
            "is not a residual",
            "residual_of",
        ),
        "comparison without a clock": (
            (lambda X, F: compare_with_sindy(X, F, dt=0.0), (X, F)),
            "dt",
            "positive|s",
        ),
        "comparison of other lengths": (
            (lambda X, F: compare_with_sindy(X, F, dt=STEP), (X, F[:-5])),
            "F has 1495 samples",
            "same clock",
        ),
        "comparison with a gap": (
            (
                lambda X, F: compare_with_sindy(X, F, dt=STEP),
                (np.where(X == X[50, 2], np.nan, X), F),
            ),
            "a3 is NaN in row 50",
            "Split",
        ),
    }
    return [
        Kind("loop", name, act, given, NRFError, tuple(words))
        for name, ((act, given), *words) in rows.items()
    ]
