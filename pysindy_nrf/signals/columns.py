"""What the column-wise transformers share: names, clocks, masked edges, one filter for all columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from .._input import checked, column_names
from ..channels import finite_span
from ..exceptions import ChannelError
from ..pieces import by_record, contiguous
from ..record import seconds_of


class ColumnTransformer(TransformerMixin, BaseEstimator):
    """Base of transformers that treat every column of each contiguous record alike.

    Record ids and times are metadata: ``set_fit_request(record=True).set_transform_request(record=True)`` with
    scikit-learn's metadata routing. Each record, and each piece between gaps of the clock, is treated by itself.
    """

    def fit(self, X: Any, y: Any = None, *, record: Any = None, time: Any = None) -> ColumnTransformer:
        """Check the parameters and remember the columns.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
        y, record, time : ignored

        Returns
        -------
        self
        """
        checked(self, X, reset=True)
        self._prepare()
        return self

    def transform(self, X: Any, *, record: Any = None, time: Any = None) -> Any:
        """Transform every column.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
            Leading and trailing NaN rows of a record stay NaN.
        record : array-like of shape (n_samples,), optional
            Record ids; rows without ids are one record.
        time : array-like of shape (n_samples,), optional
            s; a time index of X is used by itself. Where it jumps, a new piece begins.

        Returns
        -------
        DataFrame or ndarray
            As given.
        """
        return self._columns(X, self._work, record, time)

    def fit_transform(self, X: Any, y: Any = None, *, record: Any = None, time: Any = None) -> Any:
        """:meth:`fit`, then :meth:`transform`.

        Parameters
        ----------
        X, y, record, time
            As for these.

        Returns
        -------
        DataFrame or ndarray
        """
        return self.fit(X, y).transform(X, record=record, time=time)

    def _prepare(self) -> None:
        """Check parameters, set fitted attributes."""

    def _work(self, values: np.ndarray) -> np.ndarray:
        """Treat the columns of one contiguous record."""
        raise NotImplementedError

    def _columns(self, X: Any, work: Callable[[np.ndarray], np.ndarray], record: Any = None, time: Any = None) -> Any:
        """Apply ``work`` between the masked edges of each record and give back what was given (table or array)."""
        check_is_fitted(self, "n_features_in_")
        matrix = checked(self, X, reset=False).astype(float)
        labels = column_names(X) or [f"column {i + 1}" for i in range(self.n_features_in_)]
        out = np.full(matrix.shape, np.nan)
        for name, rows in contiguous(len(matrix), record, clock_of(X, time, len(matrix), record)):
            part = matrix[rows]
            use = ~np.isnan(part).all(axis=0)
            if use.any():
                live = [labels[i] for i in np.flatnonzero(use)]
                span = finite_span(list(part[:, use].T), live, "" if record is None else f"record {name!r}")
                inside = np.zeros(len(part), dtype=bool)
                inside[span] = True
                piece = np.full(part.shape, np.nan)
                piece[np.ix_(inside, use)] = work(part[np.ix_(inside, use)])
                out[rows] = piece
        return pd.DataFrame(out, index=X.index, columns=X.columns) if isinstance(X, pd.DataFrame) else out

    def get_feature_names_out(self, input_features: Any = None) -> np.ndarray:
        """Names of the columns: those given.

        Parameters
        ----------
        input_features : array-like of str, optional

        Returns
        -------
        ndarray of str
        """
        check_is_fitted(self, "n_features_in_")
        if hasattr(self, "feature_names_in_"):
            return self.feature_names_in_
        if input_features is not None:
            return np.asarray(input_features, dtype=object)
        return np.array([f"x{i}" for i in range(self.n_features_in_)], dtype=object)


def clock_of(X: Any, time: Any, size: int, record: Any = None) -> np.ndarray | None:
    """Time of the rows in s, from ``time`` or from the index of a table; None if it is not known.

    Raises
    ------
    ChannelError
        If the time does not increase within a record.
    """
    index: Any = getattr(X, "index", None)
    if time is None and isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)):
        time = index
    elif time is None and getattr(index, "name", None) in ("t", "time") and index.dtype.kind in "fiu":
        time = index.to_numpy()
    if time is None:
        return None
    seconds = seconds_of(time, "time")
    if len(seconds) != size:
        raise ChannelError(f"time has {len(seconds)} values, X has {size} samples", "Give one time for each sample.")
    for name, rows in by_record(record, size):
        bad = np.flatnonzero(np.diff(seconds[rows]) <= 0)
        if bad.size:
            raise ChannelError(
                f"The time of {name} does not increase after row {rows.start + int(bad[0])}",
                "Pass record= ids where several records are stacked; sort the rows of each; never shuffle them.",
            )
    return seconds


def check_rate(fs: Any) -> float:
    """A sampling rate in Hz, or an error."""
    try:
        rate = float(fs)
    except (TypeError, ValueError):
        rate = np.nan
    if not np.isfinite(rate) or rate <= 0:
        raise ChannelError(f"fs={fs!r} is not a sampling rate", "Give a positive number in Hz.")
    return rate
