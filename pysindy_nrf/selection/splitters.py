"""A splitter that respects time.

Neighbouring samples of a vibration are nearly copies of each other. Complete records
are held out by scikit-learn's ``LeaveOneGroupOut`` or ``GroupKFold``, with record ids
as groups.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.model_selection import BaseCrossValidator
from sklearn.utils.validation import _num_samples

from ..exceptions import ChannelError
from ..laws.power_series import whole_number
from ..records.channels import by_record


class BlockedTimeSplit(BaseCrossValidator):
    """Consecutive blocks of every record are held out, with a gap around them.

    Parameters
    ----------
    n_splits : int
        Blocks into which each record is cut; fold i holds out block i of every record.
    gap : int
        Samples left out of the training data on either side of a held-out block, so
        that nothing of it leaks through a filter or the memory of the motion. Take a
        period or two of the lowest mode, or the ``edge`` of the filter.

    Notes
    -----
    With ``sklearn.set_config(enable_metadata_routing=True)`` the record ids come as
    metadata named ``record``, which is passed once to everything that needs it.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.selection import BlockedTimeSplit
    >>> folds = BlockedTimeSplit(3, gap=1).split(np.zeros((9, 3)))
    >>> [test.tolist() for train, test in folds]
    [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    """

    __metadata_request__split = {"groups": "record"}

    def __init__(self, n_splits: int = 5, gap: int = 0) -> None:
        self.n_splits = n_splits
        self.gap = gap

    def __repr__(self) -> str:
        return f"BlockedTimeSplit(n_splits={self.n_splits!r}, gap={self.gap!r})"

    def get_n_splits(
        self, X: object = None, y: object = None, groups: object = None
    ) -> int:
        """Number of folds; parameters as for :meth:`split`, not needed."""
        return whole_number("n_splits", self.n_splits, 2)

    def split(
        self, X: ArrayLike, y: object = None, groups: ArrayLike | None = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Row numbers of each fold.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_columns)
        y : ignored
        groups : array-like of shape (n_samples,), optional
            Record ids; the samples of a record follow each other.

        Yields
        ------
        train, test : ndarray of int

        Raises
        ------
        ChannelError
            If a record is too short, or its samples do not follow each other.
        """
        n_splits = whole_number("n_splits", self.n_splits, 2)
        gap = whole_number("gap", self.gap)
        n_samples = _num_samples(X)
        records = _rows_of_records(groups, n_samples)
        _require_length(min(map(len, records)), n_splits, gap)

        # sizes as in scikit-learn's KFold: the first blocks are one sample longer
        blocks = [np.array_split(rows, n_splits) for rows in records]
        for fold in range(n_splits):
            tests = [parts[fold] for parts in blocks]
            is_train = np.ones(n_samples, dtype=bool)
            for rows, test in zip(records, tests):
                first = max(rows[0], test[0] - gap)
                is_train[first : min(rows[-1], test[-1] + gap) + 1] = False
            yield np.flatnonzero(is_train), np.concatenate(tests)


def _rows_of_records(groups: ArrayLike | None, n_samples: int) -> list[np.ndarray]:
    """Rows of each record."""
    pieces = by_record(groups, n_samples)
    names = pd.Series([name for name, _ in pieces])
    repeated = names[names.duplicated()]
    if len(repeated):
        what = f"The samples of record {repeated.iloc[0]} do not follow each other"
        raise ChannelError(
            what, "Sort the rows by record and time; never shuffle them."
        )
    return [np.arange(rows.start, rows.stop) for _, rows in pieces]


def _require_length(shortest: int, n_splits: int, gap: int) -> None:
    """Refuse records that leave nothing to train on beside a block and its gap."""
    if shortest < n_splits or shortest - shortest // n_splits <= 2 * gap:
        what = (
            f"A record of {shortest} samples is too short for {n_splits} blocks with a"
            f" gap of {gap} samples"
        )
        cure = "Use fewer blocks or a smaller gap, or hold out whole records."
        raise ChannelError(what, cure)
