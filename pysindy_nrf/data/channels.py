"""What a channel may hold: numbers, the rule for NaN and zero, and messages that name it.

Per record: a column of NaN = not measured (a force: unknown); leading and trailing NaN rows =
filter edges, masked and counted; any other NaN and every infinity = an error.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..exceptions import ChannelError, ChannelTypeError, DataQualityWarning

EDGES_LEAVE = 0.5  # of the rows of a record: filters that leave less than half of it are not edges


def rows_text(rows: np.ndarray, most: int = 3) -> str:
    """Row numbers for a message, e.g. ``"rows 17, 18, 19 and 4 more"``."""
    shown = ", ".join(str(int(r)) for r in rows[:most])
    more = f" and {len(rows) - most} more" if len(rows) > most else ""
    return f"row{'s' if len(rows) > 1 else ''} {shown}{more}"


def as_matrix(
    value: Any, names: Sequence[str] | str, n_columns: int | None = None, what: str = "channels"
) -> np.ndarray:
    """A real float matrix, one column for each channel, or an error that names the channel."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(float), np.nan)
    if hasattr(value, "nnz") and hasattr(value, "toarray"):
        raise ChannelError(f"The {what} are sparse, which is not supported", "Give a dense array: .toarray().")
    if hasattr(value, "to_numpy"):
        value = value.to_numpy()
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        raise ChannelError(
            f"The {what} differ in length", "Give one row per sample and one column per channel."
        ) from None
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise ChannelError(
            f"The {what} have {array.ndim} dimensions", "Give one row per sample and one column per channel."
        )

    def name(i: int) -> str:
        return f"{names}{i + 1}" if isinstance(names, str) else str(names[i])

    if n_columns is not None and array.shape[1] != n_columns:
        raise ChannelError(
            f"The {what} have {array.shape[1]} columns, {n_columns} are needed",
            f"Expected {', '.join(name(i) for i in range(min(n_columns, 12)))}{', ...' if n_columns > 12 else ''}.",
        )
    if array.dtype == np.float32 or array.dtype == np.float64:
        return array
    if np.iscomplexobj(array):
        raise ChannelError(
            f"Complex data not supported: channel {name(0)} of the {what} is complex",
            "Give real time series; take .real if the imaginary part is zero.",
        )
    if array.dtype.kind == "b" and not what.startswith("covariate"):
        raise ChannelError(f"Channel {name(0)} of the {what} holds truth values", "Give the measured numbers.")
    if array.dtype == np.float16:
        lost = f"Channel {name(0)} of the {what} is float16, which holds three digits"
        warnings.warn(DataQualityWarning(lost, "Save the channels as float32 or float64."), stacklevel=2)
    if array.dtype.kind in "biuf":
        return array.astype(np.float64)
    out = np.empty(array.shape)
    for i in range(array.shape[1]):
        try:
            if array.dtype.kind in "mMSV":  # NumPy would turn dates into nanoseconds
                raise TypeError
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                out[:, i] = array[:, i].astype(np.float64)
        except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
            kind = ChannelTypeError if isinstance(error, TypeError) and array.dtype == object else ChannelError
            raise kind(
                f"Channel {name(i)} of the {what} does not hold numbers" + (f" ({error})" if str(error) else ""),
                "Convert it to float (decimal point, no text).",
            ) from None
    return out


def finite_span(columns: Sequence[np.ndarray], names: Sequence[str], record: str = "") -> slice:
    """Rows between the leading and trailing NaN edges, after checking what lies between."""
    where = f" of {record}" if record else ""
    n = len(columns[0]) if columns else 0
    first, last, shortest, worst = 0, n, n, ""
    for column, name in zip(columns, names):
        good = np.isfinite(column)
        if good.all():
            continue
        infinite = np.flatnonzero(np.isinf(column))
        if infinite.size:
            raise ChannelError(
                f"Channel {name}{where} is infinite in {rows_text(infinite)}", "Repair or cut these rows."
            )
        inside = np.flatnonzero(good)
        if not inside.size:
            raise ChannelError(f"Channel {name}{where} holds nothing but NaN", "Leave it out, or measure it.")
        start, stop = inside[0], inside[-1] + 1
        holes = start + np.flatnonzero(~good[start:stop])
        if holes.size:
            raise ChannelError(
                f"Channel {name}{where} is NaN in {rows_text(holes)}",
                "Split the record there, or fill the gap; only leading and trailing NaN rows are masked.",
            )
        first, last = max(first, start), min(last, stop)
        if stop - start < shortest:
            shortest, worst = stop - start, name
    if last - first < EDGES_LEAVE * n:
        lost = (
            f"NaN at the edges leave {max(0, last - first)} of {n} rows{where}; channel {worst} is measured in "
            f"{shortest} of them"
        )
        warnings.warn(
            DataQualityWarning(lost, f"Cut the record to the rows that count, or leave {worst} out."), stacklevel=2
        )
    return slice(first, max(first, last))


# What programs write where nothing was measured, of either sign: loggers, weather and earthquake data.
_FILLERS = np.array([999.0, 999.25, 9999.0, 99999.0, 999999.0, 9999999.0, 1e30, 1e35, 1e37, 9.9e37, 1e38])
FILLED = (
    "Leave those cells empty (NaN); inside a record, split it there (signals.alignment.split_at_gaps) or fill the "
    "gap."
)
_APART = 5.0  # times the largest other value: a channel that reaches such a number by itself comes near it, too


def fillers(line: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows that hold a number standing for "not measured", -9999 and the like, far beyond all others."""
    none = np.zeros(0, dtype=int), ""
    size = np.abs(line)
    most = np.fmax.reduce(size, initial=0.0)
    if not np.isclose(_FILLERS, most, rtol=1e-6, atol=0.0).any():
        return none
    rows = np.flatnonzero(size == most)
    others = np.where(size < most, size, 0.0).max()
    by_chance = len(rows) == 1 and line[rows[0]] > 0  # a blow may reach 999 N, once
    if by_chance or others * _APART > most or 2 * len(rows) > len(line):
        return none
    said = f"{line[rows[0]]:g} in {rows_text(rows)}, far beyond all others: a number that stands for 'not measured'"
    return rows, said
