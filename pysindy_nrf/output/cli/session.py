"""What the commands share: words before the work, results as words or JSON, warnings at the end, errors in words."""

from __future__ import annotations

import json
import math
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

from ...exceptions import NRFWarning


class Session:
    """Where words go: to the terminal, or nowhere when a machine reads."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.warnings: list[str] = []

    def say(self, *words: str) -> None:
        """Print words for people, each on lines of its own."""
        if not self.as_json:
            click.echo(printable("\n".join(words)))

    def headed(self, title: str, *words: str) -> None:
        """Print words below a heading with a blank line above."""
        self.say(heading(title), *words)

    def measured(self, *descriptions: str) -> None:
        """Print what was understood of the records, the first thing a command says."""
        self.say("What was measured\n-----------------", *descriptions)

    def emit(self, data: dict[str, Any], files: Iterable[Path] = ()) -> None:
        """Print plain data for machines: strict JSON, a number that does not exist as null."""
        if self.as_json:
            whole = data | ({"warnings": self.warnings} if "warnings" not in data else {})
            whole |= {"files": [str(p) for p in files]}
            click.echo(json.dumps(plain(whole), indent=2, allow_nan=False))

    def progress(self, items: Iterable[Any], label: str) -> Iterable[Any]:
        """Items with a progress bar on the error stream of a terminal, without one elsewhere."""
        from tqdm import tqdm

        return tqdm(list(items), desc=label, disable=None, leave=False, delay=0.5)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Keep the warnings of the work for :meth:`take_care`, in place of Python's lines on the error stream."""
        with warned() as messages:
            try:
                yield
            finally:
                self.warnings += [one for one in messages() if one not in self.warnings]

    def take_care(self) -> None:
        """Print the warnings."""
        if self.warnings:
            self.headed("Take care", paragraphs(self.warnings))

    def finish(self, data: dict[str, Any], folder: Path, files: Sequence[Path]) -> None:
        """Print the data for machines, or for people what was written and the page to open."""
        self.emit(data, files)
        self.say(f"\nWritten to {folder}: {', '.join(p.name for p in files)}")
        for path in files:
            if path.suffix == ".html":
                self.say(f"Open {path} in a browser.")


@contextmanager
def warned() -> Iterator[Callable[[], list[str]]]:
    """Catch all warnings; the function returned gives those of the package so far, each once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", NRFWarning)
        yield lambda: list(dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, NRFWarning)))


def heading(text: str) -> str:
    """A heading with a blank line above."""
    return f"\n{text}\n{'-' * len(text)}"


def indent(text: str) -> str:
    """Text moved in by two blanks."""
    return textwrap.indent(text, "  ")


def table(frame: pd.DataFrame, digits: int = 4) -> str:
    """A table of numbers."""
    return frame.to_string(float_format=lambda x: "-" if np.isnan(x) else f"{x:.{digits}g}")


def paragraphs(notes: Sequence[str]) -> str:
    """Warnings, one a paragraph, in lines that a terminal shows whole."""
    lines = textwrap.TextWrapper(
        110, initial_indent="  - ", subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines.fill(note) for note in notes)


def printable(words: str) -> str:
    """Words whose control characters (of a channel's or file's name) are shown, not obeyed by the terminal."""
    return "".join(c if c == "\n" or c.isprintable() else repr(c)[1:-1] for c in words)


def plain(data: Any) -> Any:
    """Data as JSON holds them: no NumPy, no NaN."""
    if isinstance(data, dict):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, (list, tuple, set, np.ndarray)):
        return [plain(value) for value in data]
    if isinstance(data, pd.DataFrame):
        return plain(data.to_dict("index"))
    if isinstance(data, pd.Series):
        return plain(data.to_dict())
    if isinstance(data, (bool, np.bool_)):
        return bool(data)
    if isinstance(data, (int, np.integer)):
        return int(data)
    if isinstance(data, (float, np.floating)):
        return float(data) if math.isfinite(data) else None
    return data if data is None else str(data)
