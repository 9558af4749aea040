"""What both commands share: words before the solve, the solve, words and files after it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

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

    def say(self, words: str) -> None:
        """Print words for people."""
        if not self.as_json:
            click.echo(words)

    def progress(self, items: Iterable[Any], label: str) -> Iterable[Any]:
        """A progress bar on the error stream of a terminal, nothing elsewhere."""
        from tqdm import tqdm

        return tqdm(list(items), desc=label, disable=None, leave=False, delay=0.5)

    def finish(
        self, outcome: Outcome, band: Any, folder: Path, figures: bool, records: list[dict], truth: Any = None
    ) -> None:
        """Say what was found and write it.

        Parameters
        ----------
        outcome : Outcome
        band : (float, float) or None
        folder : Path
        figures : bool
        records : list of dict
            What was understood, for JSON.
        truth : ChainModel, optional
        """
        self.say(text.result(outcome, band, truth))
        written = output.write_all(outcome, folder, band, figures)
        if self.as_json:
            data = text.as_data(outcome, band, records) | {"files": [str(p) for p in written]}
            click.echo(json.dumps(data, indent=2))
            return
        self.say(f"\nWritten to {folder}: {', '.join(p.name for p in written)}")
        if figures and not any(p.suffix == ".png" for p in written):
            from .figures import available

            if not available():
                self.say("No figures: matplotlib is not installed; pip install 'pysindy-nrf[plot]' brings it.")
