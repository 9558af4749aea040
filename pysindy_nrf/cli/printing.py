"""Words, tables and data as they are printed."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from ..diagnosis.verdict import Verdict

# Columns of a line that a terminal shows whole.
WIDTH = 110
DIGITS = 4


def heading(text: str) -> str:
    """A heading with a blank line above."""
    return f"\n{text}\n{'-' * len(text)}"


def table_text(frame: pd.DataFrame) -> str:
    """A table of numbers."""
    return frame.to_string(float_format=_number)


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.{DIGITS}g}"


def paragraphs(notes: Sequence[str], first: str = "  - ") -> str:
    """Notes, one a paragraph, in lines that a terminal shows in full."""
    wrapper = textwrap.TextWrapper(
        WIDTH,
        initial_indent=first,
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(wrapper.fill(note) for note in notes)


def verdict_text(verdict: Verdict) -> str:
    """A verdict with its reasons, in lines that a terminal shows in full."""
    lines = [paragraphs([verdict.sentence], f"{verdict.state.upper()}: ")]
    if verdict.reasons:
        lines.append(paragraphs(verdict.reasons))
    if verdict.assumptions:
        lines.append(paragraphs(verdict.assumptions, "  Assumed: "))
    return "\n".join(lines)


def verdict_data(verdict: Verdict) -> dict[str, object]:
    """A verdict as plain data."""
    return {
        "state": verdict.state,
        "sentence": verdict.sentence,
        "reasons": verdict.reasons,
        "assumptions": verdict.assumptions,
    }


def printable(words: str) -> str:
    """Words whose control characters are shown, not obeyed by the terminal.

    The name of a file or of a channel may hold some.
    """
    signs = []
    for sign in words:
        shown = sign == "\n" or sign.isprintable()
        signs.append(sign if shown else repr(sign)[1:-1])
    return "".join(signs)


def plain(data: object) -> object:
    """Data as JSON holds them: no NumPy, no NaN."""
    data = _builtin(data)
    if isinstance(data, dict):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, (list, tuple, set)):
        return [plain(value) for value in data]
    if isinstance(data, float) and not math.isfinite(data):
        return None
    if data is None or isinstance(data, (int, float)):
        return data
    return str(data)


def _builtin(data: object) -> object:
    """Data of NumPy and pandas as Python's own."""
    if isinstance(data, pd.DataFrame):
        return data.to_dict("index")
    if isinstance(data, pd.Series):
        return data.to_dict()
    if isinstance(data, (np.generic, np.ndarray)):
        return data.tolist()
    return data
