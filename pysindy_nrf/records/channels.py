"""Checks of the arrays that users pass in: channels, record ids, estimators' input."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ..common.warn import warn_user
from ..exceptions import ChannelError, ChannelTypeError, DataQualityWarning

if TYPE_CHECKING:
    from sklearn.base import BaseEstimator

MAX_ROWS_SHOWN = 3  # of a message
MAX_COLUMNS_SHOWN = 12


def rows_text(rows: np.ndarray) -> str:
    """Row numbers for a message, e.g. ``"rows 17, 18, 19 and 4 more"``."""
    noun = "rows" if len(rows) > 1 else "row"
    shown = ", ".join(str(int(row)) for row in rows[:MAX_ROWS_SHOWN])
    hidden = len(rows) - MAX_ROWS_SHOWN
    more = f" and {hidden} more" if hidden > 0 else ""
    return f"{noun} {shown}{more}"


_NUMBERED = re.compile(r"([avxf])_?0*([1-9]\d*)", re.IGNORECASE)
_BASE = re.compile(r"([avx])(?:_?g|0)", re.IGNORECASE)


def channel_of(name: str) -> str | None:
    """Channel that a plain name means, or None.

    ``a_01`` is a1, ``f2`` is F2, ``x0`` is xg, ``time`` is t.
    """
    text = name.strip()
    if text.lower() in ("t", "time"):
        return "t"

    base = _BASE.fullmatch(text)
    if base:
        return base[1].lower() + "g"

    numbered = _NUMBERED.fullmatch(text)
    if numbered:
        letter = numbered[1].lower().replace("f", "F")
        return letter + numbered[2]
    return None


def as_matrix(
    value: ArrayLike,
    names: Sequence[str] | str,
    n_columns: int | None = None,
    what: str = "channels",
) -> np.ndarray:
    """Real float matrix with one column per channel.

    Parameters
    ----------
    value : array-like of shape (n_samples,) or (n_samples, n_columns)
    names : str or sequence of str
        Names of the columns, or the letter before their number; for messages.
    n_columns : int, optional
        The number of columns that is needed.
    what : str
        What the columns are; for messages.

    Returns
    -------
    ndarray of shape (n_samples, n_columns)
        Single precision stays single; everything else becomes double.

    Raises
    ------
    ChannelError
        If the layout is another one, or a channel does not hold real numbers.
    """
    array = _two_dimensional(value, what)
    if n_columns is not None and array.shape[1] != n_columns:
        raise _wrong_width(array.shape[1], n_columns, names, what)

    if array.dtype == np.float32 or array.dtype == np.float64:
        return array

    if array.shape[1]:
        _check_kind(array, _column_name(names, 0), what)
    if array.dtype.kind in "biuf":
        return array.astype(np.float64)

    numbers = np.empty(array.shape)
    for i in range(array.shape[1]):
        channel = f"Channel {_column_name(names, i)} of the {what}"
        numbers[:, i] = _numbers_of(array[:, i], channel)
    return numbers


def _two_dimensional(value: ArrayLike, what: str) -> np.ndarray:
    """The value as an array of rows and columns."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)
    if hasattr(value, "nnz") and hasattr(value, "toarray"):
        raise ChannelError(
            f"The {what} are sparse, which is not supported",
            "Give a dense array: .toarray().",
        )
    value = as_pandas(value)
    if isinstance(value, (pd.DataFrame, pd.Series)):
        value = _numpy_of_pandas(value)
    elif hasattr(value, "to_numpy"):
        value = value.to_numpy()

    layout = "Give one row per sample and one column per channel."
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        raise ChannelError(f"The {what} differ in length", layout) from None

    if array.ndim == 1:
        return array[:, None]
    if array.ndim != 2:
        raise ChannelError(f"The {what} have {array.ndim} dimensions", layout)
    return array


def as_pandas(table: object) -> Any:
    """A table of polars or Arrow, or a labelled xarray, as a table of pandas.

    Anything else is returned as it is.
    """
    library = type(table).__module__.partition(".")[0]
    kind = type(table).__name__
    value: Any = table
    if library == "pyarrow" and hasattr(value, "to_pandas"):
        return value.to_pandas()
    if library == "polars":
        value = value.collect() if kind == "LazyFrame" else value
        if hasattr(value, "columns"):
            return pd.DataFrame(
                {name: value[name].to_numpy() for name in value.columns}
            )
    if library == "xarray":
        return value.to_dataframe() if kind == "Dataset" else _labelled_table(value)
    return value


def _labelled_table(array: Any) -> Any:
    """A two-dimensional xarray with names along its columns as a table."""
    labels = array.indexes.get(array.dims[-1]) if array.ndim == 2 else None
    if labels is None or labels.dtype.kind not in "OUT":
        return array.to_numpy()
    rows = array.indexes.get(array.dims[0])
    return pd.DataFrame(array.to_numpy(), index=rows, columns=labels)


def _numpy_of_pandas(table: pd.DataFrame | pd.Series) -> np.ndarray:
    """Values of a table; empty cells of nullable numbers are NaN."""
    dtypes = table.dtypes if isinstance(table, pd.DataFrame) else [table.dtype]
    is_nullable = any(isinstance(d, pd.api.extensions.ExtensionDtype) for d in dtypes)
    if is_nullable and all(pd.api.types.is_numeric_dtype(d) for d in dtypes):
        return table.to_numpy(dtype=float, na_value=np.nan)
    return table.to_numpy()


def _column_name(names: Sequence[str] | str, i: int) -> str:
    """Name of a column; names may be the letter before their numbers."""
    return f"{names}{i + 1}" if isinstance(names, str) else str(names[i])


def _wrong_width(
    width: int, n_columns: int, names: Sequence[str] | str, what: str
) -> ChannelError:
    """Error for a number of columns other than the one needed."""
    shown = min(n_columns, MAX_COLUMNS_SHOWN)
    expected = ", ".join(_column_name(names, i) for i in range(shown))
    more = ", ..." if n_columns > shown else ""
    return ChannelError(
        f"The {what} have {width} columns, {n_columns} are needed",
        f"Expected {expected}{more}.",
    )


def _check_kind(array: np.ndarray, name: str, what: str) -> None:
    """Refuse complex and boolean arrays; warn of half precision.

    A covariate may be boolean: a valve is open or closed.
    """
    channel = f"{name} of the {what}"
    if np.iscomplexobj(array):
        raise ChannelError(
            f"Complex data not supported: channel {channel} is complex",
            "Give real time series; take .real if the imaginary part is zero.",
        )
    if array.dtype.kind == "b" and not what.startswith("covariate"):
        raise ChannelError(
            f"Channel {channel} holds boolean values", "Give the measured numbers."
        )
    if array.dtype == np.float16:
        lost = f"Channel {channel} is float16, which holds three digits"
        cure = "Save the channels as float32 or float64."
        warn_user(DataQualityWarning(lost, cure))


def _numbers_of(column: np.ndarray, channel: str) -> np.ndarray:
    """Objects or texts as floats."""
    cure = "Convert it to float (decimal point, no text)."
    if column.dtype.kind in "mMSV":  # NumPy would turn dates into nanoseconds
        raise ChannelError(f"{channel} does not hold numbers", cure)

    try:
        with warnings.catch_warnings(
            action="error", category=np.exceptions.ComplexWarning
        ):
            return column.astype(np.float64)
    except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
        is_object = isinstance(error, TypeError) and column.dtype == object
        kind = ChannelTypeError if is_object else ChannelError
        reason = f" ({error})" if str(error) else ""
        raise kind(f"{channel} does not hold numbers{reason}", cure) from None


MIN_SHARE_BETWEEN_EDGES = 0.5  # of the rows; a warning is given if fewer are left


def finite_span(
    columns: Sequence[np.ndarray], names: Sequence[str], record: str = ""
) -> slice:
    """Rows between the leading and trailing NaN edges of some channels.

    Parameters
    ----------
    columns : sequence of ndarray of shape (n_samples,)
    names : sequence of str
    record : str
        Name of the record, for messages.

    Returns
    -------
    slice
        The rows in which all channels are measured.

    Raises
    ------
    ChannelError
        If a channel is infinite, or NaN between two measured values or throughout.
    """
    if not columns:
        return slice(0, 0)

    where = f" of {record}" if record else ""
    n = len(columns[0])
    spans = [
        _measured_span(column, f"Channel {name}{where}")
        for column, name in zip(columns, names)
    ]
    first = max(span.start for span in spans)
    last = min(span.stop for span in spans)

    if last - first < MIN_SHARE_BETWEEN_EDGES * n:
        sizes = [span.stop - span.start for span in spans]
        shortest = int(np.argmin(sizes))
        channel = names[shortest]
        lost = (
            f"NaN at the edges leave {max(0, last - first)} of {n} rows{where}; channel"
            f" {channel} is measured in {sizes[shortest]} of them"
        )
        cure = f"Cut the record to the rows that count, or leave {channel} out."
        warn_user(DataQualityWarning(lost, cure))
    return slice(first, max(first, last))


def _measured_span(column: np.ndarray, channel: str) -> slice:
    """Rows of one channel between its NaN edges."""
    finite = np.isfinite(column)
    if finite.all():
        return slice(0, len(column))

    infinite = np.flatnonzero(np.isinf(column))
    if infinite.size:
        raise ChannelError(
            f"{channel} is infinite in {rows_text(infinite)}",
            "Repair or cut these rows.",
        )

    measured = np.flatnonzero(finite)
    if not measured.size:
        raise ChannelError(
            f"{channel} holds nothing but NaN", "Leave it out, or measure it."
        )

    start = int(measured[0])
    stop = int(measured[-1]) + 1
    holes = start + np.flatnonzero(~finite[start:stop])
    if holes.size:
        raise ChannelError(
            f"{channel} is NaN in {rows_text(holes)}",
            "Split the record there, or fill the gap; only leading and trailing NaN"
            " rows are masked.",
        )
    return slice(start, stop)


# Numbers of either sign that loggers, weather and earthquake programs write where
# nothing was measured.
_FILLERS = np.array(
    [999.0, 999.25, 9999.0, 99999.0, 999999.0, 9999999.0]
    + [1e30, 1e35, 1e37, 9.9e37, 1e38]
)
FILLED = (
    "Leave those cells empty (NaN); inside a record, split it there"
    " (alignment.split_at_gaps) or fill the gap."
)
# A filler exceeds all other values by this factor; real peaks have neighbours of
# similar size.
MIN_FILLER_RATIO = 5.0


def fillers(line: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows that hold a number such as -9999 for "not measured", and a text on them.

    The number must lie far beyond all other values of the channel.
    """
    none = np.zeros(0, dtype=int), ""
    size = np.abs(line)
    largest = np.fmax.reduce(size, initial=0.0)
    if not np.isclose(_FILLERS, largest, rtol=1e-6, atol=0.0).any():
        return none

    rows = np.flatnonzero(size == largest)
    value = line[rows[0]]
    single_impact = len(rows) == 1 and value > 0  # which may reach 999 N by chance
    fills_most = 2 * len(rows) > len(line)
    second_largest = np.where(size < largest, size, 0.0).max()
    if single_impact or fills_most or second_largest * MIN_FILLER_RATIO > largest:
        return none

    return rows, (
        f"{value:g} in {rows_text(rows)}, far beyond all others: a number that stands"
        " for 'not measured'"
    )


def by_record(record: ArrayLike | None, size: int) -> list[tuple[str, slice]]:
    """Name and rows of each record, from one id per sample."""
    if record is None or not size:
        return [("record", slice(0, size))]

    ids = np.asarray(record).ravel()
    cure = "Give one id for each sample."
    if len(ids) != size:
        raise ChannelError(f"record has {len(ids)} ids, X has {size} samples", cure)

    missing = np.flatnonzero(pd.isna(ids))
    if missing.size:
        raise ChannelError(f"record has no id in {rows_text(missing)}", cure)

    starts = np.flatnonzero(ids[1:] != ids[:-1]) + 1
    return [(str(ids[rows.start]), rows) for rows in _between(starts, 0, size)]


GAP = 1.5  # a time step this many times the median step is a gap


def gaps(seconds: np.ndarray) -> np.ndarray:
    """Rows after which the clock of one record jumps."""
    steps = np.diff(seconds)
    if len(steps) <= 2:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(steps > GAP * np.median(steps))


def contiguous(
    size: int, record: ArrayLike | None = None, seconds: np.ndarray | None = None
) -> list[tuple[str, slice]]:
    """Name and rows of each piece that has one record id and a clock without a gap."""
    records = by_record(record, size)
    if seconds is None:
        return records

    pieces = []
    for name, rows in records:
        cuts = rows.start + gaps(seconds[rows]) + 1
        for piece in _between(cuts, rows.start, rows.stop):
            pieces.append((name, piece))
    return pieces


def _between(cuts: np.ndarray, start: int, stop: int) -> list[slice]:
    """Slices from start to stop, cut at some rows."""
    edges = [start, *cuts.tolist(), stop]
    return [slice(low, high) for low, high in zip(edges[:-1], edges[1:])]


def column_names(X: object) -> list[str] | None:
    """Names of the columns of a table, None for an array."""
    return [str(column) for column in X.columns] if hasattr(X, "columns") else None


def checked(
    estimator: BaseEstimator, X: ArrayLike, *, reset: bool, prefix: str = "column "
) -> np.ndarray:
    """Input of an estimator as a float matrix, compared with the columns of ``fit``."""
    names = column_names(X)
    require_two_dimensions(X)
    matrix = as_matrix(X, names or prefix, what="columns of X")

    # in the words that scikit-learn's checks expect, here and below
    if matrix.shape[1] == 0:
        raise ChannelError(
            f"X has 0 feature(s) (shape={matrix.shape}) while a minimum of 1 is"
            " required",
            "Give one column per channel.",
        )
    if len(matrix) == 0:
        raise ChannelError("X has no samples (0 rows)", "Give a record.")

    same_columns(estimator, matrix.shape[1], names, reset)
    return matrix


def same_columns(
    estimator: BaseEstimator, width: int, names: list[str] | None, reset: bool
) -> None:
    """Store the columns on the estimator (reset), or compare them with those of fit."""
    if reset:
        _store_columns(estimator, width, names)
        return

    if width != estimator.n_features_in_:
        raise ChannelError(
            f"X has {width} features, but {type(estimator).__name__} is expecting"
            f" {estimator.n_features_in_} features as input",
            "Give the columns of fit.",
        )
    fitted = getattr(estimator, "feature_names_in_", None)
    if names is not None and fitted is not None and names != list(fitted):
        raise ChannelError(
            f"The columns {', '.join(names[:9])} are not those of fit,"
            f" {', '.join(fitted[:9])}",
            "Fit again.",
        )


def _store_columns(
    estimator: BaseEstimator, width: int, names: list[str] | None
) -> None:
    """Number and names of the columns, under the attributes of scikit-learn."""
    estimator.n_features_in_ = width
    if names is not None:
        estimator.feature_names_in_ = np.array(names, dtype=object)
    elif hasattr(estimator, "feature_names_in_"):
        del estimator.feature_names_in_


def require_two_dimensions(X: object) -> None:
    """Refuse a single column given without its second dimension."""
    if isinstance(X, (list, tuple)):
        flat = len(X) > 0 and isinstance(X[0], (int, float, np.number))
    elif hasattr(X, "columns") or hasattr(X, "nnz"):
        flat = False
    else:
        flat = np.ndim(np.asarray(X)) == 1

    if flat:
        raise ChannelError(
            "Expected a 2D array, got a 1D array",
            "Reshape your data: X.reshape(-1, 1) if it is one channel, X.reshape(1, -1)"
            " if it is one sample.",
        )


def is_dask(X: object) -> bool:
    """True for a Dask array, table or delayed value; Dask is not imported.

    An xarray of NumPy arrays has a graph that is None.
    """
    graph_of = getattr(X, "__dask_graph__", None)
    return callable(graph_of) and graph_of() is not None


def sample_weights(weights: ArrayLike | None, size: int) -> np.ndarray:
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
        raise ChannelError(
            "sample_weight holds values that are not valid weights",
            "Give numbers from zero up, not all zero.",
        )
    return line
