"""Splitters that respect records and time: neighbouring samples of a vibration are
nearly copies of each other.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from sklearn.model_selection import BaseCrossValidator
from sklearn.utils.validation import _num_samples

from ..exceptions import ChannelError
from ..laws.power_series import whole
from ..records.channels import by_record
from ..records.record import Record


class _RecordSplitter(BaseCrossValidator):
    """What both splitters share: record ids come as ``groups``, or as routed metadata
    named ``record``.
    """

    # with sklearn.set_config(enable_metadata_routing=True), record= is passed once, to
    # everything that needs it
    __metadata_request__split = {"groups": "record"}

    def __repr__(self) -> str:
        held = ", ".join(
            f"{k}={v!r}" for k, v in vars(self).items() if not k.startswith("_")
        )
        return f"{type(self).__name__}({held})"

    def split(
        self, X: Any, y: Any = None, groups: Any = None
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Row numbers of each fold.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_columns), or list of Record
        y : ignored
        groups : array-like of shape (n_samples,), optional
            Record ids; the samples of a record follow each other.

        Yields
        ------
        train, test : ndarray of int
        """
        rows = np.arange(_num_samples(X))
        for test, near in self._tests(self._records(X, groups)):
            yield np.delete(rows, np.concatenate([test, near])), test

    def _records(self, X: Any, groups: Any) -> list[np.ndarray]:
        """Rows of each record."""
        size = _num_samples(X)
        if isinstance(X, (list, tuple)) and X and isinstance(X[0], Record):
            return [np.array([i]) for i in range(size)]
        pieces = by_record(groups, size)
        names = pd.Series([name for name, _ in pieces])
        if len(again := names[names.duplicated()]):
            cure = "Sort the rows by record and time; never shuffle them."
            raise ChannelError(
                f"The samples of record {again.iloc[0]} do not follow each other", cure
            )
        return [np.arange(rows.start, rows.stop) for _, rows in pieces]

    def _tests(
        self, records: list[np.ndarray]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Held-out rows of each fold, and rows near them that are left out of
        training.
        """
        raise NotImplementedError


class RecordSplit(_RecordSplitter):
    """Whole records are held out: the most honest judge where there are several.

    Parameters
    ----------
    n_splits : int, optional
        Number of folds, into which the records are dealt in turn; one fold for each
        record if None.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.selection import RecordSplit
    >>> ids = np.array(["hit 1"] * 3 + ["hit 2"] * 2)
    >>> [
    ...     test.tolist()
    ...     for train, test in RecordSplit().split(np.zeros((5, 3)), groups=ids)
    ... ]
    [[0, 1, 2], [3, 4]]
    """

    def __init__(self, n_splits: int | None = None) -> None:
        self.n_splits = n_splits

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """Number of folds; parameters as of :meth:`split`, not needed if ``n_splits``
        was given.
        """
        if self.n_splits is not None:
            return whole("n_splits", self.n_splits, 2)
        return len(self._records(X if X is not None else groups, groups))

    def _tests(
        self, records: list[np.ndarray]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Whole records, dealt to the folds in turn."""
        n = (
            len(records)
            if self.n_splits is None
            else whole("n_splits", self.n_splits, 2)
        )
        if len(records) < max(n, 2):
            cure = (
                "Pass the record ids as groups= (or record= with metadata routing), or"
                " use BlockedTimeSplit."
            )
            raise ChannelError(
                f"{len(records)} record{'s' * (len(records) != 1)} cannot make"
                f" {max(n, 2)} folds",
                cure,
            )
        for i in range(n):
            yield np.sort(np.concatenate(records[i::n])), np.zeros(0, dtype=int)


class BlockedTimeSplit(_RecordSplitter):
    """Consecutive blocks of every record are held out, with a gap around them.

    Parameters
    ----------
    n_splits : int
        Blocks into which each record is cut; fold i holds out block i of every record.
    gap : int
        Samples left out of the training data on either side of a held-out block, so
        that nothing of it leaks through a filter or the memory of the motion: a period
        or two of the lowest mode, or the ``edge`` of the filter.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.selection import BlockedTimeSplit
    >>> [
    ...     test.tolist()
    ...     for train, test in BlockedTimeSplit(3, gap=1).split(
    ...         np.zeros((9, 3))
    ...     )
    ... ]
    [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    """

    def __init__(self, n_splits: int = 5, gap: int = 0) -> None:
        self.n_splits, self.gap = n_splits, gap

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """Number of folds; parameters as of :meth:`split`, not needed."""
        return whole("n_splits", self.n_splits, 2)

    def _tests(
        self, records: list[np.ndarray]
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """One block of every record, and the same with the gap around it."""
        n, gap = whole("n_splits", self.n_splits, 2), whole("gap", self.gap)
        short = min(records, key=len)
        if len(short) < n or len(short) - len(short) // n <= 2 * gap:
            what = (
                f"A record of {len(short)} samples is too short for {n} blocks with a"
                f" gap of {gap} samples"
            )
            raise ChannelError(what, "Use fewer blocks, a smaller gap, or RecordSplit.")
        # sizes as in scikit-learn's KFold: the first blocks are one sample longer
        blocks = [np.array_split(rows, n) for rows in records]
        for i in range(n):
            tests = [parts[i] for parts in blocks]
            near = [
                np.arange(
                    max(rows[0], test[0] - gap), min(rows[-1], test[-1] + gap) + 1
                )
                for rows, test in zip(records, tests)
            ]
            yield np.concatenate(tests), np.concatenate(near)
