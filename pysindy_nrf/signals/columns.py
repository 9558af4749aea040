"""What the column-wise transformers share: names, clocks, masked edges, one filter for all columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from ..channels import as_matrix, finite_span
from ..exceptions import ChannelError


class ColumnTransformer(TransformerMixin, BaseEstimator):
    """Base of transformers that treat every column of one contiguous record alike."""

    def fit(self, X: Any, y: Any = None) -> ColumnTransformer:
        """Check the parameters and remember the columns.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
        y : ignored

        Returns
        -------
        self
        """
        names = _names(X)
        if names is not None:
            self.feature_names_in_ = np.array(names, dtype=object)
        elif hasattr(self, "feature_names_in_"):
            del self.feature_names_in_
        self.n_features_in_ = as_matrix(X, names or "column ").shape[1]
        self._prepare()
        return self

    def _prepare(self) -> None:
        """Check parameters, set fitted attributes."""

    def _columns(self, X: Any, work: Callable[[np.ndarray], np.ndarray]) -> Any:
        """Apply ``work`` between the masked edges and give back what was given (table or array)."""
        check_is_fitted(self, "n_features_in_")
        names = _names(X)
        fitted = list(getattr(self, "feature_names_in_", [])) or None
        if names is not None and fitted is not None and names != fitted:
            raise ChannelError(
                f"The columns {', '.join(names[:9])} are not those of fit, {', '.join(fitted[:9])}", "Fit again."
            )
        labels = names or [f"column {i + 1}" for i in range(self.n_features_in_)]
        matrix = as_matrix(X, labels, self.n_features_in_).astype(float)
        out = np.full(matrix.shape, np.nan)
        use = ~np.isnan(matrix).all(axis=0)
        if use.any():
            live = [labels[i] for i in np.flatnonzero(use)]
            span = finite_span(list(matrix[:, use].T), live)
            rows = np.zeros(len(matrix), dtype=bool)
            rows[span] = True
            out[np.ix_(rows, use)] = work(matrix[np.ix_(rows, use)])
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


def _names(X: Any) -> list[str] | None:
    return [str(c) for c in X.columns] if isinstance(X, pd.DataFrame) else None


def check_rate(fs: Any) -> float:
    """A sampling rate in Hz, or an error."""
    try:
        rate = float(fs)
    except (TypeError, ValueError):
        rate = np.nan
    if not np.isfinite(rate) or rate <= 0:
        raise ChannelError(f"fs={fs!r} is not a sampling rate", "Give a positive number in Hz.")
    return rate
