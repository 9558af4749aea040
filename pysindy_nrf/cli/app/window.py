"""The folder of one window: its files, its mapping, its runs."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from ...common.files import atomic_write
from ...exceptions import NRFError
from ...records.checks.channel_checks import doubts_by_channel
from ...records.files import describe
from ...records.files.mapping import read_mapping
from ..exit_codes import ExitCode
from ..options import read_tests
from ..session import SHOW_PROGRESS

MAPPING, RESULT = "mapping.toml", "result"
PAGE = "closed_loop.html"
MODEL = "closed_loop.json"
WORKBOOK = "closed_loop.xlsx"
# Characters of a name of a file; no file system takes fewer than 255 bytes.
LONGEST_NAME = 60
# Seconds after which a run that does not stop is ended.
PATIENCE = 10.0


def safe_name(name: str, taken: Sequence[str] = ()) -> str:
    """A name of a file that leads nowhere else and is no option.

    Examples
    --------
    >>> from pysindy_nrf.cli.app.window import safe_name
    >>> safe_name("../../-x <b>.csv"), safe_name("a.csv", ["a.csv"])
    ('x _b_.csv', 'a-2.csv')
    """
    last = re.split(r"[\\/]", name)[-1]
    plain = re.sub(r"[^\w .()+=,-]", "_", last).lstrip(" .-=+") or "file"
    stem, dot, ending = plain.rpartition(".")
    stem, ending = (stem, dot + ending[:8]) if dot else (plain, "")
    stem = stem[:LONGEST_NAME] or "file"
    if stem + ending == MAPPING:
        stem += "-data"
    candidate, number = stem + ending, 2
    while candidate in taken:
        candidate, number = f"{stem}-{number}{ending}", number + 1
    return candidate


@dataclass(frozen=True)
class Look:
    """What the files hold by the mapping, before anything is solved.

    Parameters
    ----------
    words : str
        What was understood.
    doubts : dict of str to list of str
        What looks wrong, by channel; under ``""`` what is of no channel.
    error : str
        Why the files cannot be read; empty if they can.
    """

    words: str = ""
    doubts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    error: str = ""


@dataclass(frozen=True)
class Finding:
    """What a run found.

    Parameters
    ----------
    state, sentence : str
        Of the verdict; the state is ``"error"`` where there is none.
    reasons : sequence of str
    """

    state: str
    sentence: str
    reasons: Sequence[str] = ()


class Window:
    """Files of one window, in their own folder that goes with it."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="pysindy-nrf-"))
        self._process: subprocess.Popen[bytes] | None = None
        # what the run prints for programs, and what it shows of its progress
        self._answer: Path | None = None
        self._log: Path | None = None

    def place_for(self, name: str) -> Path:
        """Where a file that was dropped is kept."""
        taken = [path.name for path in self.folder.iterdir()]
        return self.folder / safe_name(name, taken)

    @property
    def mapping(self) -> Path:
        """The mapping file."""
        return self.folder / MAPPING

    @property
    def result(self) -> Path:
        """The folder of the last run."""
        return self.folder / RESULT

    def look(self) -> Look:
        """What the files hold, as ``inspect`` says it."""
        doubts: dict[str, list[str]] = {}
        try:
            readings = read_tests(read_mapping(self.mapping))
            for reading in readings:
                for channel, sentences in doubts_by_channel(reading.record).items():
                    doubts.setdefault(channel, []).extend(sentences)
        except (NRFError, OSError, ValueError) as error:
            return Look(error=str(error))
        return Look("\n\n".join(map(describe, readings)), doubts)

    def write_mapping(self, text: str) -> None:
        """Write the mapping file."""
        with atomic_write(self.mapping) as file:
            file.write(text)

    # -- the run -----------------------------------------------------------------------

    def command(self, options: Sequence[str]) -> str:
        """The command line that repeats the run, besides the mapping file."""
        return shlex.join(["pysindy-nrf", "run", "--mapping", MAPPING, *options])

    def start(self, options: Sequence[str]) -> None:
        """Start ``run`` in its own process."""
        self.stop()
        shutil.rmtree(self.result, ignore_errors=True)
        program = "from pysindy_nrf.cli import main; main()"
        arguments = ["run", "--mapping", MAPPING, "--json", "--excel", "--no-figures"]
        command = [sys.executable, "-c", program, *arguments, "-o", RESULT, *options]
        environment = os.environ | {SHOW_PROGRESS: "1", "PYTHONIOENCODING": "utf-8"}
        with self._file() as answer, self._file() as log:
            self._answer, self._log = Path(answer.name), Path(log.name)
            self._process = subprocess.Popen(
                command,
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=answer,
                stderr=log,
                env=environment,
            )

    def _file(self) -> IO[bytes]:
        """A file that a process writes while it is read."""
        return tempfile.NamedTemporaryFile(dir=self.folder, prefix="~", delete=False)

    @property
    def is_running(self) -> bool:
        """Whether a run goes on."""
        return self._process is not None and self._process.poll() is None

    @property
    def progress(self) -> str:
        """What the run does now."""
        steps = re.split(r"[\r\n]", _text_of(self._log))
        sentences = [step.strip() for step in steps if step.strip()]
        return sentences[-1] if sentences else "starting"

    def stop(self) -> None:
        """Stop the run, as Ctrl-C does; it leaves no half-written file."""
        if self._process is None or self._process.poll() is not None:
            return
        if os.name == "posix":
            self._process.send_signal(signal.SIGINT)
        else:
            self._process.terminate()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def finding(self) -> Finding:
        """What the run that ended found."""
        code = None if self._process is None else self._process.returncode
        if code == ExitCode.INTERRUPTED or (code is not None and code < 0):
            return Finding("stopped", "Stopped. Nothing was written.")
        if code not in (ExitCode.DONE, ExitCode.RED):
            return Finding("error", self.progress)
        answer = json.loads(_text_of(self._answer))
        verdict = answer["verdict"]
        return Finding(verdict["state"], verdict["sentence"], verdict["reasons"])

    def close(self) -> None:
        """Stop the run and remove the folder."""
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)


def _text_of(file: Path | None) -> str:
    """What a process has written so far."""
    return "" if file is None else file.read_text("utf-8", "replace")
