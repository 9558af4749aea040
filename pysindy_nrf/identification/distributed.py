"""Fits of Dask collections: the sums of each partition are computed where it lies and
added as a tree.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from threadpoolctl import threadpool_limits

from ..common.lazy import require
from ..exceptions import ChannelError, LawError
from ..records.channels import is_dask
from .problem import law_list
from .streaming.accumulator import Accumulator
from .streaming.fit import fitted
from .streaming.sources import beside, chunk_of, chunk_of_arrays, refuse

FAN_IN = 8  # accumulators added up by one task


def fit_distributed(estimator: Any, X: Any, F: Any = None, **given: Any) -> Any:
    """Fit an estimator to Dask collections; ``NRFRegressor.fit`` comes here by
    itself.
    """
    dask = require("dask", "dask", "Fitting Dask collections")

    items, whole = _items(dask, X, F, beside(**given))
    for law in law_list(estimator.laws):
        if not whole and (law.has_memory or law.uses_time):
            raise LawError(
                (
                    "A law remembers the path, and the partitions of a collection"
                    " cut it"
                    if law.has_memory
                    else (
                        "A law reads the time, and each partition of a collection would"
                        " count it from its own start"
                    )
                ),
                "Give a list of delayed records; each is then read from its start.",
            )
    with threadpool_limits(1, "blas"):
        return fitted(lambda kind: _pass(dask, estimator, items, whole, kind))


def _pass(
    dask: Any, estimator: Any, items: Sequence[Any], whole: bool, kind: str
) -> Accumulator:
    """Sums of all partitions, added as a tree."""
    plain = dask.delayed(clone(estimator), pure=False)
    task = dask.delayed(accumulate, pure=False)
    level = [
        task(plain, item, number, whole, kind) for number, item in enumerate(items)
    ]
    while len(level) > 1:
        level = [
            dask.delayed(added, pure=False)(level[i : i + FAN_IN])
            for i in range(0, len(level), FAN_IN)
        ]
    (accumulator,) = dask.compute(level[0])
    accumulator.estimator = estimator
    return accumulator


def accumulate(
    estimator: Any, item: Any, number: int, whole: bool, kind: str = "gram"
) -> Accumulator:
    """Sums of one partition: the work of one task."""
    accumulator = Accumulator(estimator, kind)
    read = sorted({c for law in law_list(estimator.laws) for c in law.covariates})
    with threadpool_limits(1, "blas"):  # several workers share the machine
        if isinstance(item, dict):
            chunk = chunk_of_arrays(
                {k: np.asarray(v) for k, v in item.items()}, "record", number == 0
            )
        else:
            chunk = chunk_of(item, read, estimator.coordinates, whole or number == 0)
        if whole and chunk.record == "record":
            chunk.record = f"record {number + 1}"
        if chunk.n_samples:
            accumulator.add(chunk, number)
    return accumulator.close()


def added(accumulators: Sequence[Accumulator]) -> Accumulator:
    """The sum of some accumulators, none of which is changed."""
    first = accumulators[0]
    out = Accumulator(first.estimator, first.kind)
    for accumulator in accumulators:
        out.merge(accumulator)
    return out


def _items(dask: Any, X: Any, F: Any, given: dict[str, Any]) -> tuple[list[Any], bool]:
    """The partitions, and True if each is its own record."""
    if isinstance(X, (list, tuple)) or (
        not hasattr(X, "npartitions") and not hasattr(X, "chunks")
    ):
        refuse({"F": F, **given} if F is not None else given, "delayed records")
        return list(X) if isinstance(X, (list, tuple)) else [X], True
    if hasattr(X, "to_delayed") and not hasattr(X, "chunks"):  # a table
        if F is not None and hasattr(F, "to_delayed") and not hasattr(F, "chunks"):
            refuse(given, "a table")
            if F.npartitions != X.npartitions:
                cure = "Put the forces into the same table."
                raise ChannelError(
                    f"X has {X.npartitions} partitions, F {F.npartitions}", cure
                )
            pairs = zip(X.to_delayed(), F.to_delayed())
            return [
                dask.delayed(pd.concat, pure=False)([x, f], axis=1) for x, f in pairs
            ], False
        refuse(
            {"F": F, **given} if F is not None else given,
            "a table, whose columns hold them",
        )
        return list(X.to_delayed()), False
    array = require("dask.array", "dask", "Fitting Dask arrays")
    if X.ndim != 2:
        raise ChannelError(
            f"X has {X.ndim} dimensions",
            "Give one row per sample and one column per channel.",
        )
    given = {"X": X, **({} if F is None else {"F": F}), **given}
    collections = {}
    for name, value in given.items():
        value = (
            value if is_dask(value) else array.from_array(np.asarray(value), chunks=-1)
        )
        known = not np.isnan(value.shape[0]) and not np.isnan(X.shape[0])
        if known and value.shape[0] != X.shape[0]:
            cure = "Cut both to the same clock."
            raise ChannelError(
                f"{name} has {value.shape[0]} samples, X has {X.shape[0]}", cure
            )
        if not known and len(value.chunks[0]) != len(X.chunks[0]):
            raise ChannelError(
                f"{name} and X have different partitions",
                "Call compute_chunk_sizes() on both.",
            )
        wanted = {0: X.chunks[0]} if known else {}
        collections[name] = value.rechunk(
            {**wanted, **({1: -1} if value.ndim == 2 else {})}
        )
    parts = {name: value.to_delayed().ravel() for name, value in collections.items()}
    return [
        {name: blocks[i] for name, blocks in parts.items()}
        for i in range(len(X.chunks[0]))
    ], False
