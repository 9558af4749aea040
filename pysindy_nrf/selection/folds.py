"""Which samples are on the same sides of all folds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from ..exceptions import ChannelError, NRFError
from ..records.dataset import BlockRows, Dataset

# Sides of a fold.
OUT = 0
TRAIN = 1
TEST = 2
# Stands for all folds, stacked.
EVERY: Final = "every"

# A fold by number, every fold, or all samples.
Fold = int | str | None


class FoldClasses:
    """Classes of samples that are on the same sides of all folds.

    Sums over one side of a fold are sums over classes.

    Parameters
    ----------
    n_samples : int
    folds : sequence of (ndarray, ndarray)
        Rows that train and that test.

    Attributes
    ----------
    class_of : ndarray of int, shape (n_samples,)
    side : ndarray of int, shape (n_classes, n_folds)
        ``OUT``, ``TRAIN`` or ``TEST``.
    """

    def __init__(
        self, n_samples: int, folds: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> None:
        sides = [_side_of_rows(n_samples, train, test) for train, test in folds]
        changes = np.zeros(n_samples, dtype=bool)
        changes[:1] = True
        for side in sides:
            changes[1:] |= side[1:] != side[:-1]
        starts = np.flatnonzero(changes)

        classes = np.zeros(len(starts), dtype=np.int64)
        known = np.zeros((1, 0), dtype=np.int8)
        for side in sides:
            classes, unique = pd.factorize(classes * 3 + side[starts])
            last = (unique % 3).astype(np.int8)
            known = np.column_stack([known[unique // 3], last])
        self.class_of = np.repeat(classes, np.diff(starts, append=n_samples))
        self.side = known

    @property
    def n_classes(self) -> int:
        """Number of classes."""
        return len(self.side)

    @property
    def n_folds(self) -> int:
        """Number of folds."""
        return self.side.shape[1]

    def weights(self, fold: Fold, side: int, n_samples: np.ndarray) -> np.ndarray:
        """Which classes are summed, (n_sums, n_classes): zeros and ones.

        ``n_samples`` of a class may be zero: rows at masked edges.
        """
        if fold is None:
            return np.ones((1, self.n_classes))

        chosen = (self.side == side) & (n_samples > 0)[:, None]
        columns = slice(None) if fold == EVERY else [fold]
        wanted = chosen.T[columns]
        empty = np.flatnonzero(~wanted.any(axis=1))
        if empty.size:
            number = empty[0] if fold == EVERY else fold
            name = "train" if side == TRAIN else "test"
            raise ChannelError(f"Fold {number} has no {name} samples", _CHECK)
        return wanted.astype(float)

    def held_out_runs(self, data: Dataset, fold: int) -> list[BlockRows]:
        """Contiguous held-out rows of a fold, record by record."""
        runs = []
        for i, segment in enumerate(data.segments):
            classes = self.class_of[segment.rows][segment.valid]
            is_test = self.side[classes, fold] == TEST
            steps = np.diff(np.concatenate([[0], is_test.astype(np.int8), [0]]))
            starts = np.flatnonzero(steps == 1).tolist()
            stops = np.flatnonzero(steps == -1).tolist()
            for start, stop in zip(starts, stops):
                runs.append(BlockRows(i, slice(start, stop)))
        return runs


_CHECK = "Check the splitter."


def _side_of_rows(n_samples: int, train: np.ndarray, test: np.ndarray) -> np.ndarray:
    """The side of each row in one fold."""
    side = np.zeros(n_samples, dtype=np.int8)
    side[train] = TRAIN
    if side[test].any():
        raise NRFError("A fold tests on samples it was trained with", _CHECK)
    side[test] = TEST
    return side
