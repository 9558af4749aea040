"""Good numbers in an unusual form: the right answer, or a word of what the form
cost.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from pysindy_nrf import NRFRegressor
from pysindy_nrf.exceptions import DataQualityWarning

from .kind import Kind
from .material import NAMES, features, table


@cache
def expected() -> np.ndarray:
    """Masses from float64 arrays."""
    X, F = features()
    return NRFRegressor(degree=(1, 3)).fit(X, F).masses_


def fit(X: Any, F: Any) -> NRFRegressor:
    return NRFRegressor(degree=(1, 3)).fit(X, F)


def right(tolerance: float = 1e-12) -> Callable[[NRFRegressor], bool]:
    """Whether the masses are those that float64 arrays give."""
    return lambda model: bool(
        np.allclose(model.masses_, expected(), rtol=tolerance, atol=0)
    )


def strided(array: np.ndarray) -> np.ndarray:
    """A view of every second row and column of a larger array."""
    wide = np.full((2 * array.shape[0], 2 * array.shape[1]), np.nan)
    wide[::2, ::2] = array
    return wide[::2, ::2]


def frozen(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


def kinds() -> list[Kind]:
    """All kinds of this room."""
    X, F = features()
    frame, forces = table(), pd.DataFrame(F, columns=["F1", "F2", "F3"])
    late = pd.Index(np.arange(len(X)) + 7)
    forms = {
        "not contiguous": (strided(X), strided(F)),
        "reversed in memory": (np.asfortranarray(X)[::-1][::-1], F),
        "read-only": (frozen(X.copy()), frozen(F.copy())),
        "column-major": (np.asfortranarray(X), np.asfortranarray(F)),
        "big-endian": (X.astype(">f8"), F.astype(">f8")),
        "objects that are numbers": (X.astype(object), F.astype(object)),
        "numbers as text": (X.astype("U32"), F),
        "long double": (X.astype(np.longdouble), F),
        "masked array without a masked sample": (np.ma.masked_array(X), F),
        "lists of lists": (X.tolist(), F.tolist()),
        "a subclass of ndarray": (np.asmatrix(X), F),
        "a table in another order of columns": (
            frame[NAMES[::-1]],
            forces[["F3", "F1", "F2"]],
        ),
        "a table with nullable numbers": (
            frame.astype("Float64"),
            forces.astype("Float64"),
        ),
        "a table with an index of its own": (
            frame.set_axis(late),
            forces.set_axis(late),
        ),
        "NaN at the edges": (edged(X), F),
    }
    out = [
        Kind(
            "representation",
            name,
            fit,
            given,
            right(1e-6 if name.startswith("NaN") else 1e-12),
        )
        for name, given in forms.items()
    ]
    out.append(
        Kind("representation", "float32", fit, (X.astype(np.float32), F), right(1e-3))
    )
    whole = np.round(X * 2.0**20)
    out.append(
        Kind(
            "representation",
            "integers (counts of a converter)",
            lambda counts, F: (fit(counts, F), fit(counts.astype(float), F)),
            (whole.astype(np.int64), F),
            lambda pair: bool(np.array_equal(pair[0].masses_, pair[1].masses_)),
        )
    )
    out.append(
        Kind(
            "representation",
            "float16",
            fit,
            (X.astype(np.float16), F),
            DataQualityWarning,
            ("Channels? a1.*three digits|float16", "float32|float64"),
        )
    )
    return out


def edged(X: np.ndarray) -> np.ndarray:
    """As a filter leaves it."""
    out = X.copy()
    out[:40], out[-40:] = np.nan, np.nan
    return out
