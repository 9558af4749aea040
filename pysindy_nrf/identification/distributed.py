"""Fits of Dask collections: the sums of each partition are computed where it lies.

They are added as a tree, so that no machine ever has more than a few kilobytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from ..common.lazy import require
from ..exceptions import ChannelError, LawError
from ..records.channels import is_dask
from ..records.input_arrays import Input
from .result import IdentificationResult
from .streaming import Chunk, RunningSums, StreamSettings, identified
from .streaming.sources import arrays_beside, input_of_arrays, refuse_beside

# Sums that one task adds up.
_FAN_IN = 8


def fit_collection(settings: StreamSettings, passed: Input) -> IdentificationResult:
    """Fit a Dask array, table or list of delayed records.

    Raises
    ------
    ChannelError
        If collections do not fit together.
    LawError
        If partitions cut what a law needs.
    """
    dask = require("dask", "dask", "Fitting Dask collections")
    items, are_records = _partitions(dask, passed)
    if not are_records:
        _require_laws_of_samples(settings)

    def add_up(kind: str) -> RunningSums:
        sum_up = dask.delayed(sum_of_partition, pure=False)
        sums = [
            sum_up(settings, item, number, are_records, kind)
            for number, item in enumerate(items)
        ]
        while len(sums) > 1:
            sums = [
                dask.delayed(total_of, pure=False)(sums[i : i + _FAN_IN])
                for i in range(0, len(sums), _FAN_IN)
            ]
        (total,) = dask.compute(sums[0])
        return total

    return identified(add_up)


def _require_laws_of_samples(settings: StreamSettings) -> None:
    """Refuse laws that need the record from its start."""
    for law in settings.laws:
        if law.has_memory:
            what = "A law remembers the path, and the partitions of a collection cut it"
        elif law.uses_time:
            what = (
                "A law reads the time, and each partition of a collection would count"
                " it from its own start"
            )
        else:
            continue
        raise LawError(
            what, "Give a list of delayed records; each is then read from its start."
        )


def sum_of_partition(
    settings: StreamSettings, item: object, number: int, is_record: bool, kind: str
) -> RunningSums:
    """Sums of one partition: the work of one task."""
    sums = RunningSums(settings, kind)
    if isinstance(item, dict):
        arrays = {name: np.asarray(values) for name, values in item.items()}
        chunk = Chunk(input_of_arrays(arrays), first=number == 0)
    else:
        chunk = settings.reader.item(item, first=is_record or number == 0)
    if is_record and chunk.name == "record":
        chunk = Chunk(
            chunk.samples, f"record {number + 1}", chunk.first, chunk.coordinates
        )
    # several workers share the machine
    with threadpool_limits(1, "blas"):
        if chunk.n_samples:
            sums.add(chunk, number)
    return sums


def total_of(parts: Sequence[RunningSums]) -> RunningSums:
    """The sums of several partitions, none of which is changed."""
    total = RunningSums(parts[0].settings, parts[0].kind)
    for sums in parts:
        total.merge(sums)
    return total


# -- partitions ----------------------------------------------------------------------


def _partitions(dask: ModuleType, passed: Input) -> tuple[list[object], bool]:
    """The partitions, and whether each is a record of its own."""
    X = passed.X
    if isinstance(X, (list, tuple)):
        refuse_beside(passed, "delayed records")
        return list(X), True
    if _is_table(X):
        return _partitions_of_table(dask, passed), False
    if hasattr(X, "chunks"):
        return _partitions_of_array(passed), False
    refuse_beside(passed, "delayed records")
    return [X], True


def _is_table(value: object) -> bool:
    return hasattr(value, "to_delayed") and not hasattr(value, "chunks")


def _partitions_of_table(dask: ModuleType, passed: Input) -> list[object]:
    """Partitions of a table, beside them those of a table of forces."""
    X = passed.X
    F = passed.F
    if F is None or not _is_table(F):
        refuse_beside(passed, "a table, whose columns hold them")
        return list(X.to_delayed())

    refuse_beside(passed, "a table", but="F")
    if F.npartitions != X.npartitions:
        raise ChannelError(
            f"X has {X.npartitions} partitions, F {F.npartitions}",
            "Put the forces into the same table.",
        )
    beside_each_other = dask.delayed(pd.concat, pure=False)
    return [
        beside_each_other([x, f], axis=1)
        for x, f in zip(X.to_delayed(), F.to_delayed())
    ]


def _partitions_of_array(passed: Input) -> list[object]:
    """Partitions of X, with the same rows of the arrays beside it."""
    array = require("dask.array", "dask", "Fitting Dask arrays")
    X = passed.X
    if X.ndim != 2:
        raise ChannelError(
            f"X has {X.ndim} dimensions",
            "Give one row per sample and one column per channel.",
        )
    blocks = {}
    for name, value in {"X": X, **arrays_beside(passed)}.items():
        if not is_dask(value):
            value = array.from_array(np.asarray(value), chunks=-1)
        blocks[name] = _with_rows_of(X, value, name).to_delayed().ravel()
    return [
        {name: of_array[i] for name, of_array in blocks.items()}
        for i in range(len(X.chunks[0]))
    ]


def _with_rows_of(X: Any, value: Any, name: str) -> Any:
    """An array in partitions of the rows of X, with all its columns."""
    rows_known = not np.isnan(value.shape[0]) and not np.isnan(X.shape[0])
    if rows_known and value.shape[0] != X.shape[0]:
        raise ChannelError(
            f"{name} has {value.shape[0]} samples, X has {X.shape[0]}",
            "Cut both to the same clock.",
        )
    if not rows_known and len(value.chunks[0]) != len(X.chunks[0]):
        raise ChannelError(
            f"{name} and X have different partitions",
            "Call compute_chunk_sizes() on both.",
        )
    chunks: dict[int, tuple[int, ...] | int] = {}
    if rows_known:
        chunks[0] = X.chunks[0]
    if value.ndim == 2:
        chunks[1] = -1
    return value.rechunk(chunks)
