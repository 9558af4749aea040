"""What a running command says, and where it writes."""

from __future__ import annotations

import itertools
import json
import os
import shlex
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from ..exceptions import NRFWarning
from .printing import heading, paragraphs, plain, printable
from .results import Results

# What a running command keeps beside its options: whether it may write over files, and
# the files that a mapping file names.
FORCE, NAMED_FILES = "force", "files of the mapping"
# Set in the environment of a run whose error stream is read by a program.
SHOW_PROGRESS = "PYSINDY_NRF_PROGRESS"
_PACKAGE = Path(__file__).parents[1]


class Session:
    """Words of a running command, and the place of its results.

    Files are written before results are printed: whoever stops reading loses none.

    Parameters
    ----------
    as_json : bool
        Whether a machine reads: then nothing is printed but one JSON object.

    Attributes
    ----------
    warnings : list of str
        What is to be taken care of.
    """

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json
        self.warnings: list[str] = []
        self._sections: list[str] = []
        self._results = _place_of_results()

    @property
    def results(self) -> Results:
        """Where the running command writes."""
        assert self._results is not None, "the command has no option --output"
        return self._results

    def say(self, *words: str) -> None:
        """Print words for people at once, each on separate lines."""
        if not self.as_json:
            _print(printable("\n".join(words)))

    def headed(self, title: str, *words: str) -> None:
        """Print words below a heading with a blank line above."""
        self.say(heading(title), *words)

    def measured(self, *descriptions: str) -> None:
        """Print what was understood of the records, the first thing a command says."""
        self.say("What was measured\n-----------------", *descriptions)
        say_if_compiling()

    def conclude(self, *words: str) -> None:
        """Keep words of the result, which are printed when the files are in place."""
        self._sections += words

    def conclude_headed(self, title: str, *words: str) -> None:
        """Keep words of the result below a heading."""
        self.conclude(heading(title), *words)

    def add_warnings(self, warnings: Iterable[str]) -> None:
        """Add warnings, each once."""
        for warning in warnings:
            if warning not in self.warnings:
                self.warnings.append(warning)

    def drop_warnings(self, others: Iterable[str]) -> None:
        """Drop the warnings that are given elsewhere."""
        elsewhere = set(others)
        self.warnings = [
            warning for warning in self.warnings if warning not in elsewhere
        ]

    def take_care(self) -> None:
        """Print the warnings."""
        if self.warnings:
            self.headed("Take care", paragraphs(self.warnings))

    def emit(self, data: Mapping[str, object], files: Iterable[Path] = ()) -> None:
        """Print plain data for machines: strict JSON."""
        if not self.as_json:
            return
        names = [str(path) for path in files]
        warnings = data.get("warnings", self.warnings)
        document = {**data, "warnings": warnings, "files": names}
        _print(json.dumps(plain(document), indent=2, allow_nan=False))

    @contextmanager
    def listening(self, label: str = "working") -> Iterator[Callable[[], None]]:
        """Keep the warnings of the work, and show that it goes on.

        Gives a function to be called once for each law that is tried.
        """
        with warned() as messages, working(label) as tick:
            try:
                yield tick
            finally:
                self.add_warnings(messages())

    def provenance(self) -> dict[str, object]:
        """The command, and the files that it read with their SHA-256."""
        words = click.get_current_context().obj or []
        command = shlex.join(["pysindy-nrf", *words])
        return {"command": command, "inputs": self.results.sources}

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """A folder for the results, which are moved into place together at the end.

        Then, or if they could not be written, the words of the result are printed.
        """
        context = click.get_current_context()
        about = {
            "command": context.info_name,
            "arguments": context.obj,
            "settings": plain(context.params),
        }
        try:
            with working("writing"), self.results.aside(about) as folder:
                yield folder
        finally:
            if self._sections:
                self.say(*self._sections)
            self.take_care()

    def finish(self, data: Mapping[str, object], files: Sequence[Path]) -> None:
        """Print the data for machines, or what was written and the page to open."""
        home = self.results.home
        places = [home / path.name for path in files]
        self.emit(data, places)
        names = ", ".join(path.name for path in places)
        self.say(f"\nWritten to {home}: {names}")
        for path in places:
            if path.suffix == ".html":
                self.say(f"Open {path} in a browser.")


def _place_of_results() -> Results | None:
    """Where the running command writes; None if it has no option for that."""
    context = click.get_current_context()
    inputs: list[Path] = context.meta.setdefault(NAMED_FILES, [])
    kind = None
    for parameter in context.command.params:
        value = context.params.get(str(parameter.name))
        if parameter.name == "output":
            kind = parameter.type
            continue
        values = value if isinstance(value, tuple) else (value,)
        inputs += [path for path in values if isinstance(path, Path)]

    if not isinstance(kind, click.Path):
        return None
    output = context.params["output"]
    return Results(output, kind.file_okay, inputs, context.meta.get(FORCE, False))


def _print(words: str) -> None:
    """Print words; once nobody reads them, they and all that follow are dropped."""
    try:
        click.echo(words)
    except BrokenPipeError:
        # the end of the process flushes the stream again, which must not fail either
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


@contextmanager
def working(label: str) -> Iterator[Callable[[], None]]:
    """Show on the error stream of a terminal what goes on, and for how long.

    Gives a function to be called once for each law that is tried.
    """
    from tqdm import tqdm

    # None: shown on terminals only
    hidden = False if os.environ.get(SHOW_PROGRESS) else None
    shape = "{desc}, {elapsed}"
    bar = tqdm(bar_format=shape, desc=label, disable=hidden, leave=False)
    n_tried, done = itertools.count(1), threading.Event()

    def tick() -> None:
        bar.set_description_str(f"laws tried: {next(n_tried)}", refresh=False)

    def watch() -> None:
        while not done.wait(1.0):
            bar.refresh()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield tick
    finally:
        done.set()
        watcher.join()
        bar.close()


@contextmanager
def warned() -> Iterator[Callable[[], list[str]]]:
    """Catch all warnings; gives a function that lists those of the package so far."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", NRFWarning)

        def messages() -> list[str]:
            texts = []
            for entry in caught:
                if issubclass(entry.category, NRFWarning):
                    texts.append(str(entry.message))
            return list(dict.fromkeys(texts))

        yield messages


def say_if_compiling() -> None:
    """Announce the first run, for which the numerical functions are compiled.

    Numba is not loaded to find out: the index of compiled equations shows it.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    places = [_PACKAGE, Path.home() / ".cache" / "numba"]
    if chosen:
        places = [Path(chosen)]
    for place in places:
        for folder in place.rglob("equations*"):
            if any(folder.rglob("*.nbi")):
                return
    click.echo("compiling, once, about 10 s", err=True)
