"""What the commands share: words before the work, progress, results as words or JSON, warnings at the end."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd

from ...exceptions import NRFWarning
from . import output, text
from .work import Outcome


class Session:
    """Where words go: to the terminal, or nowhere when a machine reads.

    Parameters
    ----------
    as_json : bool
    """

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.warnings: list[str] = []

    def say(self, words: str) -> None:
        """Print words for people."""
        if not self.as_json:
            click.echo(printable(words))

    def emit(self, data: dict[str, Any], files: Iterable[Path] = ()) -> None:
        """Print plain data for machines: strict JSON, a number that does not exist as null."""
        if self.as_json:
            whole = data | ({"warnings": self.warnings} if "warnings" not in data else {})
            whole |= {"files": [str(p) for p in files]}
            click.echo(json.dumps(plain(whole), indent=2, allow_nan=False))

    def progress(self, items: Iterable[Any], label: str) -> Iterable[Any]:
        """A progress bar on the error stream of a terminal, nothing elsewhere."""
        from tqdm import tqdm

        return tqdm(list(items), desc=label, disable=None, leave=False, delay=0.5)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Keep the warnings of the work for :meth:`take_care`, in place of Python's lines on the error stream."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", NRFWarning)
            try:
                yield
            finally:
                kept = [str(w.message) for w in caught if issubclass(w.category, NRFWarning)]
                self.warnings += [one for one in dict.fromkeys(kept) if one not in self.warnings]

    def take_care(self) -> None:
        """Say the warnings."""
        if self.warnings:
            self.say(text.heading("Take care"))
            self.say(text.take_care(self.warnings))

    def written(self, folder: Path, files: list[Path]) -> None:
        """Say what was written."""
        self.say(f"\nWritten to {folder}: {', '.join(p.name for p in files)}")

    def finish(
        self,
        outcome: Outcome,
        band: Any,
        folder: Path,
        figures: bool,
        records: list[dict],
        truth: Any = None,
        page_of: Any = None,
        **files: Any,
    ) -> None:
        """Say what was found and write it."""
        self.say(text.result(outcome, band, truth))
        written = output.write_all(outcome, folder, band, figures, records=page_of, **files)
        self.emit(text.as_data(outcome, band, records), written)
        self.written(folder, written)
        if figures and not any(p.suffix == ".png" for p in written):
            from ..displays._matplotlib import available

            if not available():
                self.say("No figures: matplotlib is not installed; pip install 'pysindy-nrf[plot]' brings it.")
        pages = [p for p in written if p.suffix == ".html"]
        if pages:
            self.say(f"Open {pages[0]} in a browser.")
        elif outcome.frf is None:
            self.say("No page: pip install 'pysindy-nrf[report]' brings what it needs.")


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
