"""Triangular factors R of columns: ``R.T @ R`` are the columns' products."""

import numpy as np
from scipy import linalg

# Directions of the instruments whose share of the largest is below this are round-off.
INSTRUMENT_CUT = 1e-12


def root_of(rows: np.ndarray) -> np.ndarray:
    """Upper triangular factor (p, p) of rows (n, p).

    Zeros stand below where there are fewer rows than columns.
    """
    upper = linalg.qr(rows, mode="r", overwrite_a=True, check_finite=False)[0]
    return _square(upper[: rows.shape[1]])


def upper_of(rows: np.ndarray) -> np.ndarray:
    """Upper triangular factors (..., p, p) of rows (..., n, p)."""
    return _square(np.asarray(np.linalg.qr(rows, mode="r")))


def _square(upper: np.ndarray) -> np.ndarray:
    """A factor with rows of zeros below, where it has fewer rows than columns."""
    n_rows, n_columns = upper.shape[-2:]
    if n_rows == n_columns:
        return upper
    out = np.zeros((*upper.shape[:-2], n_columns, n_columns))
    out[..., :n_rows, :] = upper
    return out


def scaled_cholesky(gram: np.ndarray) -> np.ndarray:
    """Upper factors of products (..., p, p) of columns many orders of magnitude apart.

    A column that depends on those before it leaves a row of zeros.
    """
    scale = np.sqrt(np.clip(np.diagonal(gram, axis1=-2, axis2=-1), 0.0, None))
    safe = np.where(scale > 0, scale, 1.0)
    unit = gram / safe[..., :, None] / safe[..., None, :]
    # an empty column takes no part
    regular = unit + (scale == 0)[..., None] * np.eye(unit.shape[-1])

    try:
        if gram.ndim == 2:
            return linalg.cholesky(regular, check_finite=False) * scale
        lower = np.linalg.cholesky(regular)
        return lower.swapaxes(-1, -2) * scale[..., None, :]
    except np.linalg.LinAlgError:
        if gram.ndim > 2:
            return np.array([scaled_cholesky(products) for products in gram])
        return _semidefinite_factor(unit) * scale


def _semidefinite_factor(unit: np.ndarray) -> np.ndarray:
    """Upper factor of products of unit columns, of which some depend on others."""
    p = len(unit)
    least_pivot = 4 * p * np.finfo(float).eps
    upper = np.zeros_like(unit)
    for i in range(p):
        row = unit[i, i:] - upper[:i, i] @ upper[:i, i:]
        if row[0] > least_pivot:
            upper[i, i:] = row / np.sqrt(row[0])
    return upper


def weighted_root(roots: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Root of the weighted sum of what roots (n_blocks, q, p) stand for."""
    p = roots.shape[-1]
    used = np.flatnonzero(weights)
    if not len(used):
        return np.zeros((p, p))
    rows = np.sqrt(weights[used])[:, None, None] * roots[used]
    return root_of(rows.reshape(-1, p))


def projected_root(gram: np.ndarray, n_columns: int) -> np.ndarray:
    """Roots of the first columns projected on the others, the instruments.

    Of products (..., p, p); square, (..., n_columns, n_columns), with rows of zeros.
    """
    inner = gram[..., n_columns:, n_columns:]
    cross = gram[..., n_columns:, :n_columns]
    scale = np.sqrt(np.diagonal(inner, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)

    values, vectors = np.linalg.eigh(inner / scale[..., :, None] / scale[..., None, :])
    clear = values > INSTRUMENT_CUT * values[..., -1:]
    weights = np.where(clear, 1.0 / np.sqrt(np.where(clear, values, 1.0)), 0.0)
    directions = vectors * weights[..., None, :]
    rows = directions.swapaxes(-1, -2) @ (cross / scale[..., :, None])
    return _square(rows)
