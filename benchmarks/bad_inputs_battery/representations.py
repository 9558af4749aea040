"""Good numbers in an unusual form: the right answer, or a warning of the cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import DataQualityWarning

from .kind import Kind
from .material import NAMES, features, table

EXACT = 1e-12  # relative error of the masses


def fit(X: Any, F: Any) -> NRFRegressor:
    return NRFRegressor(degree=(1, 3)).fit(X, F)


@cache
def masses() -> np.ndarray:
    """Masses from float64 arrays."""
    return fit(*features()).masses_


def right(tolerance: float) -> Callable[[NRFRegressor], bool]:
    """Whether the masses are those that float64 arrays give."""

    def equal(model: NRFRegressor) -> bool:
        return np.allclose(model.masses_, masses(), rtol=tolerance, atol=0)

    return equal


def equal_to_floats(counts: np.ndarray, F: np.ndarray) -> bool:
    """Whether whole numbers give the masses of the same numbers as floats."""
    floats = fit(counts.astype(float), F)
    return np.array_equal(fit(counts, F).masses_, floats.masses_)


def strided(array: np.ndarray) -> np.ndarray:
    """A view of every second row and column of a larger array."""
    wide = np.full((2 * array.shape[0], 2 * array.shape[1]), np.nan)
    wide[::2, ::2] = array
    return wide[::2, ::2]


def frozen(array: np.ndarray) -> np.ndarray:
    """A copy that cannot be written to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def with_edges(X: np.ndarray) -> np.ndarray:
    """NaN at both ends, as a filter leaves them."""
    out = X.copy()
    out[:40] = np.nan
    out[-40:] = np.nan
    return out


def kinds() -> Iterator[Kind]:
    """All kinds of this room."""
    yield from arrays()
    yield from tables()
    yield from coarse_numbers()


def arrays() -> Iterator[Kind]:
    """Arrays of another layout in memory or type."""
    X, F = features()
    reversed_twice = np.asfortranarray(X)[::-1][::-1]

    def kind(name: str, X: Any, F: Any = F, tolerance: float = EXACT) -> Kind:
        return Kind(name, partial(fit, X, F), right(tolerance))

    yield kind("not contiguous", strided(X), strided(F))
    yield kind("reversed in memory", reversed_twice)
    yield kind("read-only", frozen(X), frozen(F))
    yield kind("column-major", np.asfortranarray(X), np.asfortranarray(F))
    yield kind("big-endian", X.astype(">f8"), F.astype(">f8"))
    yield kind("objects that are numbers", X.astype(object), F.astype(object))
    yield kind("numbers as text", X.astype("U32"))
    yield kind("long double", X.astype(np.longdouble))
    yield kind("masked array without a masked sample", np.ma.masked_array(X))
    yield kind("lists of lists", X.tolist(), F.tolist())
    yield kind("a subclass of ndarray", np.asmatrix(X))
    yield kind("NaN at the edges", with_edges(X), tolerance=1e-6)


def tables() -> Iterator[Kind]:
    """Tables with another order, type or index."""
    frame = table()
    forces = pd.DataFrame(features()[1], columns=["F1", "F2", "F3"])
    late = pd.Index(np.arange(len(frame)) + 7)

    def kind(name: str, X: pd.DataFrame, F: pd.DataFrame) -> Kind:
        return Kind(name, partial(fit, X, F), right(EXACT))

    yield kind(
        "a table in another order of columns",
        frame[NAMES[::-1]],
        forces[["F3", "F1", "F2"]],
    )
    yield kind(
        "a table with nullable numbers",
        frame.astype("Float64"),
        forces.astype("Float64"),
    )
    yield kind(
        "a table with an index of its own",
        frame.set_axis(late),
        forces.set_axis(late),
    )


def coarse_numbers() -> Iterator[Kind]:
    """Numbers of few digits."""
    X, F = features()
    counts = np.round(X * 2.0**20).astype(np.int64)

    single = partial(fit, X.astype(np.float32), F)
    yield Kind("float32", single, right(1e-3))
    yield Kind(
        "integers (counts of a converter)",
        partial(equal_to_floats, counts, F),
        lambda equal: equal,
    )
    yield Kind(
        "float16",
        partial(fit, X.astype(np.float16), F),
        DataQualityWarning,
        ("Channels? a1.*three digits|float16", "float32|float64"),
    )
