"""Columns of X and F: the names of tables, the order of plain arrays, the time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from ..exceptions import ChannelError
from .channels import as_matrix, as_pandas
from .dataset import feature_names, numbered

_TIME = ("t", "time")
# Rate and displacement of a moving base, beside motions in absolute coordinates.
_BASE = ("xdot0", "x0")
_SHOWN = 9  # names in a message


@dataclass(frozen=True)
class MotionColumns:
    """The columns of X in their order.

    Attributes
    ----------
    matrix : ndarray of shape (n_samples, 3 n_dof)
        Accelerations, rates and displacements.
    names : list of str
    base_motion : ndarray of shape (n_samples, 2) or None
        Rate and displacement of a moving base, in absolute coordinates.
    time : array-like or None
        From a column or the index of a table.
    """

    matrix: np.ndarray
    names: list[str]
    base_motion: np.ndarray | None = None
    time: ArrayLike | None = None

    @property
    def n_dof(self) -> int:
        """Degrees of freedom."""
        return self.matrix.shape[1] // 3


def motion_columns(
    X: ArrayLike | pd.DataFrame, coordinates: str, n_dof: int | None
) -> MotionColumns:
    """Read the columns of a table by name, those of an array by position.

    Raises
    ------
    ChannelError
        If there are no rows, or columns are missing, unknown or too many.
    """
    X = as_pandas(X)
    if hasattr(X, "columns"):
        columns = _columns_of_table(X, coordinates, n_dof)
    else:
        columns = _columns_of_array(X, coordinates, n_dof)

    if not len(columns.matrix):
        raise ChannelError(
            "X has no samples (0 rows)",
            "Give at least as many samples as a balance has unknowns.",
        )
    return columns


def _columns_of_array(
    X: ArrayLike, coordinates: str, n_dof: int | None
) -> MotionColumns:
    matrix = as_matrix(X, _labels_of_array(X, coordinates), what="columns of X")
    width = matrix.shape[1]
    names = feature_names(n_dof or max(1, width // 3), coordinates)
    shown = ", ".join(names[:_SHOWN])

    # in the words that scikit-learn's checks expect
    if width == 0:
        raise ChannelError(
            f"X has 0 feature(s) (shape={matrix.shape}) while a minimum of 1 is"
            " required",
            f"Give {shown}.",
        )
    if width % 3 or (n_dof and width != 3 * n_dof):
        needed = f"{3 * n_dof} are needed" if n_dof else "a multiple of 3 is needed"
        raise ChannelError(
            f"X has {width} columns (n_features = {width}), {needed}",
            "Give accelerations, inter-storey velocities and drifts of all DOFs:"
            f" {shown}.",
        )
    return MotionColumns(matrix, names)


def _labels_of_array(X: ArrayLike, coordinates: str) -> list[str] | str:
    """Names of the columns for messages; a prefix where their number is wrong."""
    try:
        shape = np.shape(np.asarray(X))
    except ValueError:  # lists of different lengths
        return "column "
    if len(shape) != 2 or not shape[1] or shape[1] % 3:
        return "column "
    return feature_names(shape[1] // 3, coordinates)


def _columns_of_table(
    table: pd.DataFrame, coordinates: str, n_dof: int | None
) -> MotionColumns:
    present = _labels_by_meaning(table, coordinates)
    n = n_dof or number_of_dofs(present)
    wanted = feature_names(max(n, 1), coordinates)
    _require_known_names(present, wanted, coordinates)

    labels = [present[name] for name in wanted]
    in_order = table if labels == list(table.columns) else table[labels]
    matrix = as_matrix(in_order, wanted, what="X")

    base = [name for name in _BASE if name in present]
    if len(base) == 1:
        raise ChannelError(
            "X has only one of the columns xdot0 and x0",
            "Give both, or neither for a base at rest.",
        )
    base_motion = as_matrix(table[base], base, what="X") if base else None
    return MotionColumns(matrix, wanted, base_motion, table_time(table))


def _labels_by_meaning(table: pd.DataFrame, coordinates: str) -> dict[str, str]:
    """Label of every column by its meaning; v1 may stand for xdot1."""
    present: dict[str, str] = {}
    for label in map(str, table.columns):
        name = label
        if coordinates == "absolute" and label[:1] == "v" and label[1:].isdigit():
            name = f"xdot{label[1:]}"
        if name in present:
            raise ChannelError(
                f"Column {label!r} is in X more than once", "Rename or drop one."
            )
        present[name] = label
    return present


def number_of_dofs(names: Iterable[str]) -> int:
    """DOFs that have a column a1, a2, ...; a0 is none."""
    return sum(name[:1] == "a" and name[1:].isdigit() for name in {*names} - {"a0"})


def _require_known_names(
    present: dict[str, str], wanted: list[str], coordinates: str
) -> None:
    allowed = {*wanted, *_TIME}
    if coordinates == "absolute":
        allowed.update(_BASE)
    # in the order of the columns
    missing = [name for name in wanted if name not in present]
    unknown = [name for name in present if name not in allowed]
    faults = []
    if missing:
        faults.append(f"lacks {', '.join(missing[:6])}")
    if unknown:
        column = "column" if len(unknown) == 1 else "columns"
        faults.append(f"has the unknown {column} {', '.join(unknown[:6])}")
    if faults:
        rate, drift = ("v", "s") if coordinates == "relative" else ("xdot", "x")
        raise ChannelError(
            f"X {' and '.join(faults)}",
            f"Name the columns a1.., {rate}1.., {drift}1..; covariates and base"
            " acceleration are passed in addition to X.",
        )


def table_time(X: object) -> pd.Index | np.ndarray | None:
    """Time of the rows of a table, from a column or the index; None if it has none."""
    if not isinstance(X, pd.DataFrame):
        return None
    for name in _TIME:
        if name in X.columns:
            return X[name].to_numpy()
    if X.index.dtype.kind in "mM":
        return X.index
    return X.index.to_numpy() if X.index.name in _TIME else None


def force_matrix(
    F: ArrayLike | pd.DataFrame | None, columns: MotionColumns, X: object
) -> np.ndarray:
    """Forces as a matrix with a column for each DOF; zeros if there are none.

    Raises
    ------
    ChannelError
        If rows or columns are not those of X.
    """
    n_samples, n = len(columns.matrix), columns.n_dof
    if F is None:
        return np.zeros((n_samples, n))
    F = as_pandas(F)
    if hasattr(F, "columns"):
        _require_order_of(X, F)
        F = forces_by_name(F, n)

    force = as_matrix(F, "F", n, "forces F")
    if len(force) != n_samples:
        raise ChannelError(
            f"F has {len(force)} samples, X has {n_samples}",
            "Cut both to the same clock.",
        )
    return force


def _require_order_of(X: object, F: pd.DataFrame) -> None:
    """Refuse tables whose rows have the same labels in another order."""
    if not isinstance(X, pd.DataFrame) or len(X) != len(F) or X.index.equals(F.index):
        return
    if not X.index.symmetric_difference(F.index).size:
        raise ChannelError(
            "The rows of X and F have the same labels in another order",
            "Sort both the same way.",
        )


def forces_by_name(F: pd.DataFrame, n: int) -> pd.DataFrame:
    """Forces in the order F1..Fn; as in files, a DOF without a column has no force."""
    wanted = numbered("F", n)
    names = list(map(str, F.columns))

    unique = len(set(names)) == len(names)
    if unique and set(names) <= set(wanted):
        F = F.set_axis(names, axis=1)
        return F if names == wanted else F.reindex(columns=wanted, fill_value=0.0)

    plain_numbers = names == list(map(str, range(n)))
    if plain_numbers or len(names) == n == 1:
        return F
    raise ChannelError(
        f"F has the columns {', '.join(names[:_SHOWN])}",
        f"Name them {', '.join(wanted)}, or pass F.to_numpy() in that order.",
    )
