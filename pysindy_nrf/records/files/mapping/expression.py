"""The grammar of one mapping, and the samples that it stands for.

A term is ``[-] name [ "[:, k]" | "[k, :]" ] [* factor]``. A mapping is ``term [@
unit]``, or ``mean(term, term, ..) [* factor] [@ unit]`` and the same with ``sum``.
Nothing is evaluated as code.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from ....exceptions import ChannelError, FileFormatError
from ...channels import FILLED, fillers
from ..table import Table

GRAMMAR = (
    '[-] name [:, k] * factor @ unit, e.g. "vir*35.1507", "-acc[:, 2] @ g", "laser'
    ' @ mm", or "mean(left, right) @ g"'
)
_PATTERN = re.compile(
    r"""\s*(?P<sign>-)?\s*
    (?:"(?P<quoted>[^"]+)"|(?P<name>[^"\[\]*@]+?))\s*
    (?:\[\s*(?:(?::\s*,\s*(?P<column>-?\d+))|(?:(?P<row>-?\d+)\s*,\s*:))\s*\])?\s*
    (?:\*\s*(?P<factor>[^*@\s]+))?\s*
    (?:@\s*(?P<unit>\S.*?))?\s*\Z""",
    re.VERBOSE,
)
_COMBINED = re.compile(
    r"""\s*(?P<sign>-)?\s*(?P<combine>mean|sum)\((?P<terms>.*)\)\s*
    (?:\*\s*(?P<factor>[^*@\s]+))?\s*
    (?:@\s*(?P<unit>\S.*?))?\s*\Z""",
    re.VERBOSE,
)
_TERM = re.compile(r"""(?:"[^"]*"|\[[^\]]*\]|[^,"\[])+""")
# Numbers with marks of thousands, or with another decimal mark than the file's.
_GROUPED_DIGITS = re.compile(
    r"[+-]?\d{1,3}([.,' \u00a0\u2009\u202f]\d{3})+([.,]\d*)?|[+-]?\d+\.\d*"
)


def as_name(name: str) -> str:
    """A name as a mapping writes it: in quotes if it holds marks of the grammar."""
    return f'"{name}"' if re.search(r"[\[\]*@(),]|^-", name) else name


@dataclass(frozen=True)
class Expression:
    """A parsed mapping.

    Parameters
    ----------
    name : str
        A variable of the file; empty for a mean or a sum.
    column, row : int, optional
        Of a matrix, counted from 0.
    factor : str, optional
        A number, or the name of a variable that holds one.
    sign : {1, -1}
    unit : str, optional
    combine : {"", "mean", "sum"}
        What is made of the terms.
    terms : tuple of Expression
    """

    name: str
    column: int | None = None
    row: int | None = None
    factor: str | None = None
    sign: int = 1
    unit: str | None = None
    combine: str = ""
    terms: tuple[Expression, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Variables of the file that it uses."""
        names = [term.name for term in self.terms]
        return tuple(names) or (self.name,)

    @property
    def text(self) -> str:
        """The mapping without its unit."""
        name = self.name
        if self.combine:
            name = f"{self.combine}({', '.join(term.text for term in self.terms)})"
        text = f"-{name}" if self.sign < 0 else name
        if self.column is not None:
            text += f"[:, {self.column}]"
        if self.row is not None:
            text += f"[{self.row}, :]"
        if self.factor:
            text += f" * {self.factor}"
        return text


def parse(text: str, table: Table, channel: str) -> Expression:
    """Parse the mapping of a channel.

    Raises
    ------
    ChannelError
        If it is not of the grammar. Names of variables are a mapping as they are.
    """
    if not isinstance(text, str):
        raise ChannelError(
            f"The mapping of {channel} is {text!r}, not a text", f"Write {GRAMMAR}."
        )
    if text.strip() in table.variables:
        return Expression(text.strip())

    combined = _COMBINED.match(text)
    if combined is not None:
        return _combination(combined, table, channel)

    match = _PATTERN.match(text)
    if match is None:
        raise ChannelError(
            f"The mapping {channel} = {text!r} is not understood", f"Write {GRAMMAR}."
        )
    return Expression(
        name=match["quoted"] or match["name"].strip(),
        column=_integer(match["column"]),
        row=_integer(match["row"]),
        factor=match["factor"],
        sign=-1 if match["sign"] else 1,
        unit=match["unit"],
    )


def _combination(match: re.Match, table: Table, channel: str) -> Expression:
    """A mean or a sum of terms."""
    texts = [text.strip() for text in _TERM.findall(match["terms"])]
    terms = tuple(parse(text, table, channel) for text in texts if text)
    if len(terms) < 2 or any(term.unit or term.combine for term in terms):
        raise ChannelError(
            f"The mapping {channel} = {match[0]!r} is not understood",
            "Write mean(left, right) @ unit: two terms or more, one unit behind them.",
        )
    return Expression(
        name="",
        factor=match["factor"],
        sign=-1 if match["sign"] else 1,
        unit=match["unit"],
        combine=match["combine"],
        terms=terms,
    )


def _integer(text: str | None) -> int | None:
    return None if text is None else int(text)


def line_of(expression: Expression, table: Table, channel: str) -> np.ndarray:
    """Samples of a mapping, shape (n_samples,), before units are converted.

    Time stamps of channel ``t`` are left as they are.

    Raises
    ------
    FileFormatError
        If the file has no such variable, or it is not one line of numbers.
    ChannelError
        If the factor is not a usable number.
    """
    if expression.combine:
        return _combined(expression, table, channel)
    if expression.name not in table.variables:
        raise _no_variable(expression.name, table, channel)
    title = f"Channel {channel} = {expression.name!r} of {table.path}"
    values = _picked(table.variables[expression.name], expression, title)

    if channel == "t":
        is_text = values.dtype == object and expression.factor is None
        if is_text or values.dtype.kind in "mM":
            return values
    line = _numbers(values, title, table.decimal)
    if channel != "t":
        _, filled = fillers(line)
        if filled:
            raise FileFormatError(f"{title} holds {filled}", FILLED)

    scale = expression.sign * _factor(expression.factor, table, channel)
    return line if scale == 1 else line * scale


def _combined(expression: Expression, table: Table, channel: str) -> np.ndarray:
    """Samples of a mean or a sum; where a term is empty, so is the result."""
    lines = [line_of(term, table, channel) for term in expression.terms]
    lengths = sorted({len(line) for line in lines})
    if len(lengths) > 1:
        raise ChannelError(
            f"Channel {channel} = {expression.text!r}: its terms have"
            f" {' and '.join(map(str, lengths))} samples",
            "Combine columns of one length.",
        )
    total = np.sum(lines, axis=0)
    if expression.combine == "mean":
        total = total / len(lines)
    return total * (expression.sign * _factor(expression.factor, table, channel))


def _no_variable(name: str, table: Table, channel: str) -> FileFormatError:
    """Error that proposes the variable of the nearest name."""
    by_small_letters = {variable.lower(): variable for variable in table.variables}
    nearest = difflib.get_close_matches(name.lower(), by_small_letters, 1, 0.5)
    what = f"{table.path} has no variable {name!r} for channel {channel}"
    if nearest:
        what += f"; did you mean {by_small_letters[nearest[0]]!r}?"
    return FileFormatError(what, f"It holds {table.names}.")


def _picked(values: np.ndarray, expression: Expression, title: str) -> np.ndarray:
    """One line of samples: the variable, or the column or row of a matrix."""
    for kind, axis, index in (
        ("column", 1, expression.column),
        ("row", 0, expression.row),
    ):
        if index is None:
            continue
        if values.ndim != 2 or not -values.shape[axis] <= index < values.shape[axis]:
            raise FileFormatError(
                f"{title} has the shape {values.shape}, there is no {kind} {index}",
                f"{kind.capitalize()}s count from 0.",
            )
        values = values.take(index, axis)

    if values.ndim == 1:
        return values
    cure = "Give one value per sample."
    if values.ndim == 2:
        name = expression.name
        cure = f"Pick one column, {name}[:, 0], or one row, {name}[0, :]."
    raise FileFormatError(
        f"{title} has the shape {values.shape}, not one line of samples", cure
    )


def _factor(factor: str | None, table: Table, channel: str) -> float:
    """The number of a factor, which may be the name of one in the file."""
    if factor is None:
        return 1.0

    try:
        value = float(factor)
    except ValueError:
        scalar = table.variables.get(factor)
        if scalar is None or scalar.size != 1 or scalar.dtype.kind not in "iuf":
            raise ChannelError(
                f"The factor {factor!r} of channel {channel} is neither a number nor"
                f" the name of one in {table.path}",
                f"Write {GRAMMAR}.",
            ) from None
        value = float(scalar.item())

    if not np.isfinite(value) or value == 0:
        raise ChannelError(
            f"The factor {factor!r} of channel {channel} is not a usable number",
            "Give a finite factor, not zero.",
        )
    return value


def _numbers(values: np.ndarray, title: str, decimal: str) -> np.ndarray:
    """Values as floats; single precision stays single."""
    if values.dtype.kind == "c":
        raise FileFormatError(
            f"{title} is complex",
            "A frequency response is read with read_frf (--frf).",
        )
    if values.dtype == np.float32:
        return values
    if values.dtype.kind in "biuf":
        return values.astype(float)

    objects = pd.Series(values, dtype=object)
    numbers = pd.to_numeric(objects, errors="coerce").to_numpy(dtype=float)
    is_text = np.isnan(numbers) & ~pd.isna(values)
    if decimal == ",":
        # the point of "1.500" marks thousands, or the file mixes two decimal marks
        has_point = pd.Series(values).astype(str).str.contains(".", regex=False)
        is_text |= has_point.to_numpy(dtype=bool)
    if is_text.any():
        row = int(np.argmax(is_text))
        raise _text_among_numbers(values[row], row, title, decimal)
    return numbers


def _text_among_numbers(
    value: object, row: int, title: str, decimal: str
) -> FileFormatError:
    """Error for a cell that is no number."""
    cure = "Remove it, or leave the cell empty where nothing was measured."
    if _GROUPED_DIGITS.fullmatch(str(value).strip()):
        cure = (
            "Export numbers without marks of thousands, all with the same decimal mark."
        )
    mark = ", in a file with a decimal comma" if decimal == "," else ""
    return FileFormatError(
        f"{title} holds the text {value!r} in data row {row + 1}{mark}", cure
    )
