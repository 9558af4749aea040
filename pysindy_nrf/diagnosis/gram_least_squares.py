"""Least squares on Gram matrices of [columns | right-hand side], many at once."""

import numpy as np
from scipy import linalg

# Smallest squared pivot of a Gram matrix of columns of unit length, above which they
# are independent.
LEAST_PIVOT = 1e-10
# Singular values of dependent columns, as a share of the largest, that count.
RANK = 1e-13


def solved(grams: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Coefficients of some columns, of the least norm where these are dependent.

    Parameters
    ----------
    grams : ndarray of shape (..., p + 1, p + 1)
        Of [columns | right-hand side], of any lengths.
    columns : ndarray of shape (k,)
        Numbers of the columns.

    Returns
    -------
    ndarray of shape (..., k)
    """
    if not columns.size:
        return grams[..., columns, -1]

    lengths = _lengths(grams)[..., columns]
    matrix = grams[..., columns[:, None], columns]
    matrix = matrix / lengths[..., :, None] / lengths[..., None, :]
    target = grams[..., columns, -1] / lengths
    if _are_independent(matrix):
        return np.linalg.solve(matrix, target[..., None])[..., 0] / lengths

    out = np.empty_like(target)
    for index in np.ndindex(target.shape[:-1]):
        solution = linalg.lstsq(
            matrix[index], target[index], cond=RANK, check_finite=False
        )
        out[index] = solution[0] / lengths[index]
    return out


def _lengths(grams: np.ndarray) -> np.ndarray:
    """Lengths of the columns; 1 for columns of zeros."""
    squares = np.einsum("...ii->...i", grams)
    lengths = np.sqrt(np.maximum(squares, 0.0))
    return np.where(lengths > 0, lengths, 1.0)


def _are_independent(matrix: np.ndarray) -> bool:
    try:
        pivots = np.linalg.cholesky(matrix).diagonal(axis1=-2, axis2=-1)
    except np.linalg.LinAlgError:
        return False
    return bool(pivots.min() ** 2 > LEAST_PIVOT)


def left_over(
    grams: np.ndarray, columns: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """Residual sums of squares of given coefficients of some columns, shape (...)."""
    matrix = grams[..., columns[:, None], columns]
    target = grams[..., columns, -1]
    image = (matrix @ coefficients[..., None])[..., 0] - 2 * target
    explained = (coefficients * image).sum(axis=-1)
    return np.maximum(grams[..., -1, -1] + explained, 0.0)


def held_out_residual(folds: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Squares that some columns leave of each fold, fitted to the others, summed.

    Parameters
    ----------
    folds : ndarray of shape (..., n_folds, p + 1, p + 1)
    columns : ndarray of shape (k,)

    Returns
    -------
    ndarray of shape (...)
    """
    training = folds.sum(axis=-3, keepdims=True) - folds
    return left_over(folds, columns, solved(training, columns)).sum(axis=-1)
