"""Checks of the arrays that users pass in: channels, record ids, times, and the input
of estimators.
"""

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..exceptions import ChannelError, ChannelTypeError, DataQualityWarning

_EDGES_LEAVE = 0.5  # share of the rows; a warning is given if the NaN edges leave less
GAP = 1.5  # a time step this many times the median step is a gap


def rows_text(rows: np.ndarray, most: int = 3) -> str:
    """Row numbers for a message, e.g. ``"rows 17, 18, 19 and 4 more"``."""
    shown = ", ".join(str(int(r)) for r in rows[:most])
    more = f" and {len(rows) - most} more" if len(rows) > most else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"


_NUMBERED = re.compile(r"([avxf])_?0*([1-9]\d*)", re.IGNORECASE)
_BASE = re.compile(r"([avx])(?:_?g|0)", re.IGNORECASE)


def channel_of(name: str) -> str | None:
    """Channel that a plain name means: ``a_01`` is a1, ``f2`` is F2, ``x0`` is xg,
    ``time`` is t; or None.
    """
    text = name.strip()
    if text.lower() in ("t", "time"):
        return "t"
    if match := _BASE.fullmatch(text):
        return match[1].lower() + "g"
    if match := _NUMBERED.fullmatch(text):
        return match[1].lower().replace("f", "F") + match[2]
    return None


def as_matrix(
    value: Any,
    names: Sequence[str] | str,
    n_columns: int | None = None,
    what: str = "channels",
) -> np.ndarray:
    """Real float matrix with one column per channel, or an error that names the
    channel.
    """
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)
    if hasattr(value, "nnz") and hasattr(value, "toarray"):
        raise ChannelError(
            f"The {what} are sparse, which is not supported",
            "Give a dense array: .toarray().",
        )
    if hasattr(value, "to_numpy"):
        value = value.to_numpy()
    layout = "Give one row per sample and one column per channel."
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        raise ChannelError(f"The {what} differ in length", layout) from None
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise ChannelError(f"The {what} have {array.ndim} dimensions", layout)

    def name(i: int) -> str:
        return f"{names}{i + 1}" if isinstance(names, str) else str(names[i])

    if n_columns is not None and array.shape[1] != n_columns:
        cure = (
            "Expected"
            f" {', '.join(name(i) for i in range(min(n_columns, 12)))}{', ...' if n_columns > 12 else ''}."
        )
        raise ChannelError(
            f"The {what} have {array.shape[1]} columns, {n_columns} are needed", cure
        )
    if array.dtype == np.float32 or array.dtype == np.float64:
        return array
    if np.iscomplexobj(array):
        cure = "Give real time series; take .real if the imaginary part is zero."
        raise ChannelError(
            f"Complex data not supported: channel {name(0)} of the {what} is complex",
            cure,
        )
    if array.dtype.kind == "b" and not what.startswith("covariate"):
        raise ChannelError(
            f"Channel {name(0)} of the {what} holds boolean values",
            "Give the measured numbers.",
        )
    if array.dtype == np.float16:
        lost = f"Channel {name(0)} of the {what} is float16, which holds three digits"
        warnings.warn(
            DataQualityWarning(lost, "Save the channels as float32 or float64."),
            stacklevel=2,
        )
    if array.dtype.kind in "biuf":
        return array.astype(np.float64)
    out = np.empty(array.shape)
    for i in range(array.shape[1]):
        try:
            if array.dtype.kind in "mMSV":  # NumPy would turn dates into nanoseconds
                raise TypeError
            with warnings.catch_warnings(
                action="error", category=np.exceptions.ComplexWarning
            ):
                out[:, i] = array[:, i].astype(np.float64)
        except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
            kind = (
                ChannelTypeError
                if isinstance(error, TypeError) and array.dtype == object
                else ChannelError
            )
            what = f"Channel {name(i)} of the {what} does not hold numbers" + (
                f" ({error})" if str(error) else ""
            )
            raise kind(what, "Convert it to float (decimal point, no text).") from None
    return out


def finite_span(
    columns: Sequence[np.ndarray], names: Sequence[str], record: str = ""
) -> slice:
    """Rows between the leading and trailing NaN edges; NaN or infinite values in
    between are errors.
    """
    where = f" of {record}" if record else ""
    n = len(columns[0]) if columns else 0
    first, last, shortest, worst = 0, n, n, ""
    for column, name in zip(columns, names):
        good = np.isfinite(column)
        if good.all():
            continue
        infinite = np.flatnonzero(np.isinf(column))
        if infinite.size:
            cure = "Repair or cut these rows."
            raise ChannelError(
                f"Channel {name}{where} is infinite in {rows_text(infinite)}", cure
            )
        inside = np.flatnonzero(good)
        if not inside.size:
            raise ChannelError(
                f"Channel {name}{where} holds nothing but NaN",
                "Leave it out, or measure it.",
            )
        start, stop = inside[0], inside[-1] + 1
        holes = start + np.flatnonzero(~good[start:stop])
        if holes.size:
            cure = (
                "Split the record there, or fill the gap; only leading and trailing NaN"
                " rows are masked."
            )
            raise ChannelError(
                f"Channel {name}{where} is NaN in {rows_text(holes)}", cure
            )
        first, last = max(first, start), min(last, stop)
        if stop - start < shortest:
            shortest, worst = stop - start, name
    if last - first < _EDGES_LEAVE * n:
        lost = (
            f"NaN at the edges leave {max(0, last - first)} of {n} rows{where}; channel"
            f" {worst} is measured in "
        )
        cure = f"Cut the record to the rows that count, or leave {worst} out."
        warnings.warn(
            DataQualityWarning(f"{lost}{shortest} of them", cure), stacklevel=2
        )
    return slice(first, max(first, last))


# Numbers of either sign that loggers, weather and earthquake programs write where
# nothing was measured.
_FILLERS = np.array(
    [
        999.0,
        999.25,
        9999.0,
        99999.0,
        999999.0,
        9999999.0,
        1e30,
        1e35,
        1e37,
        9.9e37,
        1e38,
    ]
)
FILLED = (
    "Leave those cells empty (NaN); inside a record, split it there"
    " (signals.alignment.split_at_gaps) or fill the gap."
)
# a filler exceeds all other values by this factor; real peaks have neighbours of
# similar size
_APART = 5.0


def fillers(line: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows that hold a filler such as -9999 for "not measured", far beyond all other
    values, and a text on them.
    """
    none = np.zeros(0, dtype=int), ""
    size = np.abs(line)
    most = np.fmax.reduce(size, initial=0.0)
    if not np.isclose(_FILLERS, most, rtol=1e-6, atol=0.0).any():
        return none
    rows = np.flatnonzero(size == most)
    others = np.where(size < most, size, 0.0).max()
    by_chance = len(rows) == 1 and line[rows[0]] > 0  # a single impact may reach 999 N
    if by_chance or others * _APART > most or 2 * len(rows) > len(line):
        return none
    said = (
        f"{line[rows[0]]:g} in {rows_text(rows)}, far beyond all others: a number that"
        " stands for 'not measured'"
    )
    return rows, said


def rate_of(step: float, tolerance: float = 1e-6) -> float:
    """Sampling rate, Hz, of a step in s; a whole number if rounding of the step
    explains the difference.
    """
    rate = 1.0 / step
    return (
        float(round(rate))
        if abs(rate - round(rate)) < tolerance * rate
        else float(rate)
    )


def by_record(record: Any, size: int) -> list[tuple[str, slice]]:
    """Name and rows of each record, from one id per sample."""
    if record is None or not size:
        return [("record", slice(0, size))]
    ids = np.asarray(record).ravel()
    if len(ids) != size:
        raise ChannelError(
            f"record has {len(ids)} ids, X has {size} samples",
            "Give one id for each sample.",
        )
    lost = np.flatnonzero(pd.isna(ids))
    if lost.size:
        raise ChannelError(
            f"record has no id in {rows_text(lost)}", "Give one id for each sample."
        )
    return [
        (str(ids[rows.start]), rows)
        for rows in _between(np.flatnonzero(ids[1:] != ids[:-1]) + 1, 0, size)
    ]


def gaps(seconds: np.ndarray) -> np.ndarray:
    """Rows after which the clock of one record jumps."""
    steps = np.diff(seconds)
    return (
        np.flatnonzero(steps > GAP * np.median(steps))
        if len(steps) > 2
        else np.zeros(0, dtype=int)
    )


def contiguous(
    size: int, record: Any = None, seconds: np.ndarray | None = None
) -> list[tuple[str, slice]]:
    """Name and rows of each piece that has one record id and a clock without a gap."""
    pieces = by_record(record, size)
    if seconds is None:
        return pieces
    return [
        (name, piece)
        for name, rows in pieces
        for piece in _between(
            rows.start + gaps(seconds[rows]) + 1, rows.start, rows.stop
        )
    ]


def _between(cuts: np.ndarray, start: int, stop: int) -> list[slice]:
    edges = [start, *cuts.tolist(), stop]
    return [slice(lo, hi) for lo, hi in zip(edges[:-1], edges[1:])]


def column_names(X: Any) -> list[str] | None:
    """Names of the columns of a table, None for an array."""
    return [str(c) for c in X.columns] if hasattr(X, "columns") else None


def checked(
    estimator: Any, X: Any, *, reset: bool, prefix: str = "column "
) -> np.ndarray:
    """Input of an estimator as a float matrix, its columns compared with those of
    ``fit``.
    """
    names = column_names(X)
    require_two_dimensions(X)
    matrix = as_matrix(X, names or prefix, what="columns of X")
    if (
        matrix.shape[1] == 0
    ):  # in the words that scikit-learn's checks expect, here and below
        cure = "Give one column per channel."
        raise ChannelError(
            f"X has 0 feature(s) (shape={matrix.shape}) while a minimum of 1 is"
            " required",
            cure,
        )
    if len(matrix) == 0:
        raise ChannelError("X has no samples (0 rows)", "Give a record.")
    same_columns(estimator, matrix.shape[1], names, reset)
    return matrix


def same_columns(
    estimator: Any, width: int, names: list[str] | None, reset: bool
) -> None:
    """Store the columns on the estimator (reset), or compare them with those of
    ``fit``.
    """
    if reset:
        estimator.n_features_in_ = width
        if names is not None:
            estimator.feature_names_in_ = np.array(names, dtype=object)
        elif hasattr(estimator, "feature_names_in_"):
            del estimator.feature_names_in_
        return
    if width != estimator.n_features_in_:
        expected = (
            f"{type(estimator).__name__} is expecting {estimator.n_features_in_}"
            " features as input"
        )
        raise ChannelError(
            f"X has {width} features, but {expected}", "Give the columns of fit."
        )
    fitted = getattr(estimator, "feature_names_in_", None)
    if names is not None and fitted is not None and names != list(fitted):
        cure = "Fit again."
        raise ChannelError(
            f"The columns {', '.join(names[:9])} are not those of fit,"
            f" {', '.join(fitted[:9])}",
            cure,
        )


def require_two_dimensions(X: Any) -> None:
    """Refuse a single column given without its second dimension."""
    if isinstance(X, (list, tuple)):
        flat = len(X) > 0 and isinstance(X[0], (int, float, np.number))
    else:
        flat = (
            not hasattr(X, "columns")
            and not hasattr(X, "nnz")
            and np.ndim(np.asarray(X)) == 1
        )
    if flat:
        cure = (
            "Reshape your data: X.reshape(-1, 1) if it is one channel, X.reshape(1, -1)"
            " if it is one sample."
        )
        raise ChannelError("Expected a 2D array, got a 1D array", cure)


def is_dask(X: Any) -> bool:
    """True for a Dask array, table or delayed value; Dask is not imported."""
    return hasattr(X, "__dask_graph__")


def sample_weights(weights: Any, size: int) -> np.ndarray:
    """Weights of the samples, ones if None."""
    if weights is None:
        return np.ones(size)
    line = as_matrix(weights, ["sample_weight"], 1, "weights")[:, 0].astype(float)
    if len(line) != size:
        raise ChannelError(
            f"sample_weight has {len(line)} values, X has {size} samples",
            "Give one for each sample.",
        )
    if not np.isfinite(line).all() or (line < 0).any() or not line.any():
        cure = "Give numbers from zero up, not all zero."
        raise ChannelError(
            "sample_weight holds values that are not valid weights", cure
        )
    return line
