"""Band-limiting of every channel alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from ..data.channels import checked, column_names, contiguous, finite_span
from ..exceptions import ChannelError
from .columns import check_rate, clock_of
from .zero_phase_filter import Band, FairFilter


class BandLimiter(TransformerMixin, BaseEstimator):
    """The same zero-phase filter on every column, force and response alike.

    Record ids and times are metadata: ``set_fit_request(record=True).set_transform_request(record=True)`` with
    scikit-learn's metadata routing. Each record, and each piece between gaps of the clock, is filtered by itself.

    Parameters
    ----------
    band : (float, float) or None
        Lower and upper edge, Hz; None for an open end.
    fs : float
        Sampling rate, Hz.
    order : int
        Order of the Butterworth filter; it runs forward and backward.
    edges : {"nan", "drop", "keep"}
        What to do with the ``edge_`` rows at each end that the filter spoils.

    Attributes
    ----------
    edge_ : int
        Rows spoiled at each end, computed from the filter's impulse response (see
        :class:`~pysindy_nrf.signals.zero_phase_filter.FairFilter`): about three seconds for a 1 Hz high-pass.

    Raises
    ------
    ChannelError
        In ``fit`` if the band is impossible; in ``transform`` if the filter spoils the whole record.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from pysindy_nrf.signals import BandLimiter
    >>> t = np.arange(4000) / 1000
    >>> table = pd.DataFrame({"F1": np.sin(60 * t) + np.sin(2000 * t), "a1": np.sin(60 * t)})
    >>> limiter = BandLimiter((None, 50.0), fs=1000.0, edges="drop")
    >>> out = limiter.fit_transform(table)
    >>> len(table) - len(out) == 2 * limiter.edge_, bool(np.abs(out["F1"] - out["a1"]).max() < 1e-3)
    (True, True)
    """

    def __init__(self, band: Band = None, fs: float = 1.0, order: int = 4, edges: str = "nan") -> None:
        self.band = band
        self.fs = fs
        self.order = order
        self.edges = edges

    def fit(self, X: Any, y: Any = None, *, record: Any = None, time: Any = None) -> BandLimiter:
        """Check the parameters and remember the columns.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
        y, record, time : ignored

        Returns
        -------
        BandLimiter

        Raises
        ------
        ChannelError
            If the band, the sampling rate or ``edges`` is impossible.
        """
        checked(self, X, reset=True)
        if self.edges not in ("nan", "drop", "keep"):
            raise ChannelError(f"edges={self.edges!r} is unknown", "Choose nan, drop or keep.")
        self._filter = FairFilter(self.band, check_rate(self.fs), self.order)
        self.edge_ = self._filter.edge
        return self

    def transform(self, X: Any, *, record: Any = None, time: Any = None) -> Any:
        """Filter every column of each contiguous record.

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
        """
        check_is_fitted(self, "n_features_in_")
        matrix = checked(self, X, reset=False).astype(float)
        labels = column_names(X) or [f"column {i + 1}" for i in range(self.n_features_in_)]
        out, keep = np.full(matrix.shape, np.nan), np.zeros(len(matrix), dtype=bool)
        for name, rows in contiguous(len(matrix), record, clock_of(X, time, len(matrix), record)):
            part = matrix[rows]
            use = ~np.isnan(part).all(axis=0)  # a force may be unknown in one record and known in the next
            if use.any():
                live = [labels[i] for i in np.flatnonzero(use)]
                span = finite_span(list(part[:, use].T), live, "" if record is None else f"record {name!r}")
                piece = np.full(part.shape, np.nan)
                piece[span, use] = self._filtered(part[span, use])
                out[rows] = piece
                keep[rows] = ~np.isnan(piece[:, use]).any(axis=1)
        table = pd.DataFrame(out, index=X.index, columns=X.columns) if isinstance(X, pd.DataFrame) else out
        return table[keep] if self.edges == "drop" else table

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

    def _filtered(self, values: np.ndarray) -> np.ndarray:
        """Columns of one contiguous record through the filter, the rows it spoils NaN."""
        out = self._filter.apply(values)
        if self.edges == "keep" or self.edge_ == 0:
            return out
        if len(out) <= 2 * self.edge_:
            raise ChannelError(
                f"The record has {len(out)} samples, the filter {self.band} Hz spoils {self.edge_} at each end",
                "Raise the lower band edge, give a longer record, or keep the ends with edges='keep'.",
            )
        out[: self.edge_] = np.nan
        out[len(out) - self.edge_ :] = np.nan
        return out
