"""The path of a greedy PySINDy optimizer, and one model on it by a share of the force."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator, clone

from ..exceptions import NRFError


class AlongPath(BaseEstimator):
    """One model on the path of SSR or FROLS, chosen by how much of the force may be left out.

    Greedy optimizers leave a path of ever sparser models and then choose among them by rules of their own, which
    mean another thing for every balance and number of samples (FROLS: the iteration with the smallest error
    reduction). Here the sparsest model of the path is taken whose residual is not larger than the full
    model's by more than a share of the right-hand side,

    .. math:: |r|^2 \\le |r_{full}|^2 + \\tau^2 |y|^2 ,

    and refitted by least squares. For use inside :class:`NRFRegressor` or :class:`ChainOptimizer`, where the
    right-hand side is the force of a balance.

    Parameters
    ----------
    optimizer : PySINDy optimizer
        With a ``history_`` of coefficients after ``fit``: ``SSR``, ``FROLS``, ``STLSQ``.
    tolerance : float
        The share, tau.

    Attributes
    ----------
    coef_ : ndarray of shape (1, n_features)
    ind_ : ndarray of bool
    path_ : list of tuple of int
        Columns of the models on the path, the sparsest first.

    Raises
    ------
    NRFError
        If the optimizer keeps no history, or there are several targets.

    Examples
    --------
    >>> import numpy as np
    >>> import pysindy as ps
    >>> from pysindy_nrf.selection import AlongPath
    >>> x = np.random.default_rng(0).standard_normal((500, 4))
    >>> y = x @ [[1.0], [0.0], [0.5], [0.005]]
    >>> AlongPath(ps.SSR(), tolerance=0.02).fit(x, y).coef_.round(1)
    array([[1. , 0. , 0.5, 0. ]])
    """

    def __init__(self, optimizer: Any = None, tolerance: float = 0.01) -> None:
        self.optimizer = optimizer
        self.tolerance = tolerance

    def fit(self, x: Any, y: Any) -> Self:
        """Follow the path and choose.

        Parameters
        ----------
        x : array-like of shape (n_rows, n_columns)
        y : array-like of shape (n_rows, 1)

        Returns
        -------
        self

        Raises
        ------
        NRFError
            If there is more than one target.
        """
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float).reshape(len(x), -1)
        if y.shape[1] != 1:
            raise NRFError(f"AlongPath got {y.shape[1]} targets", "It stands inside ChainOptimizer: one at a time.")
        self.path_ = self._path(x, y)
        limit = self._left(x, y, tuple(range(x.shape[1]))) + self.tolerance**2 * float(np.sum(y**2))
        kept = next(columns for columns in self.path_ if self._left(x, y, columns) <= limit)
        self.coef_ = np.zeros((1, x.shape[1]))
        if kept:
            self.coef_[0, kept] = np.linalg.lstsq(x[:, kept], y[:, 0], rcond=None)[0]
        self.ind_ = self.coef_ != 0
        return self

    def _path(self, x: np.ndarray, y: np.ndarray) -> list[tuple[int, ...]]:
        everything = tuple(range(x.shape[1]))
        if x.shape[1] < 2:  # greedy optimizers need two columns
            return [(), everything]
        fitted = clone(self.optimizer).fit(x, y)
        history = getattr(fitted, "history_", None)
        if history is None:
            raise NRFError(
                f"{type(self.optimizer).__name__} keeps no history_ of its models", "Use SSR, FROLS or STLSQ."
            )
        seen = {tuple(np.flatnonzero(np.ravel(coef)).tolist()) for coef in history}
        return sorted({(), everything} | seen, key=lambda columns: (len(columns), self._left(x, y, columns)))

    @staticmethod
    def _left(x: np.ndarray, y: np.ndarray, columns: tuple[int, ...]) -> float:
        """Squared length of what some columns leave unexplained."""
        if not columns:
            return float(np.sum(y**2))
        part = x[:, columns]
        return float(np.sum((y - part @ np.linalg.lstsq(part, y, rcond=None)[0]) ** 2))
