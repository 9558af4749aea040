"""What every estimator asks of its input, in the words that scikit-learn's own tools look for: said once."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..exceptions import ChannelError
from .channels import as_matrix


def column_names(X: Any) -> list[str] | None:
    """Names of the columns of a table, None for an array."""
    return [str(c) for c in X.columns] if hasattr(X, "columns") else None


def checked(estimator: Any, X: Any, *, reset: bool, prefix: str = "column ") -> np.ndarray:
    """The input of an estimator as a float matrix, its columns counted and named as in ``fit``."""
    names = column_names(X)
    require_two_dimensions(X)
    matrix = as_matrix(X, names or prefix, what="columns of X")
    if matrix.shape[1] == 0:
        raise ChannelError(
            f"X has 0 feature(s) (shape={matrix.shape}) while a minimum of 1 is required",
            "Give one column per channel.",
        )
    if len(matrix) == 0:
        raise ChannelError("X has no samples (0 rows)", "Give a record.")
    same_columns(estimator, matrix.shape[1], names, reset)
    return matrix


def same_columns(estimator: Any, width: int, names: list[str] | None, reset: bool) -> None:
    """Remember the columns, or compare them with those of ``fit``."""
    if reset:
        estimator.n_features_in_ = width
        if names is not None:
            estimator.feature_names_in_ = np.array(names, dtype=object)
        elif hasattr(estimator, "feature_names_in_"):
            del estimator.feature_names_in_
        return
    if width != estimator.n_features_in_:
        raise ChannelError(
            f"X has {width} features, but {type(estimator).__name__} is expecting {estimator.n_features_in_} features "
            "as input",
            "Give the columns of fit.",
        )
    fitted = getattr(estimator, "feature_names_in_", None)
    if names is not None and fitted is not None and names != list(fitted):
        raise ChannelError(
            f"The columns {', '.join(names[:9])} are not those of fit, {', '.join(fitted[:9])}", "Fit again."
        )


def require_two_dimensions(X: Any) -> None:
    """Refuse a single column given without its second dimension."""
    if isinstance(X, (list, tuple)):
        flat = len(X) > 0 and isinstance(X[0], (int, float, np.number))
    else:
        flat = not hasattr(X, "columns") and not hasattr(X, "nnz") and np.ndim(np.asarray(X)) == 1
    if flat:
        raise ChannelError(
            "Expected a 2D array, got a 1D array",
            "Reshape your data: X.reshape(-1, 1) if it is one channel, X.reshape(1, -1) if it is one sample.",
        )


def is_dask(X: Any) -> bool:
    """Whether X is a Dask array, table or delayed value; Dask is not imported."""
    return hasattr(X, "__dask_graph__")


def sample_weights(weights: Any, size: int) -> np.ndarray:
    """Weights of samples, ones if None."""
    if weights is None:
        return np.ones(size)
    line = as_matrix(weights, ["sample_weight"], 1, "weights")[:, 0].astype(float)
    if len(line) != size:
        raise ChannelError(f"sample_weight has {len(line)} values, X has {size} samples", "Give one for each sample.")
    if not np.isfinite(line).all() or (line < 0).any() or not line.any():
        raise ChannelError("sample_weight holds values that are no weights", "Give numbers from zero up, not all zero.")
    return line
