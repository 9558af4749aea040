"""Band-limiting of every channel alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import ChannelError
from ..fair_filter import Band, FairFilter
from ..pieces import contiguous
from .columns import ColumnTransformer, check_rate, clock_of


class BandLimiter(ColumnTransformer):
    """The same zero-phase filter on every column, force and response alike.

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
        :class:`~pysindy_nrf.fair_filter.FairFilter`): about three seconds for a 1 Hz high-pass.

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

    def _prepare(self) -> None:
        if self.edges not in ("nan", "drop", "keep"):
            raise ChannelError(f"edges={self.edges!r} is unknown", "Choose nan, drop or keep.")
        self._filter = FairFilter(self.band, check_rate(self.fs), self.order)
        self.edge_ = self._filter.edge

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
        out = self._columns(X, self._work, record, time)
        if self.edges != "drop":
            return out
        empty = np.isnan(np.asarray(out))
        rows = np.zeros(len(empty), dtype=bool)
        for _, piece in contiguous(len(empty), record, clock_of(X, time, len(empty), record)):
            known = ~empty[piece].all(axis=0)  # a force may be unknown in one record and known in the next
            rows[piece] = ~empty[piece][:, known].any(axis=1) & known.any()
        return out[rows]

    def _work(self, values: np.ndarray) -> np.ndarray:
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
