"""The small grammar that maps a column of a file to a channel. Nothing is ever evaluated as code.

[-] name [ "[:, k]" | "[k, :]" ] [* factor] [@ unit]
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ...exceptions import ChannelError, FileFormatError
from ..channels import FILLED, fillers
from .table import Table

GRAMMAR = '[-] name [:, k] * factor @ unit, e.g. "vir*35.1507", "-acc[:, 2] @ g", "laser @ mm"'

_PATTERN = re.compile(
    r"""\s*(?P<sign>-)?\s*
    (?:"(?P<quoted>[^"]+)"|(?P<name>[^"\[\]*@]+?))\s*
    (?:\[\s*(?:(?::\s*,\s*(?P<column>-?\d+))|(?:(?P<row>-?\d+)\s*,\s*:))\s*\])?\s*
    (?:\*\s*(?P<factor>[^*@\s]+))?\s*
    (?:@\s*(?P<unit>\S.*?))?\s*\Z""",
    re.VERBOSE,
)

_GROUPED = re.compile(r"[+-]?\d{1,3}([.,' \u00a0\u2009\u202f]\d{3})+([.,]\d*)?|[+-]?\d+\.\d*")


@dataclass(frozen=True)
class Expression:
    """A parsed mapping.

    Attributes
    ----------
    name : str
        Variable of the file.
    column, row : int or None
        Column or row of a matrix, from 0.
    factor : str or None
        A number, or the name of a scalar of the file.
    sign : int
    unit : str or None
    """

    name: str
    column: int | None = None
    row: int | None = None
    factor: str | None = None
    sign: int = 1
    unit: str | None = None


def parse(text: str, table: Table, channel: str) -> Expression:
    """Parse what a channel is mapped to."""
    if not isinstance(text, str):
        raise ChannelError(f"The mapping of {channel} is {text!r}, not a text", f"Write {GRAMMAR}.")
    if text.strip() in table.variables:
        return Expression(text.strip())
    match = _PATTERN.match(text)
    if match is None:
        raise ChannelError(f"The mapping {channel} = {text!r} is not understood", f"Write {GRAMMAR}.")
    return Expression(
        match["quoted"] or match["name"].strip(),
        None if match["column"] is None else int(match["column"]),
        None if match["row"] is None else int(match["row"]),
        match["factor"],
        -1 if match["sign"] else 1,
        match["unit"],
    )


def line_of(expression: Expression, table: Table, channel: str) -> np.ndarray:
    """The samples an expression means, before units are converted."""
    if expression.name not in table.variables:
        raise FileFormatError(
            f"{table.path} has no variable {expression.name!r} for channel {channel}", f"It holds {table.names}."
        )
    values = table.variables[expression.name]
    wanted = f"channel {channel} = {expression.name!r} of {table.path}"
    index = expression.column if expression.row is None else expression.row
    if index is not None:
        axis = 1 if expression.row is None else 0
        if values.ndim != 2 or not -values.shape[axis] <= index < values.shape[axis]:
            kind = "column" if axis else "row"
            raise FileFormatError(
                f"{wanted[0].upper()}{wanted[1:]} has the shape {values.shape}, there is no {kind} {index}",
                f"{kind.capitalize()}s count from 0.",
            )
        values = values[:, index] if axis else values[index]
    if values.ndim != 1:
        cure = (
            f"Pick one column, {expression.name}[:, 0], or one row, {expression.name}[0, :]."
            if values.ndim == 2
            else "Give one value per sample."
        )
        raise FileFormatError(
            f"{wanted[0].upper()}{wanted[1:]} has the shape {values.shape}, not one line of samples", cure
        )
    if channel == "t" and (values.dtype.kind in "mM" or expression.factor is None and values.dtype == object):
        return values
    line = _numbers(values, wanted, table.decimal)
    if channel != "t":
        filled = fillers(line)[1]
        if filled:
            raise FileFormatError(f"{wanted[0].upper()}{wanted[1:]} holds {filled}", FILLED)
    scale = expression.sign * _factor(expression, table, channel)
    return line if scale == 1 else line * scale


def _factor(expression: Expression, table: Table, channel: str) -> float:
    if expression.factor is None:
        return 1.0
    try:
        value = float(expression.factor)
    except ValueError:
        scalar = table.variables.get(expression.factor)
        if scalar is None or scalar.size != 1 or scalar.dtype.kind not in "iuf":
            raise ChannelError(
                f"The factor {expression.factor!r} of channel {channel} is no number, nor is one held by {table.path}",
                f"Write {GRAMMAR}.",
            ) from None
        value = float(scalar.reshape(())[()])
    if not np.isfinite(value) or value == 0:
        raise ChannelError(
            f"The factor {expression.factor!r} of channel {channel} is not a usable number",
            "Give a finite factor, not zero.",
        )
    return value


def _numbers(values: np.ndarray, wanted: str, decimal: str) -> np.ndarray:
    if values.dtype.kind == "c":
        raise FileFormatError(
            f"{wanted[0].upper()}{wanted[1:]} is complex", "A frequency response is read with read_frf (--frf)."
        )
    if values.dtype == np.float32 or values.dtype.kind in "biuf":
        return values if values.dtype == np.float32 else values.astype(float)
    import pandas as pd

    numbers = pd.to_numeric(pd.Series(values, dtype=object), errors="coerce").to_numpy(dtype=float)
    text = np.isnan(numbers) & ~pd.isna(values)
    if decimal == ",":  # then the point of '1.500' marks thousands, or the columns are written in two ways
        text |= pd.Series(values).astype(str).str.contains(".", regex=False).to_numpy(dtype=bool)
    if text.any():
        row = int(np.argmax(text))
        raise FileFormatError(
            f"{wanted[0].upper()}{wanted[1:]} holds the text {values[row]!r} in data row {row + 1}"
            + (", in a file with a decimal comma" if decimal == "," else ""),
            "Export numbers without marks of thousands, all with the same decimal mark."
            if _GROUPED.fullmatch(str(values[row]).strip())
            else "Remove it, or leave the cell empty where nothing was measured.",
        )
    return numbers
