"""Least squares fitted to some blocks of samples and judged on the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .jackknife import leave_one_out, share_of

# Ridges that are tried, shares of the squares of the columns.
RIDGES = (1e-9, 1e-5, 1e-3, 3e-2)
N_BLOCKS = 25
N_FOLDS = 5


class Regression:
    """Ridge regression on sums of products by block, with cross-validation.

    Parameters
    ----------
    grams : ndarray of shape (n_blocks, n_columns, n_columns)
        Sums of products of the columns.
    columns : mapping of str to ndarray
        Numbers of the columns by the name of their group.
    n_folds : int
        Folds to which the blocks are dealt in turn.
    """

    def __init__(
        self,
        grams: np.ndarray,
        columns: Mapping[str, np.ndarray],
        n_folds: int = N_FOLDS,
    ) -> None:
        self.columns = columns
        self.size = np.sqrt(np.maximum(np.einsum("bii->i", grams), 0.0))
        self.size[self.size == 0] = 1.0
        self.grams = grams / np.outer(self.size, self.size)
        self.n_folds = min(n_folds, len(grams))
        self.folds = np.arange(len(grams)) % self.n_folds
        self._fits: dict[tuple[str, tuple[str, ...]], tuple[np.ndarray, float]] = {}

    @classmethod
    def of(
        cls,
        groups: Mapping[str, Sequence[np.ndarray]],
        n_blocks: int = N_BLOCKS,
        n_folds: int = N_FOLDS,
    ) -> Regression:
        """The regression on groups of columns, each with one array for every record."""
        columns = {}
        start = 0
        for name, parts in groups.items():
            width = 1 if parts[0].ndim == 1 else parts[0].shape[1]
            columns[name] = np.arange(start, start + width)
            start += width

        records = [np.column_stack(parts) for parts in zip(*groups.values())]
        blocks = in_blocks(records, n_blocks)
        return cls(np.array([block.T @ block for block in blocks]), columns, n_folds)

    def unexplained(self, target: str, names: Sequence[str] = ()) -> np.ndarray:
        """Squares of a target that columns leave in every block, (n_blocks,).

        The columns are fitted to the other folds, with the ridge that leaves least.
        """
        return self._fit(target, tuple(names))[0]

    def share(
        self, target: str, names: Sequence[str], beside: Sequence[str] = ()
    ) -> tuple[float, float]:
        """Held-out share of the squares left by ``beside`` that more columns explain.

        With its standard error.
        """
        before = self.unexplained(target, beside)
        return share_of(before, self.unexplained(target, [*beside, *names]))

    def coefficients(self, target: str, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Coefficients on all data, by name, in the columns' own units."""
        index = self._index(target, names)
        ridge = self._fit(target, tuple(names))[1]
        total = self.grams.sum(axis=0)[index[:, None], index]
        weights = _solved(total, np.array(ridge))
        weights = weights * self.size[index[-1]] / self.size[index[:-1]]

        by_name = {}
        start = 0
        for name in names:
            stop = start + len(self.columns[name])
            by_name[name] = weights[start:stop]
            start = stop
        return by_name

    def _index(self, target: str, names: Sequence[str]) -> np.ndarray:
        return np.concatenate([self.columns[name] for name in (*names, target)])

    def _fit(self, target: str, names: tuple[str, ...]) -> tuple[np.ndarray, float]:
        """Squares left in every block, and the ridge that leaves least."""
        key = (target, names)
        if key not in self._fits:
            index = self._index(target, names)
            grams = self.grams[:, index[:, None], index]
            ridges = np.array(RIDGES if len(index) > 1 else RIDGES[:1])

            weights = _solved(self._training_sums(grams), ridges[:, None, None, None])
            residual = np.insert(-weights, len(index) - 1, 1.0, axis=2)
            # (n_blocks, n_columns, n_ridges)
            residual = residual.transpose(1, 2, 0)[self.folds]
            squares = (residual * (grams @ residual)).sum(axis=1)
            scale = float(self.size[index[-1]]) ** 2
            squares = scale * np.maximum(squares, 0.0)

            best = squares.sum(axis=0).argmin()
            self._fits[key] = squares[:, best], float(ridges[best])
        return self._fits[key]

    def _training_sums(self, grams: np.ndarray) -> np.ndarray:
        """Sums of all folds but one; of the single fold where there is one."""
        folds = np.zeros((self.n_folds, *grams.shape[1:]))
        np.add.at(folds, self.folds, grams)
        return leave_one_out(folds) if self.n_folds > 1 else folds


def in_blocks(
    records: Sequence[np.ndarray], n_blocks: int = N_BLOCKS
) -> list[np.ndarray]:
    """Rows of all records, cut into contiguous blocks of about equal length."""
    total = sum(map(len, records))
    blocks = []
    for record in records:
        count = max(1, round(n_blocks * len(record) / total))
        blocks.extend(np.array_split(record, count))
    return blocks


def _solved(grams: np.ndarray, ridge: np.ndarray) -> np.ndarray:
    """Ridge regression of the last column on the others, for each sum and ridge."""
    matrix = grams[..., :-1, :-1]
    vector = grams[..., :-1, -1:]
    eye = np.eye(matrix.shape[-1])
    squares = np.maximum(np.einsum("...ii->...i", matrix), 1e-12)[..., None, :] * eye
    return np.linalg.solve(matrix + ridge * squares + 1e-12 * eye, vector)[..., 0]
