"""Consecutive samples on their way into a fit: what one chunk holds, and chunks from tables, arrays and records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...data.pieces import by_record
from ...data.record import Record, seconds_of
from ...exceptions import ChannelError
from ...regression.segments import feature_names
from ...signals.kinematics import base_acceleration_if_any


@dataclass
class Chunk:
    """Some consecutive samples of a source.

    Attributes
    ----------
    X : ndarray of shape (n_samples, 3 n_dof) or DataFrame
        As for ``NRFRegressor.fit``.
    F : ndarray of shape (n_samples, n_dof) or DataFrame, optional
        N.
    record : str
        Name of the record, where no ids tell several apart.
    first : bool
        Whether a record starts with it; otherwise it goes on where the chunk before it ended.
    ids : ndarray of shape (n_samples,), optional
        Record ids.
    time : ndarray of shape (n_samples,), optional
        s.
    base_acceleration : ndarray of shape (n_samples,), optional
        m/s^2.
    covariates : dict of str to ndarray of shape (n_samples,)
    coordinates : {"relative", "absolute"}, optional
        Of X; those of the estimator if None.

    Examples
    --------
    >>> import numpy as np
    >>> from pysindy_nrf.estimation.streaming import Chunk
    >>> chunk = Chunk(np.zeros((6, 3)), np.zeros((6, 1)), ids=np.array([1, 1, 1, 2, 2, 2]))
    >>> chunk.n_samples, [part.n_samples for part in chunk.records()]
    (6, [3, 3])
    """

    X: Any
    F: Any = None
    record: str = "record"
    first: bool = True
    ids: np.ndarray | None = None
    time: np.ndarray | None = None
    base_acceleration: np.ndarray | None = None
    covariates: dict[str, np.ndarray] = field(default_factory=dict)
    coordinates: str | None = None

    @property
    def n_samples(self) -> int:
        """Rows."""
        return len(self.X)

    def records(self) -> list[Chunk]:
        """The samples of each record, where ids tell several apart.

        Returns
        -------
        list of Chunk
        """
        if self.ids is None:
            return [self]
        pieces = by_record(self.ids, self.n_samples)
        return [
            Chunk(
                cut(self.X, rows), cut(self.F, rows), name, self.first or i > 0, None, cut(self.time, rows),
                cut(self.base_acceleration, rows), {k: c[rows] for k, c in self.covariates.items()}, self.coordinates,
            )
            for i, (name, rows) in enumerate(pieces)
        ]  # fmt: skip


def cut(value: Any, rows: slice) -> Any:
    """Rows of an array or a table, if there is one."""
    return value.iloc[rows] if hasattr(value, "iloc") else None if value is None else value[rows]


def chunk_of(item: Any, covariates: Sequence[str] = (), coordinates: str = "relative", first: bool = True) -> Chunk:
    """One item of an iterator as a chunk."""
    if isinstance(item, Chunk):
        return item
    if isinstance(item, Record):
        x, force = item.to_features()
        ag = base_acceleration_if_any(item, x.attrs.get("band"))
        return Chunk(
            x.to_numpy(), force.to_numpy(), item.name, True, None, np.asarray(item.time), ag, dict(item.covariates),
            "relative",
        )  # fmt: skip
    if hasattr(item, "columns"):
        names = [str(c) for c in item.columns]
        n = n_dof_of(names, "The table")
        wanted = wanted_columns(names, n, covariates, coordinates, "The table")
        values = {c: item[c].to_numpy() for c in wanted}
        if item.index.name in ("t", "time") or item.index.dtype.kind in "mM":
            values.setdefault("t", item.index.to_numpy())
        return chunk_of_columns(values, n, covariates, "record", first, coordinates)
    if isinstance(item, tuple) and len(item) == 2:
        return Chunk(item[0], item[1], first=first, time=_table_time(item[0]))
    if isinstance(item, np.ndarray):
        return Chunk(item, first=first)
    raise ChannelError(
        f"The iterator gave {type(item).__name__}", "Let it give DataFrames, pairs (X, F) or Records."
    )


def _table_time(X: Any) -> Any:
    """Time of the rows of a table, from a column or the index; None where there is none."""
    if not hasattr(X, "columns"):
        return None
    named = next((c for c in ("t", "time") if c in X.columns), None)
    if named is not None:
        return X[named].to_numpy()
    return X.index.to_numpy() if X.index.name in ("t", "time") or X.index.dtype.kind in "mM" else None


def n_dof_of(columns: Sequence[str], where: Any) -> int:
    """DOFs of named columns: those of a1, a2, ..."""
    n = sum(1 for c in columns if c[:1] == "a" and c[1:].isdigit() and c != "a0")
    if not n:
        raise ChannelError(f"{where} has no columns a1, a2, ...", f"Name them {', '.join(feature_names(2))}, F1, F2.")
    return n


def wanted_columns(
    columns: Sequence[str], n_dof: int, covariates: Sequence[str], coordinates: str, where: Any
) -> list[str]:
    """The columns to read, or an error that names those that are missing."""
    needed = [*feature_names(n_dof, coordinates), *covariates]
    missing = [c for c in needed if c not in columns]
    forces = [f"F{j}" for j in range(1, n_dof + 1)]
    some = [c for c in forces if c in columns]
    if missing or (some and len(some) < n_dof):
        lost = (missing or [c for c in forces if c not in columns])[:6]
        raise ChannelError(
            f"{where} lacks the column{'s' if len(lost) > 1 else ''} {', '.join(lost)}",
            "A force known to be zero is a column of zeros, an unknown one of NaN.",
        )
    base = ("xdot0", "x0") if coordinates == "absolute" else ()
    return [*needed, *some, *(c for c in (*base, "t", "time", "ag", "record") if c in columns)]


def chunk_of_columns(
    values: Mapping[str, Any], n_dof: int, covariates: Sequence[str], record: str, first: bool, coordinates: str
) -> Chunk:
    """Named columns as a chunk."""
    import pandas as pd

    names = feature_names(n_dof, coordinates)
    if "xdot0" in values and "x0" in values and coordinates == "absolute":
        X: Any = pd.DataFrame({c: values[c] for c in (*names, "xdot0", "x0")}, copy=False)
    else:
        X = _stacked([values[c] for c in names])
    forces = [f"F{j}" for j in range(1, n_dof + 1)]
    F = _stacked([values[c] for c in forces]) if forces[0] in values else None
    time = values.get("t", values.get("time"))
    return Chunk(
        X, F, record, first, values.get("record"), time, values.get("ag"), {c: values[c] for c in covariates}
    )


def _stacked(columns: Sequence[np.ndarray]) -> np.ndarray:
    kind = np.result_type(*columns)
    out = np.empty((len(columns), len(columns[0])), dtype=kind if kind == np.float32 else np.float64)
    for row, column in zip(out, columns):
        row[:] = column
    return out.T


def seconds_since(time: Any, origin: Any) -> np.ndarray:
    """Times as seconds since an origin of the same kind; numbers are seconds already."""
    array = np.asarray(time)
    if array.dtype.kind in "mM":
        return (array - origin) / np.timedelta64(1, "ns") * 1e-9
    return seconds_of(array, "time")
