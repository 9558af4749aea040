"""Results of a run: written aside, then moved into place together, with a manifest.

A manifest names the files of a run with their SHA-256. A run replaces files that an
earlier one made and nobody changed, and no others. Earlier results that share a file
with it, or came from other inputs, go.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TypedDict

from ..common.audit import versions
from ..common.files import (
    UNFINISHED_SUFFIX,
    atomic_write,
    file_behind,
    hold,
    left_behind,
)
from ..exceptions import NRFError

MANIFEST = "manifest.json"
_SCHEMA, _VERSION = "pysindy_nrf.Manifest", 1
# In the folder that a run writes to: what it has locked, and what it replaces.
_LOCK, _REPLACED = "lock", "replaced"


class Source(TypedDict):
    """A file that a run reads."""

    file: str
    bytes: int
    sha256: str


class Run(TypedDict):
    """What a manifest says of one run, among other things."""

    inputs: list[Source]
    files: dict[str, str]


class Results:
    """The place where a run writes.

    Parameters
    ----------
    output : Path
        A folder, or one file with its manifest next to it.
    single : bool
        Whether it is one file.
    inputs : sequence of Path
        Files that the run reads; more may be added while it reads them.
    force : bool
        Whether it may write over files that no run made.

    Raises
    ------
    NRFError
        If a single file would be lost.
    """

    def __init__(
        self, output: Path, single: bool, inputs: Sequence[Path], force: bool
    ) -> None:
        self.output = output
        self.inputs = inputs
        self.force = force
        self.home = output.parent if single else output
        name = f"{output.name}.{MANIFEST}" if single else MANIFEST
        self.manifest = self.home / name

        if not self.home.is_dir():
            file_behind(self.home)
        for folder in left_behind(self.home / output.name, _LOCK):
            self._undo(folder)
        if single:
            self._refuse_losses([output.name])

    @cached_property
    def sources(self) -> list[Source]:
        """The inputs as manifests and models name them: file, bytes, SHA-256."""
        sources: list[Source] = []
        for path in dict.fromkeys(self.inputs):
            if path.is_file():
                size = path.stat().st_size
                mark = sha256(path)
                sources.append({"file": str(path), "bytes": size, "sha256": mark})
        return sources

    @contextmanager
    def aside(self, about: Mapping[str, object]) -> Iterator[Path]:
        """A folder for the files of the run, which are moved into place at the end.

        Parameters
        ----------
        about : mapping
            What the manifest says of the run.
        """
        folders = (self.home, *self.home.parents)
        made = [folder for folder in folders if not folder.exists()]
        self.home.mkdir(parents=True, exist_ok=True)
        prefix = f".{self.output.name}."
        aside = Path(
            tempfile.mkdtemp(dir=self.home, prefix=prefix, suffix=UNFINISHED_SUFFIX)
        )
        try:
            (aside / _LOCK).touch()
            with open(aside / _LOCK, "rb") as lock:
                hold(lock.fileno())
                yield aside
                self._publish(aside, about)
        except OSError as error:
            place = self._place_of(error, aside)
            if place is None:
                raise
            renamed = OSError(error.errno, error.strerror, str(place))
            raise renamed from error
        finally:
            replaced = (aside / _REPLACED).glob("*")
            if not any(replaced):  # else the next run brings them back
                shutil.rmtree(aside, ignore_errors=True)
            with suppress(OSError):  # they hold results
                for folder in made:
                    folder.rmdir()

    def _place_of(self, error: OSError, aside: Path) -> Path | None:
        """The place of the file that an error names where it is written aside."""
        if error.filename is None:
            return None
        path = Path(error.filename)
        return self.home / path.name if path.parent == aside.resolve() else None

    # -- moving ----------------------------------------------------------------

    def _publish(self, aside: Path, about: Mapping[str, object]) -> None:
        """Move the files into place; what they replace comes back if that fails."""
        files = {}
        for path in sorted(aside.iterdir()):
            if path.name != _LOCK:
                files[path.name] = sha256(path)
        self._refuse_losses(list(files))

        run: Run = {"inputs": self.sources, "files": files}
        beside: list[Run] = []
        stale: list[Run] = []
        for other in _runs_of(self.manifest):
            runs = beside if _stays_beside(other, run) else stale
            runs.append(other)
        described = {**about, "versions": versions(), **run}
        manifest = {"schema": _SCHEMA, "version": _VERSION}
        with atomic_write(aside / MANIFEST) as file:
            json.dump({**manifest, "runs": [*beside, described]}, file, indent=2)

        targets = {name: self.home / name for name in files}
        replaced = [self.manifest, *targets.values(), *self._unchanged_files_of(stale)]
        # the manifest is moved last: where it still is, the run was not finished
        targets[MANIFEST] = self.manifest
        self._exchange(aside, targets, replaced)

    def _exchange(
        self, aside: Path, targets: Mapping[str, Path], replaced: Iterable[Path]
    ) -> None:
        """Move replaced files away and new ones into place, or change nothing."""
        (aside / _REPLACED).mkdir()
        moves = _Moves()
        try:
            for place in dict.fromkeys(replaced):
                path = file_behind(place)
                if path.exists():
                    moves.move(path, aside / _REPLACED / path.name)
            for name, place in targets.items():
                moves.move(aside / name, file_behind(place))
        except BaseException:
            moves.undo()
            raise
        shutil.rmtree(aside / _REPLACED)

    def _unchanged_files_of(self, runs: Iterable[Run]) -> list[Path]:
        """Files of earlier runs that nobody changed and this one does not read."""
        files = []
        for run in runs:
            for name, mark in run["files"].items():
                path = self.home / name
                if _has_mark(path, mark) and not self._reads(path):
                    files.append(path)
        return files

    def _undo(self, folder: Path) -> None:
        """Remove what a killed run left behind.

        If it was moving its results, the earlier ones come back.
        """
        unfinished = folder / MANIFEST
        if unfinished.exists():
            for run in _runs_of(unfinished)[-1:]:
                for name, mark in run["files"].items():
                    # what is still aside has replaced nothing, were it the same
                    was_moved = not (folder / name).exists()
                    if was_moved and _has_mark(self.home / name, mark):
                        (self.home / name).unlink()
            for path in (folder / _REPLACED).glob("*"):
                if not (self.home / path.name).exists():
                    shutil.move(path, self.home / path.name)
        shutil.rmtree(folder, ignore_errors=True)

    # -- what may not be lost --------------------------------------------------

    def _reads(self, path: Path) -> bool:
        """Whether a file is an input of the run, by this or another name."""
        existing = [source for source in self.inputs if source.exists()]
        return any(source.samefile(path) for source in existing)

    def _refuse_losses(self, names: Iterable[str]) -> None:
        """Raise an error if writing these files would lose one.

        That is an input, or what is no unchanged result of an earlier run.
        """
        for name in names:
            target = self.home / name
            if not file_behind(target).exists() or self.force:
                continue
            if self._reads(target):
                what = "an input of this run"
            elif not self._is_result(target):
                what = "no result of an earlier run, or changed since"
            else:
                continue
            raise NRFError(
                f"{target} is {what}, and would be lost",
                "Give another output (-o), or add --force.",
            )

    def _is_result(self, path: Path) -> bool:
        """Whether an earlier run made a file, and nobody changed it."""
        for manifest in self.home.glob(f"*{MANIFEST}"):
            for run in _runs_of(manifest):
                if _has_mark(path, run["files"].get(path.name)):
                    return True
        return False


class _Moves:
    """Files that were moved, and can be moved back."""

    def __init__(self) -> None:
        self._done: list[tuple[Path, Path]] = []

    def move(self, source: Path, target: Path) -> None:
        """Move one file."""
        self._done.append((source, Path(shutil.move(source, target))))

    def undo(self) -> None:
        """Move all files back, the last first."""
        for source, target in reversed(self._done):
            shutil.move(target, source)


def _runs_of(manifest: Path) -> list[Run]:
    """Runs by a manifest; none if it cannot be read or names files elsewhere."""
    with suppress(OSError, ValueError, TypeError, LookupError, AttributeError):
        data = json.loads(manifest.read_text(encoding="utf-8"))
        runs: list[Run] = data["runs"]
        if data["schema"] == _SCHEMA and all(map(_is_sound, runs)):
            return runs
    return []


def _is_sound(run: Run) -> bool:
    """Whether a run names its inputs by their SHA-256, and no file elsewhere."""
    in_folder = all(Path(name).name == name for name in run["files"].keys())
    marked = all(source["sha256"] is not None for source in run["inputs"])
    return in_folder and marked


def _stays_beside(earlier: Run, run: Run) -> bool:
    """Whether earlier results stay beside new ones.

    They have no file in common, and the same inputs, or are inputs themselves.
    """
    before = {source["sha256"] for source in earlier["inputs"]}
    now = {source["sha256"] for source in run["inputs"]}
    related = before == now or not now.isdisjoint(earlier["files"].values())
    return related and earlier["files"].keys().isdisjoint(run["files"])


def _has_mark(path: Path, mark: str | None) -> bool:
    """Whether a file is there and has this SHA-256."""
    return mark is not None and path.is_file() and sha256(path) == mark


def sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
